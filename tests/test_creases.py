"""Creases: the schemes' rules along them, and the network, whose mesh is cut along them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import neusub
import shapes
from neusub import Mesh, schemes
from neusub.creases import crease_edges, crease_mask, cut_open, refine_creases
from neusub.metrics import face_normals
from neusub.topology import build_topology, connected_components
from patches import ROUNDING, bipyramid, cube, edge_index, edge_row, fan, lattice, nonzero, refined


@pytest.fixture(scope="module")
def model():
    return neusub.Subdivider.load(dtype=torch.float64)


def capped_cylinder(n: int = 10, rings: int = 3) -> Mesh:
    angle = 2 * np.pi * np.arange(n) / n
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    side = np.concatenate([np.column_stack([circle, np.full(n, 0.6 * k)]) for k in range(rings)])
    faces = []
    for k in range(rings - 1):
        for i in range(n):
            a, b = k * n + i, k * n + (i + 1) % n
            faces += [[a, b, b + n], [a, b + n, a + n]]
    low, top = rings * n, (rings - 1) * n
    for i in range(n):
        j = (i + 1) % n
        faces += [[low, j, i], [low + 1, top + i, top + j]]
    return Mesh(np.concatenate([side, [[0, 0, 0], [0, 0, 0.6 * (rings - 1)]]]), np.array(faces))


def test_a_cube_cut_along_its_edges_falls_into_six_squares():
    topology = Mesh(*shapes.cube()).topology
    creases = crease_edges(topology, Mesh(*shapes.cube()).vertices, 30)
    faces, origin = cut_open(topology, creases)
    assert creases.sum() == 12
    assert len(origin) == 24
    assert connected_components(faces, len(origin))[0] == 6
    np.testing.assert_array_equal(origin[faces], topology.faces)
    np.testing.assert_array_equal(origin[:8], np.arange(8))


def test_a_cut_ends_at_darts_and_opens_what_lies_between_them():
    topology = Mesh(*shapes.icosphere(1)).topology
    a, b = topology.edges[0]
    c = next(int(e.sum() - b) for e in topology.edges if b in e and a not in e)
    one = crease_mask(topology, np.array([[a, b]]))
    assert len(cut_open(topology, one)[1]) == topology.n_vertices  # both ends are darts: nothing comes apart
    _, origin = cut_open(topology, crease_mask(topology, np.array([[a, b], [b, c]])))
    assert origin[topology.n_vertices :].tolist() == [b]


def test_isolated_vertices_keep_their_index():
    faces, origin = cut_open(build_topology(np.array([[1, 2, 3]]), 5), np.zeros(3, dtype=bool))
    assert origin.tolist() == [0, 1, 2, 3, 4]
    assert faces.tolist() == [[1, 2, 3]]


def test_an_octahedron_with_creases_stays_an_octahedron(model):
    """A low one: its upper and lower edges turn by 48 degrees, which the network alone does not take for sharp."""
    vertices, faces = bipyramid(4)
    low = np.array([1, 1, 0.5])
    fine = model.subdivide(Mesh(vertices * low, faces), 3, 1, crease_angle=30)[-1]
    np.testing.assert_allclose(np.abs(fine.vertices / low).sum(axis=1), 1, rtol=1e-12)
    plain = np.abs(model.subdivide(Mesh(vertices * low, faces), 3)[-1].vertices / low).sum(axis=1)
    assert np.ptp(plain) > 0.1  # without them it is round


def test_a_cube_stays_a_cube_with_creases_and_without(model):
    cube = Mesh(*shapes.cube())
    for fine in (model.subdivide(cube, 3, 1, crease_angle=30)[-1], model.subdivide(cube, 4)[-1]):
        np.testing.assert_allclose(np.abs(fine.vertices - 0.5).max(axis=1), 0.5, rtol=1e-12)


def test_points_of_a_crease_lie_on_its_curve_and_both_sides_meet_there(model):
    cylinder = capped_cylinder()
    result = model.subdivide(cylinder, 2, crease_angle=50)
    curve = neusub.subdivide(cylinder, "butterfly", 2, crease_angle=50)
    rim = np.isclose(curve[-1].vertices[:, 2], 0) & (np.hypot(*curve[-1].vertices[:, :2].T) > 0.97)
    assert rim.sum() == 40
    np.testing.assert_allclose(result[-1].vertices[rim], curve[-1].vertices[rim], atol=1e-12)
    for level, plain in zip(result, model.subdivide(cylinder, 2)):
        np.testing.assert_array_equal(level.faces, plain.faces)
        assert not level.topology.is_boundary_edge.any()
    normals = face_normals(result[-1])
    assert (np.abs(normals[:, 2]) > 1 - 1e-12).sum() == 2 * 10 * 16  # caps stay flat
    assert np.abs(normals[np.abs(normals[:, 2]) < 0.9, 2]).max() < 0.3  # and the side does not bend into them


def test_marked_edges_are_creases_beside_those_of_the_angle(model):
    cylinder = capped_cylinder()
    rim = cylinder.topology.edges[crease_edges(cylinder.topology, cylinder.vertices, 50)]
    marked = model.subdivide(cylinder, 1, creases=rim)[-1].vertices
    np.testing.assert_array_equal(marked, model.subdivide(cylinder, 1, crease_angle=50)[-1].vertices)
    np.testing.assert_array_equal(model.subdivide(cylinder, 1, crease_angle=170)[-1].vertices,
                                  model.subdivide(cylinder, 1)[-1].vertices)
    with pytest.raises(ValueError, match="is not an edge"):
        model.subdivide(cylinder, 1, creases=np.array([[0, 5]]))


def test_creases_survive_the_levels_of_loop(model):
    cylinder = capped_cylinder()
    fine = model.subdivide(cylinder, 1, 2, crease_angle=50)[-1]
    top = np.isclose(fine.vertices[:, 2], fine.vertices[:, 2].max(), atol=1e-12)
    radius = np.hypot(*fine.vertices[top, :2].T)
    assert radius.max() > 0.95
    assert top.sum() == 1 + 10 * sum(range(1, 9))  # all of the cap, and it is flat


# ---- the schemes' rules -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["loop", "butterfly"])
def test_a_cube_with_sharp_edges_stays_a_cube(scheme):
    vertices, faces = cube()
    topology = build_topology(faces, 8)
    creases = crease_edges(topology, vertices, 30)
    assert creases.sum() == 12
    fine = schemes.subdivision_operator(topology, scheme, 3, creases=creases).apply(vertices)[-1]
    np.testing.assert_array_equal(fine[:8], vertices)
    np.testing.assert_allclose(np.abs(fine).max(axis=1), 0.5, atol=ROUNDING)


@pytest.mark.parametrize("scheme", ["loop", "butterfly"])
def test_a_crease_depends_on_itself_only(scheme):
    vertices, faces = refined(*bipyramid(6))
    topology = build_topology(faces, len(vertices))
    equator = np.abs(vertices[:, 2]) < 1e-9
    creases = equator[topology.edges].all(axis=1)
    matrix = schemes.subdivision_matrix(topology, scheme, creases=creases).toarray()
    on_crease = np.concatenate([equator, creases])
    assert not matrix[np.ix_(on_crease, ~equator)].any()
    fine = refine_creases(topology, creases)
    assert fine.sum() == 2 * creases.sum()
    # Each side is computed as if the other were not there.
    upper = vertices[:, 2] > 1e-9
    above = upper[topology.edges].any(axis=1)
    lower = vertices[:, 2] < -1e-9
    if scheme == "butterfly":
        assert not matrix[np.ix_(np.concatenate([upper, above]), lower)].any()


def test_a_dart_is_smooth_and_a_corner_stays():
    vertices, faces = lattice(7, 7)
    topology = build_topology(faces, 49)
    dart = [[23, 24]]  # one crease: its ends are darts
    plain = schemes.subdivision_matrix(topology, "loop").toarray()
    with_dart = schemes.subdivision_matrix(topology, "loop", creases=np.array(dart)).toarray()
    np.testing.assert_array_equal(plain, with_dart)
    assert edge_row(vertices, faces, "butterfly", 23, 24, creases=np.array(dart)) == {23: 1 / 2, 24: 1 / 2}
    three = np.array([[24, 23], [24, 25], [24, 31]])
    corner = schemes.subdivision_matrix(topology, "loop", creases=three).toarray()
    assert nonzero(corner[24]) == {24: 1}
    assert edge_row(vertices, faces, "butterfly", 24, 25, creases=three) == {24: 1 / 2, 25: 1 / 2}
    straight = np.array([[23, 24], [24, 25]])
    curve = schemes.subdivision_matrix(topology, "loop", creases=straight).toarray()
    assert nonzero(curve[24]) == {23: 1 / 8, 24: 6 / 8, 25: 1 / 8}
    # A dart ends the curve: the one-sided rule.
    row = edge_row(vertices, faces, "butterfly", 23, 24, creases=straight)
    assert row == {23: 3 / 8, 24: 6 / 8, 25: -1 / 8}


def test_creases_by_mask_index_and_pair_are_the_same():
    topology = build_topology(fan(5)[1], 6)
    index = np.array([edge_index(topology, 0, 3), edge_index(topology, 0, 5)])
    mask = np.zeros(len(topology.edges), dtype=bool)
    mask[index] = True
    for creases in (mask, index, np.array([[3, 0], [0, 5]])):
        np.testing.assert_array_equal(crease_mask(topology, creases), mask)
    assert not crease_mask(topology, np.zeros((0, 2))).any()
    for wrong in (np.array([[1, 3]]), np.array([99]), np.array([[0, 99]]), mask[:-1], np.array([0.7, 1.9]), np.array(3),
                  np.array([[0.0, 3.0]]), np.array([[3, 0, 0], [0, 5, 5]]), np.array([["0", "3"]])):
        with pytest.raises(ValueError, match="crease"):
            crease_mask(topology, wrong)


@pytest.mark.parametrize("angle", [float("nan"), -4, 200])
def test_an_angle_out_of_range_is_named(angle):
    for scheme in ("neural", "loop"):
        with pytest.raises(ValueError, match="take degrees from 0 to 180"):
            neusub.subdivide(Mesh(*shapes.cube()), scheme, 1, crease_angle=angle)
