"""Midpoint, Loop and modified butterfly: truths, hand-computed stencils, then igl and VTK as independent oracles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import igl
import numpy as np
import pytest
import pyvista as pv
from scipy.spatial import cKDTree

from neusub import schemes
from neusub.creases import crease_edges, crease_mask, refine_creases
from neusub.topology import Topology, build_topology, refine_faces

SCHEMES = ["midpoint", "loop", "butterfly"]
ROUNDING = 1e-12  # float64 sums of a few terms of size one


# ---- shapes -----------------------------------------------------------------------------------------------------


def bipyramid(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Closed; two apexes of valence n, n vertices of valence 4."""
    angle = 2 * np.pi / n * np.arange(n)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    vertices = np.concatenate([ring, [[0, 0, 1], [0, 0, -1]]])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    faces = np.concatenate([np.stack([i, j, i * 0 + n], axis=1), np.stack([j, i, i * 0 + n + 1], axis=1)])
    return vertices, faces


def fan(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Flat n-gon; vertex 0 in the middle has valence n."""
    vertices, faces = bipyramid(n)
    vertices = np.concatenate([[[0, 0, 0]], vertices[:n]])
    return vertices, (faces[:n] + 1) % (n + 1)


def half_fan(k: int) -> tuple[np.ndarray, np.ndarray]:
    """Flat half-disk; vertex 0 lies on the straight boundary and has k faces."""
    angle = np.pi / k * np.arange(k + 1)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    i = np.arange(1, k + 1)
    return np.concatenate([[[0, 0, 0]], ring]), np.stack([i * 0, i, i + 1], axis=1)


def lattice(columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Equilateral triangles in a parallelogram; vertex (i, j) has index j * columns + i."""
    j, i = (a.reshape(-1) for a in np.mgrid[:rows, :columns])
    vertices = np.stack([i + j / 2, j * np.sqrt(3) / 2, 0.0 * i], axis=1)
    a = (j * columns + i)[(i < columns - 1) & (j < rows - 1)]
    lower = np.stack([a, a + 1, a + columns], axis=1)
    upper = np.stack([a + 1, a + columns + 1, a + columns], axis=1)
    return vertices, np.concatenate([lower, upper])


def cube() -> tuple[np.ndarray, np.ndarray]:
    solid = pv.Cube().triangulate().clean()
    return np.asarray(solid.points, dtype=np.float64), np.asarray(solid.regular_faces, dtype=np.int64)


def icosahedron() -> tuple[np.ndarray, np.ndarray]:
    solid = pv.Icosahedron()
    return np.asarray(solid.points, dtype=np.float64), np.asarray(solid.regular_faces, dtype=np.int64)


def refined(vertices: np.ndarray, faces: np.ndarray, levels: int = 1) -> tuple[np.ndarray, np.ndarray]:
    operator = schemes.subdivision_operator(build_topology(faces, len(vertices)), "midpoint", levels)
    return operator.apply(vertices)[-1], operator.faces[-1]


def noisy(vertices: np.ndarray, amount: float = 0.05) -> np.ndarray:
    return vertices + amount * np.random.default_rng(0).normal(size=vertices.shape)


CLOSED = {"cube": cube(), "icosahedron": icosahedron()} | {f"bipyramid{n}": bipyramid(n) for n in range(3, 9)}
CLOSED |= {f"fine bipyramid{n}": refined(*bipyramid(n), 2) for n in (3, 5, 7, 8)}
OPEN = {"lattice": lattice(5, 4), "triangle": fan(3), "strip": lattice(6, 2)}
OPEN |= {f"fan{n}": refined(*fan(n)) for n in (3, 4, 5, 7)} | {f"half fan{k}": refined(*half_fan(k)) for k in (1, 4, 6)}
SHAPES = CLOSED | OPEN

closed = pytest.mark.parametrize("vertices, faces", CLOSED.values(), ids=CLOSED.keys())
shapes = pytest.mark.parametrize("vertices, faces", SHAPES.values(), ids=SHAPES.keys())
each_scheme = pytest.mark.parametrize("scheme", SCHEMES)


def edge_index(topology: Topology, a: int, b: int) -> int:
    return int(np.flatnonzero((topology.edges == sorted((a, b))).all(axis=1))[0])


def edge_row(vertices: np.ndarray, faces: np.ndarray, scheme: str, a: int, b: int, **options: Any) -> dict[int, float]:
    topology = build_topology(faces, len(vertices))
    matrix = schemes.subdivision_matrix(topology, scheme, **options).toarray()
    return nonzero(matrix[len(vertices) + edge_index(topology, a, b)])


def nonzero(row: np.ndarray) -> dict[int, float]:
    return {int(i): float(row[i]) for i in np.flatnonzero(np.abs(row) > 1e-14)}


def some_creases(topology: Topology) -> np.ndarray:
    return np.random.default_rng(1).random(len(topology.edges)) < 0.2


def distance_between_sets(a: np.ndarray, b: np.ndarray) -> float:
    assert a.shape == b.shape
    return max(cKDTree(a).query(b)[0].max(), cKDTree(b).query(a)[0].max())


# ---- truths -----------------------------------------------------------------------------------------------------


@shapes
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


@shapes
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
    middle = build_topology(refine_faces(topology), len(first))
    creases = refine_creases(topology, creases)
    second = schemes.subdivision_matrix(middle, "loop", creases=creases) @ first
    np.testing.assert_array_equal(operator.apply(vertices)[2], second)
    np.testing.assert_array_equal(operator.faces[2], refine_faces(middle))


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


# ---- creases ----------------------------------------------------------------------------------------------------


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
    for wrong in (np.array([[1, 3]]), np.array([99]), np.array([[0, 99]]), mask[:-1]):
        with pytest.raises(ValueError, match="crease"):
            crease_mask(topology, wrong)


# ---- Loop's limit surface ---------------------------------------------------------------------------------------


@shapes
@pytest.mark.parametrize("weights", ["loop", "warren"])
@pytest.mark.parametrize("with_creases", [False, True])
def test_limit_is_the_same_from_every_level(vertices, faces, weights, with_creases):
    vertices, topology = noisy(vertices, 0.02), build_topology(faces, len(vertices))
    creases = some_creases(topology) if with_creases else np.zeros(len(topology.edges), dtype=bool)
    fine = schemes.subdivision_matrix(topology, "loop", weights=weights, creases=creases) @ vertices
    finer = build_topology(refine_faces(topology), len(fine))
    position, normal = schemes.loop_limit(topology, vertices, weights=weights, creases=creases)
    creases_fine = refine_creases(topology, creases, finer)
    again, normal_again = schemes.loop_limit(finer, fine, weights=weights, creases=creases_fine)
    np.testing.assert_allclose(again[: len(vertices)], position, atol=ROUNDING)
    # A corner has no tangent plane: its normal is a mean over faces, which refinement may change.
    sharp = topology.edges[creases | topology.is_boundary_edge]
    has_tangents = np.bincount(sharp.reshape(-1), minlength=len(vertices)) < 3
    # Rounding of the tangents, divided by their length.
    np.testing.assert_allclose(normal_again[: len(vertices)][has_tangents], normal[has_tangents], atol=1e-10)


def test_limit_normals_of_a_sphere_point_outwards():
    vertices, faces = refined(*icosahedron(), 3)
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    position, normal = schemes.loop_limit(build_topology(faces, len(vertices)), vertices)
    outwards = position / np.linalg.norm(position, axis=1, keepdims=True)
    assert (normal * outwards).sum(axis=1).min() > np.cos(np.deg2rad(0.5))


@pytest.mark.parametrize("vertices, faces", OPEN.values(), ids=OPEN.keys())
def test_limit_normals_of_a_flat_patch_point_up(vertices, faces):
    _, normal = schemes.loop_limit(build_topology(faces, len(vertices)), vertices)
    np.testing.assert_allclose(normal, np.broadcast_to([0, 0, 1], normal.shape), atol=ROUNDING)


def test_limit_is_where_many_levels_end():
    vertices, faces = bipyramid(7)
    topology = build_topology(faces, 9)
    position, normal = schemes.loop_limit(topology, vertices)
    last = schemes.subdivision_operator(topology, "loop", 6).apply(vertices)[-1][:9]
    np.testing.assert_allclose(last, position, atol=1e-3)  # the distance falls by about four per level
    np.testing.assert_allclose(normal[7:], [[0, 0, 1], [0, 0, -1]], atol=ROUNDING)


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


def by_vtk(vertices: np.ndarray, faces: np.ndarray, kind: str) -> np.ndarray:
    mesh = pv.PolyData.from_regular_faces(vertices, faces).subdivide(1, kind)
    return np.asarray(mesh.points, dtype=np.float64)


@closed
@pytest.mark.parametrize("scheme, kind", [("midpoint", "linear"), ("loop", "loop"), ("butterfly", "butterfly")])
def test_closed_meshes_equal_vtk(vertices, faces, scheme, kind):
    vertices = noisy(vertices)
    fine = schemes.subdivision_matrix(build_topology(faces, len(vertices)), scheme) @ vertices
    assert distance_between_sets(fine, by_vtk(vertices, faces, kind)) < 1e-6  # VTK stores new points as float32


@shapes
def test_warren_weights_equal_igl(vertices, faces):
    vertices = noisy(vertices)
    fine = schemes.subdivision_matrix(build_topology(faces, len(vertices)), "loop", weights="warren") @ vertices
    assert distance_between_sets(fine, igl.loop(vertices, faces, 1)[0]) < ROUNDING


@shapes
def test_midpoints_equal_igl(vertices, faces):
    fine = schemes.subdivision_matrix(build_topology(faces, len(vertices)), "midpoint") @ vertices
    assert distance_between_sets(fine, igl.upsample(vertices, faces, 1)[0]) < ROUNDING
