"""Truths of MAPS (Lee et al. 1998): its levels, its flattening and retriangulation, and the map it leaves behind."""

import sys
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shapes
from decimatable import OPEN, SHAPES, mesh_of, meshes
from neusub.errors import DecimationError
from neusub.map_pictures import chart_faces, chart_uv
from neusub.mesh import Mesh
from neusub.selfparam import Criteria, SelfParameterization, decimate, maps
from neusub.selfparam.maps import Work, decimate_maps, delaunay, flatten_ring, independent_set, remove, remove_level
from neusub.selfparam.priorities import ring_measures
from neusub.topology import topology_levels
from test_selfparam import facts, same
from test_selfparam_points import (
    apart,
    areas,
    assert_returns,
    assert_valid,
    distance_to_boundary,
    edge_points,
    on_halfedges,
    random_points,
)

shapely = pytest.importorskip("shapely", reason="shapely is absent: MAPS is not tested")
EACH_SHAPE = pytest.mark.parametrize("name", SHAPES)


@cache
def decimated(name: str) -> SelfParameterization:
    return decimate_maps(mesh_of(name), n_vertices=80)


def refused(result: SelfParameterization) -> dict[str, int]:
    return {reason: n for reason, n in result.counts.items() if n and reason != "legal"}


# --- the coarse mesh ---------------------------------------------------------------------------------------------


@EACH_SHAPE
def test_the_target_is_met_exactly_and_the_topology_stays(name):
    result = decimated(name)
    assert result.reached
    assert result.strategy == "maps"
    assert len(result.decimated) == 80
    assert result.counts["legal"] == len(mesh_of(name).vertices) - 80
    assert facts(result.coarse) == facts(mesh_of(name))  # `Mesh` has checked that it is manifold


@given(meshes(is_degenerate=True), st.floats(0, 1))
@settings(max_examples=50)
def test_random_meshes_keep_their_topology(mesh, share):
    result = decimate_maps(mesh, n_vertices=max(1, round(share * len(mesh.vertices))))
    assert facts(result.coarse) == facts(mesh)
    assert_valid(result.to_fine(*random_points(len(result.faces), 500)), len(mesh.faces))
    assert_valid(result.to_coarse(*random_points(len(mesh.faces), 500)), len(result.faces))


@EACH_SHAPE
def test_coarse_vertices_are_fine_vertices_and_map_to_themselves(name):
    result = decimated(name)
    rows = {tuple(row) for row in result.fine.vertices.tolist()}
    assert all(tuple(row) in rows for row in result.decimated.tolist())
    assert np.array_equal(result.on_surface.vertices, result.decimated)


def test_the_same_mesh_gives_the_same_bytes_at_any_scale():
    mesh = mesh_of("sphere with holes")
    again = decimate_maps(mesh, n_vertices=80)
    assert same(again, decimated("sphere with holes"))
    for power in (-20, 20):
        assert np.array_equal(decimate_maps(Mesh(mesh.vertices * 2.0**power, mesh.faces), n_vertices=80).faces,
                              again.faces)


def test_progress_counts_down_to_the_target():
    seen = []
    decimate_maps(mesh_of("sphere"), n_vertices=200, on_progress=lambda left, target: seen.append((left, target)))
    assert len(seen) > 2
    assert seen == sorted(seen, reverse=True)
    assert seen[-1] == (200, 200)


# --- the map -----------------------------------------------------------------------------------------------------


@EACH_SHAPE
def test_points_return(name):
    assert_returns(decimated(name))


@given(meshes(), st.floats(0, 1))
@settings(max_examples=50)
def test_points_of_random_meshes_return(mesh, share):
    assert_returns(decimate_maps(mesh, n_vertices=max(1, round(share * len(mesh.vertices)))), 500)


@EACH_SHAPE
def test_points_of_the_fine_mesh_cover_every_coarse_face(name):
    result = decimated(name)
    assert len(np.unique(result.to_coarse(*random_points(len(result.fine.faces)))[0])) == len(result.faces)


@EACH_SHAPE
def test_the_map_is_continuous_across_edges(name):
    result = decimated(name)
    left, right = edge_points(result.coarse)
    up = apart(result.fine, result.to_fine(*left), result.to_fine(*right))
    left, right = edge_points(result.fine)
    down = apart(result.coarse, result.to_coarse(*left), result.to_coarse(*right))
    assert max(up.max(), down.max()) < 1e-9  # rounding, in faces of quality 1e-4 and more


@pytest.mark.parametrize("name", OPEN)
def test_boundary_points_map_to_boundary_points(name):
    result, rng = decimated(name), np.random.default_rng(0)
    for source, target, there in ((result.coarse, result.fine, result.to_fine),
                                  (result.fine, result.coarse, result.to_coarse)):  # fmt: skip
        border = rng.choice(np.flatnonzero(source.topology.twins < 0), 5000)
        image = there(*on_halfedges(border, rng.random(5000)))
        assert distance_to_boundary(target, image).max() < 1e-9  # rounding of the plane's coordinates


@EACH_SHAPE
def test_a_chart_covers_the_same_ground_before_and_after(name):
    result = decimated(name)
    for c in range(int(result.charts.used[0])):
        solid = np.pad(chart_uv(result, c), [(0, 0), (0, 1)])
        before, after = (areas(solid, chart_faces(result, c, is_after)[0]).sum() for is_after in (False, True))
        assert before > 0
        assert np.isclose(before, after, rtol=1e-9)


def test_a_saved_map_gives_the_same_answers(tmp_path):
    result = decimated("patch")
    result.save(tmp_path / "map.safetensors")
    loaded = SelfParameterization.load(tmp_path / "map.safetensors")
    assert loaded.strategy == "maps"
    points = random_points(len(result.faces))
    assert all(np.array_equal(a, b) for a, b in zip(result.to_fine(*points), loaded.to_fine(*points)))


def test_the_report_knows_the_removals():
    report = decimated("patch").report()
    assert report.collapses == 220
    assert report.degenerate == 0


# --- levels ------------------------------------------------------------------------------------------------------


@given(meshes(), st.integers(0, 2**32 - 1), st.floats(0, 1))
@settings(max_examples=50)
def test_an_independent_set_is_independent_and_maximal_among_what_is_accepted(mesh, seed, share):
    n, edges = len(mesh.vertices), mesh.topology.edges
    rng = np.random.default_rng(seed)
    is_accepted = rng.random(n) < share
    around = [np.concatenate([edges[edges[:, 0] == v, 1], edges[edges[:, 1] == v, 0]]).tolist() for v in range(n)]
    order = rng.permutation(n).tolist()
    taken = independent_set(order, around.__getitem__, is_accepted.__getitem__, n)
    is_taken = np.isin(np.arange(n), taken)
    assert is_accepted[taken].all()
    assert not is_taken[edges].all(axis=1).any()
    assert all(is_taken[[v, *around[v]]].any() for v in np.flatnonzero(is_accepted))
    assert taken == sorted(taken, key=order.index)
    assert independent_set(order, around.__getitem__, is_accepted.__getitem__, 2) == taken[:2]


@EACH_SHAPE
def test_a_level_leaves_only_vertices_beside_removed_ones_and_refused_ones(name, monkeypatch):
    mesh, tried = mesh_of(name), []
    monkeypatch.setattr(maps, "remove", lambda work, star: tried.append(star.vertex) or remove(work, star))
    work = Work(mesh, 12, Criteria().packed(), shapely)
    removed = remove_level(work, 0.5, len(mesh.vertices))
    edges = mesh.topology.edges
    is_removed = np.isin(np.arange(len(mesh.vertices)), removed)
    assert not is_removed[edges].all(axis=1).any()
    beside = np.unique(edges[is_removed[edges].any(axis=1)])
    assert set(range(len(mesh.vertices))) - set(beside.tolist()) <= set(tried) - set(removed)
    assert work.counts.tolist()[0] == len(removed)
    assert work.counts.sum() == len(tried) == len(set(tried))
    assert not set(removed) & set(work.faces().reshape(-1).tolist())


def test_measures_of_a_torus_and_of_a_square():
    torus = Mesh(*shapes.torus(100, 60))
    area, curvature = ring_measures(torus.vertices, torus.topology)
    assert np.isclose(area.sum() / 3, 4 * np.pi**2 * 0.4, rtol=0.01)  # the polyhedron lies inside
    radius = np.linalg.norm(torus.vertices[:, :2], axis=1)
    expected = 1 / 0.4 + np.abs(radius - 1) / 0.4 / radius  # of a parallel: the cosine of its slope over its radius
    assert np.allclose(curvature, expected, atol=0.005)  # measured 0.0027; the square of the edges' length over 0.4
    square = Mesh(*shapes.grid(5, 5))
    area, curvature = ring_measures(square.vertices, square.topology)
    assert np.isclose(area.sum() / 3, 16)
    corner = np.isin(square.vertices[:, :2], [0, 4]).all(axis=1)
    assert np.allclose(curvature[~corner], 0, atol=1e-7)  # a root of rounding
    assert np.allclose(curvature[corner], np.sqrt(2))  # of a turn by 90 degrees, over a length of 1


# --- one removal -------------------------------------------------------------------------------------------------


def flattened(points: np.ndarray, is_open: bool) -> np.ndarray:
    """Places of the ring as complex numbers; its centre, the last point, is at 0."""
    uv = np.full((len(points), 2), np.nan)
    flatten_ring(points, is_open, uv)
    assert (uv[-1] == 0).all()
    return uv[:-1] @ [1, 1j]


def lifted(ring: np.ndarray) -> np.ndarray:
    """Complex numbers, and 0, somewhere in space."""
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    z = np.append(ring, 0)
    return np.stack([z.real, z.imag, 0 * z.real], axis=1) @ turn.T + [1, 2, 3]


@given(st.integers(3, 12), st.integers(0, 2**32 - 1))
def test_a_flat_ring_flattens_by_a_similarity(d, seed):
    rng = np.random.default_rng(seed)
    ring = rng.uniform(0.2, 1, d) * np.exp(2j * np.pi * (np.arange(d) + rng.uniform(-0.2, 0.2, d)) / d)
    place = flattened(lifted(ring), False)
    assert np.abs(place / ring - place[0] / ring[0]).max() < 1e-13 * abs(place[0] / ring[0])


@given(st.integers(3, 12), st.integers(0, 2**32 - 1))
def test_a_flat_half_ring_flattens_by_a_similarity_with_its_ends_on_a_line(d, seed):
    rng = np.random.default_rng(seed)
    ring = rng.uniform(0.2, 1, d) * np.exp(1j * np.pi * np.linspace(0, 1, d))
    place = flattened(lifted(ring), True)
    assert np.abs(place / ring - place[0] / ring[0]).max() < 1e-13 * abs(place[0] / ring[0])
    assert place[0].imag == place[-1].imag == 0


def test_a_right_corner_is_squared_and_a_cone_becomes_a_disc():
    ring = np.array([1, 0.8 * np.exp(0.3j), 0.5 * np.exp(1.1j), 0.9j])
    assert np.abs(flattened(lifted(ring), True) - ring**2).max() < 1e-14
    vertices, _ = shapes.cone(8)  # eight equal angles, less than 45 degrees each
    place = flattened(vertices, False)
    assert np.abs(place - np.exp(2j * np.pi * np.arange(8) / 8)).max() < 1e-14


def test_a_rhombus_is_split_along_its_shorter_diagonal():
    ring = np.array([[-2.0, 0], [0, -1], [2, 0], [0, 1]])
    assert sorted(delaunay(shapely, ring).tolist()) == [[0, 1, 3], [1, 2, 3]]


def test_corners_on_a_straight_side_are_kept():
    ring = np.array([[0.0, 0], [1, 0], [2, 0], [2, 1], [2, 2], [1, 2], [0, 2], [0, 1]])
    made = delaunay(shapely, ring)
    assert len(made) == 6
    assert (areas(np.pad(ring, [(0, 0), (0, 1)]), made) > 0).all()


@given(st.integers(4, 12), st.integers(0, 2**32 - 1))
def test_a_star_shaped_ring_is_triangulated_locally_delaunay(d, seed):
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * (np.arange(d) + rng.uniform(-0.2, 0.2, d)) / d
    ring = rng.uniform(0.3, 1, d)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    made = delaunay(shapely, ring)
    assert len(made) == d - 2
    topology = Mesh(np.pad(ring, [(0, 0), (0, 1)]), made).topology
    for h, g in topology.edge_halfedges[~topology.is_boundary_edge]:
        a, b, c = ring[np.roll(made[h // 3], -(h % 3))]
        d = ring[made[g // 3][(g % 3 + 2) % 3]]
        rows = np.array([[*(p - d), (p - d) @ (p - d)] for p in (a, b, c)])
        assert np.linalg.det(rows) < 1e-12  # d does not lie in the circle through a, b, c


# --- refusals ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("shape", "options", "expected"), [
    (shapes.tetrahedron(), {}, {"link condition": 4}),
    (shapes.icosahedron(), {"max_valence": 4}, {"valence": 12}),
    (shapes.grid(2, 2), {}, {"boundary": 5}),  # both corners of one face; then all three of the triangle left
])  # fmt: skip
def test_refused_removals_are_counted_by_reason(shape, options, expected):
    result = decimate_maps(Mesh(*shape), n_vertices=1, **options)
    assert not result.reached
    assert refused(result) == expected
    assert facts(result.coarse) == facts(Mesh(*shape))


def test_edges_without_length_are_not_flattened():
    vertices, faces = shapes.with_null_edges(SHAPES["sphere"], 20)
    result = decimate_maps(Mesh(vertices, faces), n_vertices=80)
    assert result.counts["plane flip before"] > 0


@pytest.mark.parametrize(("parameter", "reasons"), [
    ("min_normal_dot", ["normal flip"]),
    ("min_quality", ["quality in space", "quality in the plane"]),
])  # fmt: skip
def test_a_criterion_that_is_off_refuses_nothing(parameter, reasons):
    assert all(decimated("stretched").counts[reason] > 0 for reason in reasons)
    result = decimate_maps(mesh_of("stretched"), n_vertices=80, criteria=Criteria(**{parameter: None}))
    assert all(result.counts[reason] == 0 for reason in reasons)


@pytest.mark.parametrize(("options", "message"), [
    ({"n_vertices": 643}, r"n_vertices = 643: the mesh has 642\. Take a target from 1 to 642"),
    ({"n_vertices": 0}, r"n_vertices = 0: .* from 1 to 642"),
    ({"n_vertices": 9, "weight": 1.5}, r"weight = 1\.5: take a number from 0 to 1"),
])  # fmt: skip
def test_what_cannot_be_asked_for_is_refused(options, message):
    with pytest.raises(DecimationError, match=message):
        decimate_maps(mesh_of("sphere"), **options)


def test_without_shapely_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "shapely", None)
    with pytest.raises(DecimationError, match=r"shapely >= 2\.1, found none: run pip install 'neusub\[maps\]'"):
        decimate_maps(mesh_of("sphere"), n_vertices=80)


# --- the paper's comparison --------------------------------------------------------------------------------------


def uneven_sphere(times: float) -> Mesh:
    """An icosphere through a Moebius map: well-shaped triangles, at one pole times^4 larger than at the other."""
    vertices, faces = shapes.icosphere(4)
    z = vertices[:, 2]
    up, down = (1 + z) * times**2, 1 - z
    places = vertices * (2 * times / (up + down))[:, None]
    places[:, 2] = (up - down) / (up + down)
    return Mesh(places, faces)


def area_variation(result: SelfParameterization, levels: int = 2) -> float:
    area = areas(result.transfer(result.fine.vertices, levels),
                 topology_levels(result.faces, len(result.decimated), levels)[1])
    return float(area.std() / area.mean())


def test_on_an_uneven_triangulation_maps_is_less_uniform_than_area_weighted_quadrics():
    mesh = uneven_sphere(3)
    theirs, ours = decimate_maps(mesh, n_vertices=100), decimate(mesh, n_vertices=100, strategy="uniform")
    assert theirs.reached and ours.reached
    # fig:uniformRemesh; measured 1.7 and 0.2
    assert area_variation(theirs) > 4 * area_variation(ours)
