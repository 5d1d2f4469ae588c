"""Faces whose edges are each flat or sharp, and displacements that keep to their planes."""

import numpy as np
import pytest
import torch
from experiments.measures import angles

import shapes
from neusub import crisp, flaps
from neusub.crisp import crisp_faces, in_planes, planes_of
from neusub.mesh import Mesh
from neusub.subdivider import Subdivider
from test_bounds import HELD
from test_network import flaps_of, random_network, rotation, run


def planes_at(vertices, faces, dtype=torch.float64):
    level = flaps_of(faces, len(vertices), 1)[0]
    return planes_of(level, crisp_faces(level, torch.as_tensor(vertices, dtype=dtype))), level.edges


def left_of(move, matrices):
    """How long the pieces of displacements are that are left."""
    return in_planes(torch.as_tensor(np.broadcast_to(move, (len(matrices), 3)).copy()), matrices).norm(dim=1).numpy()


def weights_of(vertices, faces, dtype=torch.float64):
    return crisp_faces(flaps_of(faces, len(vertices), 1)[0], torch.as_tensor(vertices, dtype=dtype)).weights.numpy()


def bent_cube():
    """A cube, one of whose sides is no longer flat, and the vertex that is moved."""
    vertices, faces = shapes.refined(shapes.cube(), 1)
    middle = np.isclose(vertices, [0.5, 0.5, 1]).all(axis=1)
    return vertices + 0.2 * middle[:, None], faces, int(middle.argmax())


def hinged(*degrees):
    """Face 0, and at each of its edges a face that turns by so much; None: none."""
    vertices, faces = [np.array(v, dtype=float) for v in ([0, 0, 0], [1, 0, 0], [0.2, 0.8, 0])], [[0, 1, 2]]
    for i, angle in enumerate(degrees):
        if angle is not None:
            a, b = vertices[i], vertices[(i + 1) % 3]
            outwards = np.cross(b - a, AXES[2]) / np.linalg.norm(b - a)
            vertices.append((a + b) / 2 + np.cos(np.radians(angle)) * outwards + np.sin(np.radians(angle)) * AXES[2])
            faces.append([(i + 1) % 3, i, len(vertices) - 1])
    return np.array(vertices), np.array(faces)


AXES = np.eye(3)


def test_what_lies_on_a_cube_keeps_to_its_sides_and_edges():
    vertices, faces = shapes.refined(shapes.cube(), 1)
    planes, edges = planes_at(vertices, faces)
    points = [vertices, vertices[edges].mean(axis=1)]
    for matrices, at in zip(planes, points):
        for axis in range(3):
            on_side = np.isclose(at[:, axis], 0) | np.isclose(at[:, axis], 1)
            left = left_of(AXES[axis], matrices)
            assert on_side.any() and (~on_side).any()
            assert left[on_side].max() < 1e-7
            np.testing.assert_allclose(left[~on_side], 1, atol=1e-7)


def test_what_lies_on_a_bent_side_leaves_it_and_keeps_to_the_others():
    vertices, faces, middle = bent_cube()
    planes, edges = planes_at(vertices, faces)
    at_middle = (edges == middle).any(axis=1)
    assert left_of(AXES[2], planes.vertices)[middle] > 0.9
    assert left_of(AXES[2], planes.edges)[at_middle].min() > 0.9
    assert left_of(AXES[0], planes.vertices)[np.isclose(vertices[:, 0], 0)].max() < 1e-7


def test_a_plane_is_kept_to_whatever_else_meets_at_its_vertices():
    """A flat side with a sharp edge, and a round hill beside it."""
    grid, faces = shapes.grid(8, 4)
    x, y = (grid - grid.min(axis=0)).T[:2]
    x, y = 8 * x / x.max(), 4 * y / y.max()
    hill = np.where(x <= 4, 0, np.sin((x - 4) * np.pi / 4) * np.sin(y * np.pi / 4))
    planes, edges = planes_at(np.stack([x, y, hill], axis=1), faces)
    flat = x < 2.5
    assert left_of(AXES[2], planes.vertices)[flat].max() < 1e-7
    np.testing.assert_allclose(left_of(AXES[0], planes.vertices)[flat], 1, atol=1e-7)
    assert left_of(AXES[2], planes.edges)[(x > 4.5)[edges].all(axis=1)].min() > 0.5


def test_borders_of_flat_patches_stay_in_their_plane_and_move_in_it():
    vertices, faces = shapes.disc(1)
    for matrices in planes_at(vertices, faces)[0]:
        assert left_of(AXES[2], matrices).max() < 1e-7
        for axis in (0, 1):
            np.testing.assert_allclose(left_of(AXES[axis], matrices), 1, atol=1e-12)


@pytest.mark.parametrize("make", [lambda: shapes.icosphere(2), lambda: shapes.open_cylinder(12, 4), shapes.icosahedron])
def test_curved_shapes_keep_to_no_plane(make):
    for matrices in planes_at(*make())[0]:
        assert min(left_of(axis, matrices).min() for axis in AXES) > 0.95


@pytest.mark.parametrize("whole", [True, False])
def test_smooth_surfaces_of_small_triangles_keep_to_no_plane(whole):
    """At edges of 2.5 degrees, and at a border of them."""
    vertices, faces = shapes.icosphere(4)
    if not whole:
        vertices, faces = shapes.punctured((vertices, faces), [0])
    for matrices in planes_at(vertices, faces)[0]:
        assert min(left_of(axis, matrices).min() for axis in AXES) > 0.95


@pytest.mark.parametrize("degrees", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("enough", [0, np.inf])
def test_how_crisp_a_face_is_between_an_edge_nearly_flat_and_a_sharp_one_or_a_border(degrees, enough, monkeypatch):
    monkeypatch.setattr(flaps, "ENOUGH", enough)
    s = np.sin(np.radians(degrees / 2))

    def flat(which):
        half = np.array([crisp.FLAT_AT_VERTICES[which], crisp.FLAT_AT_EDGES[which]])
        return half**2 / (s**2 + half**2)

    for others in ((0, 0), (None, 0), (None, None)):
        np.testing.assert_allclose(weights_of(*hinged(degrees, *others))[0], flat(0), atol=1e-7)
    for others in ((90, 0), (90, None), (90, 90)):
        np.testing.assert_allclose(weights_of(*hinged(degrees, *others))[0], flat(1), atol=1e-7)


@pytest.mark.parametrize("enough", [0, np.inf])
@pytest.mark.parametrize(("dtype", "away"), [(torch.float64, 0), (torch.float32, 0), (torch.float32, 1000)])
def test_faces_without_area_do_not_make_their_neighbours_less_crisp(dtype, away, enough, monkeypatch):
    """Nor do those whose area is a rounding error of their place."""
    monkeypatch.setattr(flaps, "ENOUGH", enough)
    vertices, faces = shapes.collinear_face()
    for seed in range(4):
        assert weights_of(vertices @ rotation(seed).T + away, faces, dtype)[1:].min() > 0.99


def test_round_shapes_become_smoother_level_by_level():
    """Only the input tells what is flat, or all would be, some levels down."""
    vertices, faces = shapes.icosahedron()
    levels = Subdivider.load().subdivide(Mesh(vertices, faces), 6)
    largest = [angles(level).max() for level in levels[4:]]
    assert largest[2] < 0.7 * largest[1] < 0.49 * largest[0]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("make", [
    shapes.cube, lambda: bent_cube()[:2], lambda: shapes.bumpy(shapes.torus(9, 7)), lambda: shapes.open_cylinder(5, 3),
    shapes.collinear_face, shapes.tetrahedron, lambda: shapes.with_null_edges(shapes.icosphere(2), 10),
    lambda: shapes.with_gap_closed(shapes.cube(), 3),
])
def test_the_kernel_finds_the_planes_that_tensors_find(make, dtype, monkeypatch):
    found = []
    for enough in (0, np.inf):
        monkeypatch.setattr(flaps, "ENOUGH", enough)
        vertices, faces = make()
        found.append(planes_at(vertices @ rotation().T, faces, dtype)[0])
    for a, b in zip(*found):
        assert a.dtype == b.dtype == dtype
        np.testing.assert_allclose(a, b, atol=1e-5 if dtype == torch.float32 else 1e-7)


@pytest.mark.parametrize("settle", [0.0, 0.05])
def test_a_solid_with_a_corner_of_six_sharp_edges_stays_that_solid(settle):
    solid = shapes.voxels({(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)})
    vertices, faces = shapes.with_gap_closed(solid, 7)
    turn = rotation()
    for on in (True, False):
        network = random_network(**HELD, trained=1, settle=settle, crisp=on)
        for out in run(network, vertices @ turn.T, faces, 3):
            back = out.numpy() @ turn
            off = np.abs(back - back.round()).min(axis=1).max()
            assert not on or off < 1e-9
    assert off > 1e-3


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_kernel_keeps_to_planes_as_tensors_do(dtype, monkeypatch):
    generator = torch.Generator().manual_seed(0)
    move, matrices = (torch.randn(50, *size, generator=generator, dtype=dtype) for size in ((3,), (3, 3)))
    monkeypatch.setattr(flaps, "ENOUGH", 0)
    kept = in_planes(move, matrices)
    torch.testing.assert_close(kept, torch.stack([m @ v for m, v in zip(matrices, move)]))
    monkeypatch.setattr(flaps, "ENOUGH", np.inf)
    torch.testing.assert_close(kept, in_planes(move, matrices))
