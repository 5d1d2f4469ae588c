"""What bounds displacements, lets them fade, or holds them; on networks of random weights."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import patches
import shapes
from neusub import flaps, subdivider
from neusub.bounds import (
    Measures,
    area_normals,
    around_edges,
    around_vertices,
    measured,
    restrained,
    turned_corners,
)
from neusub.configuration import Architecture
from neusub.frames import edge_vectors, local_frames, star_sums, vertex_turns
from neusub.mesh import Mesh
from neusub.schemes import subdivide_classic, subdivision_matrix
from neusub.subdivider import Subdivider
from neusub.topology import topology_levels
from test_network import bumpy, flaps_of, random_network, rotation, run

FREE = {"vectors": 2, "relative": True, "flat": 0.3}
HELD = {**FREE, "sharp": 0.03}


def test_a_bound_keeps_each_displacement_below_its_share_of_the_shortest_edge():
    vertices, faces = shapes.torus(9, 7)
    free = run(random_network(), vertices, faces, 1)[0].numpy()
    moved = np.linalg.norm(run(random_network(bound=(0.01, 0.3)), vertices, faces, 1)[0].numpy() - vertices, axis=1)
    topology = topology_levels(faces, len(vertices), 1)[0][0]
    own = np.full(len(vertices), np.inf)
    lengths = np.linalg.norm(np.diff(vertices[topology.edges], axis=1)[:, 0], axis=1)
    np.minimum.at(own, topology.edges.reshape(-1), np.repeat(lengths, 2))
    assert (moved <= 0.01 * own + 1e-12).all()
    assert moved.max() > 0
    assert np.linalg.norm(free - vertices, axis=1).max() > moved.max()


def test_a_bound_keeps_each_displacement_below_its_share_of_the_smallest_altitude():
    vertices, faces = shapes.torus(8, 6)
    vertices = vertices * [1, 1, 0.02]  # squeezed: altitudes shrink, the ring's edges hardly do
    corners = vertices[faces]
    doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    altitude = doubled / np.linalg.norm(corners - corners[:, [1, 2, 0]], axis=2).max(axis=1)
    around = np.full(len(vertices), np.inf)
    for column in faces.T:
        np.minimum.at(around, column, altitude)
    moved = [run(random_network(bound=bound), vertices, faces, 1)[0].numpy() for bound in ((9, 9), (9, 9, 0.1))]
    lengths = np.linalg.norm(np.array(moved) - vertices, axis=2)
    assert (lengths[0] > 0.1 * around).all()
    assert (lengths[1] < 0.1 * around * (1 + 1e-12)).all() and (lengths[1] > 0.05 * around).all()


def test_with_a_bound_a_flat_patch_stays_flat():
    vertices, faces = shapes.grid(6, 5)
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    for out in run(random_network(bound=(0.2, 0.3)), vertices @ turn.T, faces):
        # Displacements are bounded by the height of the half-flaps over their plane: rounding errors here.
        assert np.abs((out.numpy() @ turn)[:, 2]).max() < 1e-12


def test_displacements_fade_with_flatness():
    """A random network makes no smooth surface rougher than it is: its displacements go down like the heights."""
    def mean_move(level: int) -> float:
        vertices, faces = shapes.icosphere(level)
        moved = run(random_network(vectors=2, relative=True, flat=0.3), vertices, faces, 1)[0].numpy()
        edge = np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1).mean()
        return float(np.linalg.norm(moved - vertices, axis=1).mean()) / edge

    moves = [mean_move(level) for level in (2, 3, 4)]
    assert moves[1] < 0.7 * moves[0]
    assert moves[2] < 0.6 * moves[1]


@pytest.mark.parametrize("make", [lambda: shapes.torus(8, 6), lambda: shapes.grid(5, 4)])
def test_beyond_the_trained_levels_vertices_of_flat_places_go_to_loops_points(make):
    vertices, faces = make()
    vertices = bumpy(vertices)
    options = {"vectors": 2, "relative": True, "flat": 0.3, "trained": 1}
    plain = run(random_network(**options), vertices, faces)
    settled = run(random_network(**options, settle=1e12), vertices, faces)  # everything is flat
    for a, b in zip(plain[:2], settled[:2]):
        np.testing.assert_array_equal(a, b)
    middle = topology_levels(faces, len(vertices), 2)[0][1]
    wanted = subdivision_matrix(middle, "loop") @ settled[1].numpy()
    np.testing.assert_allclose(settled[2], wanted, atol=1e-9)


def test_a_border_gets_smoother_beyond_the_trained_levels_and_keeps_its_corners():
    angle = 2 * np.pi * np.arange(10) / 10
    dome = np.concatenate([[[0, 0, 0.3]], np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)])
    faces = np.stack([0 * np.arange(10), 1 + np.arange(10), 1 + (np.arange(10) + 1) % 10], axis=1)
    model = Subdivider.load(dtype=torch.float64)
    turns = []
    trained = model.network.plan.trained
    for mesh in model.subdivide(subdivide_classic(Mesh(dome, faces), "loop", 1)[-1], trained + 3)[trained:]:
        ends = mesh.vertices[mesh.topology.edges[mesh.topology.is_boundary_edge]]
        around = np.argsort(np.arctan2(*ends.mean(axis=1).T[:2]))
        ahead = (ends[:, 1] - ends[:, 0])[around]
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        turns.append(np.degrees(np.arccos(np.abs((ahead * np.roll(ahead, 1, axis=0)).sum(axis=1)).clip(0, 1))).max())
    assert turns[1] < 0.8 * turns[0] and turns[2] < 0.8 * turns[1] and turns[3] < 0.8 * turns[2], turns
    square, halves = shapes.grid(4, 4)
    fine = model.subdivide(Mesh(square, halves), 4)[-1].vertices
    edge = np.ptp(square[:, 0]) / 4
    for corner in (square.min(axis=0), square.max(axis=0)):
        assert np.linalg.norm(fine - corner, axis=1).min() < 0.02 * edge


# --- triangles that would be turned over ---------------------------------------------------------------------------


def turned_over(levels: list[np.ndarray], faces, start) -> list[int]:
    """How many triangles of each level look away from the input's face that they come from."""
    topologies, last = topology_levels(faces, len(start), len(levels) - 1)
    finer = [*(topology.faces for topology in topologies), last]
    wanted = normals_of(start, faces)
    return [int(((normals_of(positions, f).reshape(-1, len(faces), 3) * wanted).sum(axis=2) < 0).sum())
            for positions, f in zip(levels, finer)]


def normals_of(vertices, faces):
    a, b, c = (vertices[column] for column in faces.T)
    return np.cross(b - a, c - a)


@pytest.mark.parametrize("make", [lambda: shapes.torus(12, 8), lambda: shapes.grid(6, 5)])
def test_no_triangle_is_turned_over_however_far_the_network_goes(make):
    vertices, faces = make()
    vertices = bumpy(vertices)
    outputs = {}
    for on in (False, True):
        network = random_network(vectors=2, relative=True, unturned=on)
        for module in (network.initial, network.vertex, network.edge):
            module.last.weight.data *= 4
        outputs[on] = [out.numpy() for out in run(network, vertices, faces)]
    assert min(turned_over(outputs[False], faces, vertices)[1:]) > 0
    assert turned_over(outputs[True], faces, vertices) == [0, 0, 0]
    assert np.abs(outputs[True][1][: len(vertices)] - vertices).max() > 0.05  # it moves where nothing turns


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_kernel_finds_the_turned_triangles_that_tensors_find(dtype, monkeypatch):
    vertices, faces = shapes.torus(9, 7)
    (topology,), fine = topology_levels(faces, len(vertices), 1)
    normals = area_normals(torch.tensor(faces), torch.tensor(vertices, dtype=dtype))
    points = subdivision_matrix(topology, "midpoint") @ vertices
    noise = np.random.default_rng(0).normal(0, 0.2, points.shape)
    safe, wild = (torch.tensor(p, dtype=dtype) for p in (points, points + noise))
    folded = safe.clone()
    folded[fine[3]] = folded[fine[3, 0]].clone()  # one of its faces is a point, others are lines
    for before, after in ((safe, wild), (wild, folded), (safe, folded), (folded, wild)):
        found = []
        for enough in (0, np.inf):
            monkeypatch.setattr(flaps, "ENOUGH", enough)
            found.append(turned_corners(torch.tensor(fine), normals, before)(after))
        assert len(found[0]) < len(wild)
        assert found[0].equal(found[1])
    assert len(found[0]) > 0


@pytest.mark.parametrize("turn", [np.eye(3), rotation()])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("make", [
    shapes.cube, lambda: shapes.bumpy(shapes.torus(9, 7)), lambda: shapes.open_cylinder(5, 3), shapes.collinear_face,
    lambda: shapes.punctured(shapes.cube(), [0]), lambda: shapes.with_null_edges(shapes.icosphere(2), 10),
    lambda: shapes.grid(5, 4),
])
def test_kernels_hold_and_restrain_what_tensors_do(make, dtype, turn, monkeypatch):
    vertices, faces = make()
    (level,) = flaps_of(faces, len(vertices), 1)
    positions = torch.tensor(vertices @ turn.T, dtype=dtype)
    plan, bound = Architecture(flat=0.3, sharp=0.03), (0.25, 0.6, 0.3)
    generator, found = torch.Generator().manual_seed(0), {}
    anything = torch.rand(len(vertices), 5, generator=generator, dtype=dtype).T.contiguous().T
    moves = [10.0 ** torch.randint(-6, 2, (n, 1), generator=generator) * torch.randn(n, 3, generator=generator)
             for n in (len(vertices), len(level.edges))]
    for enough in (0, np.inf):
        monkeypatch.setattr(flaps, "ENOUGH", enough)
        measures = []
        for groups in (level.by_vertex, level.by_edge):
            edges = edge_vectors(groups, positions)
            measures.append(measured(groups, edges, local_frames(edges)[0], True))
        around = around_vertices(level.by_vertex, measures[0], plan.sharp)
        arounds = around, around_edges(level.by_edge, around)
        kept = [restrained(move.to(dtype), *known, plan, bound) for move, *known in zip(moves, measures, arounds)]
        found[enough] = *arounds, around_edges(level.by_edge, anything), *kept
    for a, b in zip(found[0], found[np.inf]):
        rtol, atol = (1e-4, 1e-6) if dtype == torch.float32 else (1e-10, 1e-13)
        torch.testing.assert_close(a, b, rtol=rtol, atol=atol)
        assert a.dtype == dtype


def test_the_kernel_bounds_displacements_next_to_nothing_as_tensors_do(monkeypatch):
    """Where the bound is about as small as `bounds.NOTHING`."""
    generator = torch.Generator().manual_seed(0)
    small = 10.0 ** (-8 + 4 * torch.rand(3, 200, generator=generator, dtype=torch.float64))
    measures = Measures(small[0], small[1].square(), small[2].square(), small[1], None)
    around = torch.stack([small[0], torch.rand(200, generator=generator, dtype=torch.float64)]).T
    move, plan = torch.randn(200, 3, generator=generator, dtype=torch.float64), Architecture(flat=0.3, sharp=0.03)
    found = []
    for enough in (0, np.inf):
        monkeypatch.setattr(flaps, "ENOUGH", enough)
        found.append(restrained(move, measures, around, plan, (0.25, 0.6, 0.3)))
    torch.testing.assert_close(*found, rtol=1e-10, atol=0)


def test_gradients_go_through_where_kernels_look_for_turned_triangles(monkeypatch):
    vertices, faces = shapes.torus(9, 7)
    monkeypatch.setattr(flaps, "ENOUGH", 0)
    positions = torch.tensor(vertices, requires_grad=True)
    network = random_network(**HELD, unturned=True, crisp=True)
    network(positions, flaps_of(faces, len(vertices)))[-1].square().sum().backward()
    assert positions.grad is not None and positions.grad.abs().max() > 0


def test_where_nothing_is_turned_over_positions_are_the_networks():
    vertices, faces = shapes.torus(12, 8)
    options = {"vectors": 2, "relative": True, "bound": (0.05, 0.3)}
    free, kept = (run(random_network(**options, unturned=on), vertices, faces) for on in (False, True))
    for a, b in zip(free, kept):
        np.testing.assert_array_equal(a, b)


def test_triangles_too_thin_for_single_precision_are_not_turned_over_either(monkeypatch):
    vertices, faces = shapes.torus(12, 8)
    vertices = vertices.copy()
    a, b, c = faces[0]
    vertices[c] = (vertices[a] + vertices[b]) / 2 + 1e-7 * (vertices[c] - vertices[a])
    model = Subdivider.load()
    model.network.plan = replace(model.network.plan, unturned=True)

    def count() -> list[int]:
        return turned_over([mesh.vertices for mesh in model.subdivide(Mesh(vertices, faces), 2)], faces, vertices)

    assert count() == [0, 0, 0]
    monkeypatch.setattr(subdivider, "THIN", 0)
    assert max(count()) > 0


@pytest.mark.parametrize("thickness", [1e-4, 1e-6])
def test_thin_plates_keep_their_thickness(thickness):
    vertices, faces = shapes.icosphere(2)
    vertices = (vertices + 0.02 * np.random.default_rng(0).standard_normal(vertices.shape)) * [1, 1, thickness]
    mesh = Mesh(vertices, faces)
    single, double = (Subdivider.load(device="cpu", dtype=dtype).subdivide(mesh, 2)[-1].vertices[:, 2]
                      for dtype in (torch.float32, torch.float64))
    np.testing.assert_allclose(single, double, atol=1e-3 * thickness)


# --- sharp edges of flat faces -----------------------------------------------------------------------------------


def turns_of(vertices, faces):
    groups = flaps_of(faces, len(vertices), 1)[0].by_vertex
    return vertex_turns(star_sums(groups, torch.as_tensor(vertices), framed=True), groups.offsets.diff()).numpy()


def test_turns_of_a_divided_cube_tell_faces_edges_and_corners():
    vertices, faces = shapes.refined(shapes.cube(), 2)
    on_faces = (np.isclose(vertices, 0) | np.isclose(vertices, 1)).sum(axis=1)  # 1 inside a face, 3 at a corner
    turns = turns_of(vertices, faces)
    sine = np.sqrt(0.5)  # of 45 degrees
    np.testing.assert_allclose(turns[on_faces == 1], 0, atol=1e-12)
    np.testing.assert_allclose(turns[on_faces == 2, 1:3], [[sine / 2, 0]] * (on_faces == 2).sum(), atol=1e-3)
    np.testing.assert_allclose(turns[on_faces == 3, 1:], [[sine, sine / 3, 0]] * 8, atol=2e-3)


def test_turns_of_equal_angles_are_ratios_of_binomial_coefficients():
    vertices, faces = shapes.icosahedron()
    sine = np.sin(np.pi / 2 - np.arccos(-np.sqrt(5) / 3) / 2)
    np.testing.assert_allclose(turns_of(vertices, faces), [sine * np.array([1, 2, 1, 0.5])] * 12, rtol=1e-2)


@pytest.mark.parametrize("settle", [0.0, 0.05])
def test_a_divided_box_stays_that_box(settle):
    vertices, faces = shapes.refined(shapes.cube(), 2)
    turn = rotation() * [1, 2, 0.5]
    network = random_network(**HELD, trained=1, settle=settle)
    for level, out in enumerate(run(network, vertices @ turn.T, faces, 3)):
        wanted = shapes.refined((vertices, faces), level)[0] @ turn.T if level else vertices @ turn.T
        np.testing.assert_allclose(out, wanted, atol=1e-9)
    moved = run(random_network(**FREE), vertices @ turn.T, faces, 1)[0].numpy() - vertices @ turn.T
    assert np.abs(moved).max() > 0.01


def held_by_what_is_around(vertices, faces):
    level = flaps_of(faces, len(vertices), 1)[0]
    edges = edge_vectors(level.by_vertex, torch.as_tensor(vertices))
    return level, around_vertices(level.by_vertex, measured(level.by_vertex, edges, local_frames(edges)[0], True), 0.03)


@pytest.mark.parametrize("make", [lambda: shapes.icosphere(1), lambda: shapes.open_cylinder(12, 4), shapes.icosahedron,
                                  lambda: patches.bipyramid(12), lambda: (patches.bipyramid(12)[0] * [1, 1, 0.02],
                                                                          patches.bipyramid(12)[1])])
def test_curved_shapes_strips_of_a_cylinder_and_curved_rims_are_not_held(make):
    level, around = held_by_what_is_around(*make())
    assert around[:, -1].min() > 0.85
    assert around_edges(level.by_edge, around)[:, 1].min() > 0.85


def test_an_open_box_stays_that_box_up_to_its_rim():
    vertices, faces = shapes.refined(shapes.cube(), 2)
    middles = vertices[faces].mean(axis=1)
    faces = faces[middles[:, 2] < 1 - 1e-9]
    used = np.unique(faces)
    for level, out in enumerate(run(random_network(**HELD), vertices[used], np.searchsorted(used, faces))):
        np.testing.assert_allclose(np.abs(out.numpy() - 0.5).max(axis=1).min(), 0.5, atol=1e-9)
        assert (np.isclose(out, 0) | np.isclose(out, 1)).all(axis=1).sum() == 8, level


def test_a_face_without_area_turns_nowhere_in_any_pose():
    vertices, faces = shapes.collinear_face()  # in one plane
    for seed in range(4):
        assert np.abs(turns_of(vertices @ rotation(seed).T, faces)).max() < 1e-6


def test_an_edge_at_a_pointed_tip_is_not_held():
    """A corner of a flat face is held by corners and by the inside of flat faces, the tip of a cone by nothing."""
    vertices, faces = shapes.refined(shapes.cube(), 2)
    level, around = held_by_what_is_around(vertices, faces)
    corners = (np.isclose(vertices, 0) | np.isclose(vertices, 1)).all(axis=1)
    assert around[corners, 1].min() > 0.9 and around[corners, 2].max() < 1e-3
    at_corners = corners[level.edges].any(axis=1)
    assert around_edges(level.by_edge, around)[at_corners, 1].max() < 1e-3
    blunt = around.clone()
    blunt[~corners, 1:] = 1
    assert around_edges(level.by_edge, blunt)[:, 1].min() > 0.9
