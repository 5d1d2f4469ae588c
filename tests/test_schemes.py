"""Midpoint, Loop and modified butterfly: truths, hand-computed stencils, then igl and VTK as independent oracles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import igl
import numpy as np
import pytest
import pyvista as pv
from scipy.spatial import cKDTree

from neusub import schemes
from neusub.creases import refine_creases
from neusub.topology import Topology, build_topology
from patches import (
    OPEN,
    ROUNDING,
    bipyramid,
    cube,
    each_closed,
    each_scheme,
    each_shape,
    edge_row,
    fan,
    half_fan,
    icosahedron,
    lattice,
    noisy,
    refined,
    some_creases,
)

# ---- truths -----------------------------------------------------------------------------------------------------


@each_shape
@each_scheme
@pytest.mark.parametrize("with_creases", [False, True])
def test_rows_sum_to_one_so_affine_maps_commute(vertices, faces, scheme, with_creases):
    topology = build_topology(faces, len(vertices))
    creases = some_creases(topology) if with_creases else None
    matrix = schemes.subdivision_matrix(topology, scheme, creases=creases)
    assert matrix.shape == (len(vertices) + len(topology.edges), len(vertices))
    np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=ROUNDING)


@each_scheme
def test_affine_functions_are_reproduced_on_a_lattice(scheme):
    vertices, faces = lattice(7, 7)
    topology = build_topology(faces, len(vertices))
    values = vertices @ [0.3, -1.2, 0] + 0.7
    midpoints = values[topology.edges].mean(axis=1)
    fine = schemes.subdivision_matrix(topology, scheme) @ values
    # The boundary's corners are rounded (Loop) or lie beside extraordinary vertices (butterfly).
    i, j = np.arange(49) % 7, np.arange(49) // 7
    far = (np.minimum(i, j) > 0) & (np.maximum(i, j) < 6) if scheme == "loop" else (i + j > 2) & (i + j < 10)
    far &= np.abs(i - j) < 4
    expected = np.concatenate([values, midpoints])
    use = np.concatenate([far, far[topology.edges].all(axis=1)])
    np.testing.assert_allclose(fine[use], expected[use], atol=ROUNDING)


@pytest.mark.parametrize("vertices, faces", OPEN.values(), ids=OPEN.keys())
@each_scheme
def test_flat_stays_flat(vertices, faces, scheme):
    topology = build_topology(faces, len(vertices))
    operator = schemes.subdivision_operator(topology, scheme, 2)
    assert np.abs(operator.apply(vertices)[-1][:, 2]).max() < ROUNDING


@each_shape
@each_scheme
@pytest.mark.parametrize("with_creases", [False, True])
def test_renumbering_and_mirroring_change_nothing(vertices, faces, scheme, with_creases):
    vertices, topology = noisy(vertices), build_topology(faces, len(vertices))
    creases = topology.edges[some_creases(topology)] if with_creases else None
    fine = schemes.subdivision_matrix(topology, scheme, creases=creases) @ vertices
    order = np.random.default_rng(2).permutation(len(vertices))  # new index of each vertex
    moved = np.empty_like(vertices)
    moved[order] = vertices
    other = build_topology(order[faces][::-1, [1, 0, 2]], len(vertices))
    creases = None if creases is None else order[creases]
    assert distance_between_sets(fine, schemes.subdivision_matrix(other, scheme, creases=creases) @ moved) < ROUNDING


@pytest.mark.parametrize("n", [3, 4, 5, 7])
@each_scheme
def test_rotational_symmetry_is_kept(n, scheme):
    vertices, faces = bipyramid(n)
    fine = schemes.subdivision_operator(build_topology(faces, n + 2), scheme, 2).apply(vertices)[-1]
    c, s = np.cos(2 * np.pi / n), np.sin(2 * np.pi / n)
    assert distance_between_sets(fine, fine @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])) < ROUNDING


def test_operator_equals_level_by_level():
    vertices, faces = OPEN["fan5"]
    topology = build_topology(faces, len(vertices))
    creases = some_creases(topology)
    operator = schemes.subdivision_operator(topology, "loop", 2, creases=creases)
    first = schemes.subdivision_matrix(topology, "loop", creases=creases) @ vertices
    middle = build_topology(topology.refined_faces, len(first))
    creases = refine_creases(topology, creases)
    second = schemes.subdivision_matrix(middle, "loop", creases=creases) @ first
    np.testing.assert_array_equal(operator.apply(vertices)[2], second)
    np.testing.assert_array_equal(operator.faces[2], middle.refined_faces)


@pytest.mark.parametrize("options", [{"scheme": "catmull"}, {"scheme": "loop", "weights": "huge"}])
def test_unknown_names_are_refused(options):
    with pytest.raises(ValueError, match="unknown"):
        schemes.subdivision_matrix(build_topology(fan(4)[1], 5), **options)


# ---- stencils by hand -------------------------------------------------------------------------------------------

LOOP_BETA = {3: 3 / 16, 4: 31 / 256, 5: 0.0840932, 6: 1 / 16, 7: 0.0490250}


@pytest.mark.parametrize("n", LOOP_BETA)
def test_loop_vertex_stencil(n):
    matrix = schemes.subdivision_matrix(build_topology(fan(n)[1], n + 1), "loop").toarray()
    beta = LOOP_BETA[n]
    np.testing.assert_allclose(matrix[0], [1 - n * beta] + n * [beta], atol=1e-6)


def test_warren_vertex_stencil():
    for n, beta in {3: 3 / 16, 4: 3 / 32, 7: 3 / 56}.items():
        topology = build_topology(fan(n)[1], n + 1)
        row = schemes.subdivision_matrix(topology, "loop", weights="warren").toarray()[0]
        np.testing.assert_allclose(row, [1 - n * beta] + n * [beta], atol=ROUNDING)


def test_loop_boundary_uses_boundary_neighbours_only():
    vertices, faces = lattice(2, 2)  # two triangles: the diagonal 1-2 is interior, with both ends on the boundary
    matrix = schemes.subdivision_matrix(build_topology(faces, 4), "loop").toarray()
    np.testing.assert_array_equal(matrix[1], [1 / 8, 6 / 8, 0, 1 / 8])
    np.testing.assert_array_equal(matrix[0], [6 / 8, 1 / 8, 1 / 8, 0])
    assert edge_row(vertices, faces, "loop", 1, 2) == {1: 3 / 8, 2: 3 / 8, 0: 1 / 8, 3: 1 / 8}
    assert edge_row(vertices, faces, "loop", 0, 1) == {0: 1 / 2, 1: 1 / 2}


BUTTERFLY_RING = {
    3: [5 / 12, -1 / 12, -1 / 12],
    4: [3 / 8, 0, -1 / 8, 0],
    5: [0.35, 0.0309017, -0.0809017, -0.0809017, 0.0309017],
    7: [0.25, 0.1088899, -0.0604303, -0.0484597, -0.0484597, -0.0604303, 0.1088899],
}


@pytest.mark.parametrize("n", BUTTERFLY_RING)
def test_butterfly_extraordinary_stencil(n):
    vertices, faces = refined(*fan(n), 2)  # the vertices around the middle are then regular
    topology = build_topology(faces, len(vertices))
    ring = topology.edges[(topology.edges == 0).any(axis=1)].sum(axis=1)
    ring = ring[np.argsort(np.arctan2(vertices[ring, 1], vertices[ring, 0]))]
    row = edge_row(vertices, faces, "butterfly", 0, ring[0])
    assert row.keys() <= {0, *ring.tolist()}
    assert row[0] == pytest.approx(3 / 4)
    np.testing.assert_allclose([row.get(v, 0) for v in ring.tolist()], BUTTERFLY_RING[n], atol=1e-6)


def test_butterfly_regular_stencil():
    vertices, faces = lattice(7, 7)  # edge 24-25 and the row above: 31, below: 18
    expected = {24: 8, 25: 8, 31: 2, 18: 2, 30: -1, 32: -1, 17: -1, 19: -1}
    assert edge_row(vertices, faces, "butterfly", 24, 25) == {v: w / 16 for v, w in expected.items()}


def test_butterfly_boundary_stencils():
    vertices, faces = lattice(7, 7)
    assert edge_row(vertices, faces, "butterfly", 2, 3) == {v: w / 16 for v, w in {1: -1, 2: 9, 3: 9, 4: -1}.items()}
    # From 3 on the boundary to 10 inside; fan of 3, clockwise: 2, 9, 10, 4.
    beside = {3: 6, 4: 1, 10: 10, 9: 3, 2: -1, 11: -1, 16: -2}
    assert edge_row(vertices, faces, "butterfly", 3, 10) == {v: w / 16 for v, w in beside.items()}
    # 3 and its left neighbour inside, 9: the mirror image.
    beside = {3: 6, 2: 1, 9: 10, 10: 3, 4: -1, 8: -1, 16: -2}
    assert edge_row(vertices, faces, "butterfly", 3, 9) == {v: w / 16 for v, w in beside.items()}


def test_butterfly_between_two_boundary_vertices():
    strip = lattice(6, 2)
    assert edge_row(*strip, "butterfly", 2, 8) == {2: 1 / 2, 8: 1 / 2}
    big = lattice(5, 5)  # across the ear at vertex 0: its neighbours 1 and 5, the face beyond has 6
    ear = {1: 4, 5: 4, 6: 2, 2: -1, 10: -1}
    assert edge_row(*big, "butterfly", 1, 5) == {v: w / 8 for v, w in ear.items()}


def test_butterfly_extraordinary_boundary_stencil():
    vertices, faces = refined(*half_fan(4), 2)
    topology = build_topology(faces, len(vertices))
    ring = topology.edges[(topology.edges == 0).any(axis=1)].sum(axis=1)
    ring = ring[np.argsort(vertices[ring, 0])[::-1]]  # from the right, counter-clockwise
    row = edge_row(vertices, faces, "butterfly", 0, ring[2])  # straight up: theta = 45 degrees, i = 2
    quarter = np.sin(np.pi / 4) / 4
    expected = [0, quarter, 1 / 4, quarter, 0]
    np.testing.assert_allclose([row.get(v, 0) for v in ring.tolist()], expected, atol=ROUNDING)
    assert row[0] == pytest.approx(1 - 2 * quarter - 1 / 4)
    row = edge_row(vertices, faces, "butterfly", 0, ring[1])
    end = 0.25 * np.sqrt(0.5) - 1 / (16 * np.sqrt(0.5))
    expected = [end, 1 / 8 + 1 / 8, quarter, 1 / 8 - 1 / 8, -end]
    np.testing.assert_allclose([row.get(v, 0) for v in ring.tolist()], expected, atol=ROUNDING)


def test_butterfly_is_the_modified_one():
    vertices, faces = icosahedron()
    fine = schemes.subdivision_matrix(build_topology(faces, 12), "butterfly") @ vertices
    radius = np.linalg.norm(fine, axis=1) / np.linalg.norm(vertices[0])
    np.testing.assert_array_equal(fine[:12], vertices)
    np.testing.assert_allclose(radius[12:], 0.968, atol=5e-4)


# ---- meshes -----------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class PlainMesh:
    vertices: np.ndarray
    faces: np.ndarray
    colors: np.ndarray | None = None

    @cached_property
    def topology(self) -> Topology:
        return build_topology(self.faces, len(self.vertices))

    def refined(self, vertices, faces, colors):
        return PlainMesh(vertices, faces, colors)


@each_scheme
def test_meshes_of_all_levels_with_colours_in_range(scheme):
    vertices, faces = icosahedron()
    colors = (np.random.default_rng(3).random((12, 4)) < 0.5).astype(np.float64)
    levels = schemes.subdivide_classic(PlainMesh(vertices, faces, colors), scheme, 2)
    assert [len(mesh.faces) for mesh in levels] == [20, 80, 320]
    assert all(mesh.colors.shape == (len(mesh.vertices), 4) for mesh in levels)
    assert levels[2].colors.min() >= 0 and levels[2].colors.max() <= 1


def test_no_levels_give_the_input():
    mesh = PlainMesh(*icosahedron())
    assert schemes.subdivide_classic(mesh, "loop", 0) == [mesh]


def test_crease_angle_keeps_a_cube_sharp():
    levels = schemes.subdivide_classic(PlainMesh(*cube()), "loop", 3, crease_angle=30)
    np.testing.assert_allclose(np.abs(levels[-1].vertices).max(axis=1), 0.5, atol=ROUNDING)
    both = schemes.subdivide_classic(PlainMesh(*cube()), "loop", 1, creases=np.array([0]), crease_angle=120)
    assert np.abs(both[-1].vertices).max(axis=1).min() < 0.49


# ---- independent oracles ----------------------------------------------------------------------------------------


def distance_between_sets(a: np.ndarray, b: np.ndarray) -> float:
    assert a.shape == b.shape
    return max(cKDTree(a).query(b)[0].max(), cKDTree(b).query(a)[0].max())


def by_vtk(vertices: np.ndarray, faces: np.ndarray, kind: str) -> np.ndarray:
    mesh = pv.PolyData.from_regular_faces(vertices, faces).subdivide(1, kind)
    return np.asarray(mesh.points, dtype=np.float64)


@each_closed
@pytest.mark.parametrize("scheme, kind", [("midpoint", "linear"), ("loop", "loop"), ("butterfly", "butterfly")])
def test_closed_meshes_equal_vtk(vertices, faces, scheme, kind):
    vertices = noisy(vertices)
    fine = schemes.subdivision_matrix(build_topology(faces, len(vertices)), scheme) @ vertices
    assert distance_between_sets(fine, by_vtk(vertices, faces, kind)) < 1e-6  # VTK stores new points as float32


@each_shape
def test_warren_weights_equal_igl(vertices, faces):
    vertices = noisy(vertices)
    fine = schemes.subdivision_matrix(build_topology(faces, len(vertices)), "loop", weights="warren") @ vertices
    assert distance_between_sets(fine, igl.loop(vertices, faces, 1)[0]) < ROUNDING


@each_shape
def test_midpoints_equal_igl(vertices, faces):
    fine = schemes.subdivision_matrix(build_topology(faces, len(vertices)), "midpoint") @ vertices
    assert distance_between_sets(fine, igl.upsample(vertices, faces, 1)[0]) < ROUNDING
