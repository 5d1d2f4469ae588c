"""Truths of decimation: what every collapse keeps, what is refused.

`test_selfparam_criteria.py` has those of criteria and strategies, `test_selfparam_points.py` those of the map that
it leaves behind.
"""

import os
from collections.abc import Iterator
from types import SimpleNamespace

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shapes
from decimatable import CLOSED, OPEN, SHAPES, decimated, mesh_of, meshes
from neusub.compilation import announce, say_that_it_compiles
from neusub.errors import DecimationError
from neusub.mesh import Mesh
from neusub.selfparam import STRATEGIES, Criteria, SelfParameterization, decimate
from neusub.selfparam import decimation as door
from neusub.selfparam.collapse import DONE, FULL, STUCK, Work, collapse_null_edges, offer_all, run
from neusub.selfparam.queue import FIRST
from neusub.selfparam.surface import BORDER, SEAMS, TWIN, VERSION
from neusub.topology import connected_components


def facts(mesh: Mesh) -> tuple[int, int, int]:
    """What no collapse may change: Euler's number, the number of components and that of boundary loops."""
    topology = mesh.topology
    used, ends = np.unique(topology.edges[topology.is_boundary_edge], return_inverse=True)
    loops = connected_components(ends.reshape(-1, 2)[:, [0, 1, 1]], len(used))[0] if len(ends) else 0
    euler = len(mesh.vertices) - len(topology.edges) + len(mesh.faces)
    return euler, connected_components(mesh.faces, len(mesh.vertices))[0], loops


def volume(mesh: Mesh) -> float:
    """Enclosed, positive where faces are counter-clockwise seen from outside."""
    return np.linalg.det(mesh.vertices[mesh.faces]).sum() / 6


def same(one: SelfParameterization, other: SelfParameterization) -> bool:
    """To the last bit: coarse mesh and charts."""
    arrays = [(one.faces, other.faces), (one.decimated, other.decimated), *zip(one.charts, other.charts)]
    return all(a.tobytes() == b.tobytes() for a, b in arrays) and one.counts == other.counts


def farthest(points: np.ndarray, others: np.ndarray) -> float:
    """Largest distance of a point to the closest one of the others, coordinate by coordinate."""
    return np.abs(points[:, None] - others[None]).max(axis=2).min(axis=1).max()


@numba.cfunc(numba.float64(numba.float64))
def one_number(x):
    """No strategy."""
    return x


# --- what every collapse keeps -----------------------------------------------------------------------------------


def collapses(mesh: Mesh, strategy: str = "quadric", angle: float | None = None) -> Iterator[Work]:
    """The kernel's arrays before the first collapse and after each, until nothing can be collapsed."""
    plan, user = door.checked_strategy(strategy)
    work, _, _ = door.prepare(mesh, plan, (1, 0), 0, Criteria(), "conformal", angle)
    yield work
    left = 0
    while left != work.sizes[0]:  # edges without length, one a call: the target is one vertex less
        left = int(work.sizes[0])
        if collapse_null_edges(work, user, 0, left - 1, 0) < 3 * len(mesh.faces):
            work, left = door.with_room(work, len(mesh.faces)), 0
        elif work.sizes[0] < left:
            yield work
    offer_all(work, user)
    status = -1
    while status not in (STUCK, DONE):
        left = int(work.sizes[0])
        status = run(work, user, 1, 0, 1)
        if status == FULL:
            work = door.with_room(work, len(mesh.faces))
        if work.sizes[0] < left:
            yield work


def checked(work: Work) -> Mesh:
    """The current mesh, which has passed the checks of `Mesh`; every array of the kernel agrees with it."""
    surface, charts = work.surface, work.charts
    alive = np.flatnonzero(surface.faces[:, 0] >= 0)
    kept, corners = np.unique(surface.faces[alive, :3], return_inverse=True)
    mesh = Mesh(surface.positions[kept], corners.reshape(-1, 3))
    assert work.sizes[:2].tolist() == [len(kept), len(alive)]

    number = np.full(len(surface.faces), -1)
    number[alive] = np.arange(len(alive))
    all_twins = surface.faces[:, TWIN:SEAMS].reshape(-1)
    twins = all_twins.reshape(-1, 3)[alive].reshape(-1)
    assert np.array_equal(np.where(twins < 0, -1, 3 * number[twins // 3] + twins % 3), mesh.topology.twins)

    starts = surface.starts[kept]
    assert np.array_equal(surface.faces[starts // 3, starts % 3], kept)
    assert np.array_equal(all_twins[starts] < 0, mesh.topology.is_boundary_vertex)
    assert np.array_equal(surface.holds[kept] >= BORDER, mesh.topology.is_boundary_vertex)

    versions = surface.faces[alive, VERSION]
    assert len(np.unique(versions)) == len(versions)
    assert (charts.consumed_by[versions] < 0).all()
    assert np.array_equal(charts.made_by[versions] < 0, versions < len(surface.faces))

    edges = work.queue.entries[FIRST : FIRST + work.queue.size[0], 1].astype(np.int64)
    assert (number[edges // 3] >= 0).all()
    assert np.array_equal(work.queue.places[edges], np.arange(len(edges)))

    halfedges = (3 * alive[:, None] + np.arange(3)).reshape(-1)
    twins = all_twins[halfedges]
    is_out = work.queue.places[np.where(twins < 0, halfedges, np.minimum(halfedges, twins))] < 0
    assert work.refused[surface.faces[halfedges // 3, halfedges % 3]][is_out].all()  # so they will be offered again
    return mesh


@given(meshes(is_degenerate=True), st.sampled_from(list(STRATEGIES)), st.sampled_from([None, 45.0]))
@settings(max_examples=50)
def test_every_collapse_keeps_every_invariant(mesh, strategy, angle):
    sizes = []
    for work in collapses(mesh, strategy, angle):
        current = checked(work)
        assert facts(current) == facts(mesh)
        n_boundary = current.topology.is_boundary_vertex.sum()
        sizes.append((len(current.vertices), len(current.faces), n_boundary))
    # an inner edge takes two faces with it; a boundary edge takes one, and a boundary vertex
    assert {tuple(change) for change in np.diff(sizes, axis=0).tolist()} <= {(-1, -2, 0), (-1, -1, -1)}


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("name", SHAPES)
def test_decimation_keeps_euler_number_components_and_boundary_loops(name, strategy):
    result = decimated(name, strategy)
    assert result.reached
    assert facts(result.coarse) == facts(mesh_of(name))


@pytest.mark.parametrize("name", CLOSED)
def test_the_outside_stays_outside(name):
    # A coarse mesh cuts corners, but encloses half of the volume or more.
    assert volume(decimated(name).coarse) > 0.5 * volume(mesh_of(name)) > 0


def test_many_vertices_in_one_place_become_one():
    """Of a cone's tip: some of its edges may collapse only after others have."""
    n, rings = 20, 6
    turn = 2 * np.pi * np.arange(n) / n
    rows = [np.stack([s * np.cos(turn), s * np.sin(turn), 0 * turn + 1 - s], axis=1)
            for s in np.linspace(1, 0.2, rings)]
    vertices = np.concatenate([*rows, np.tile([0.0, 0, 1], (n + 1, 1))])
    at, after = np.arange(n), (np.arange(n) + 1) % n
    faces = np.concatenate([f for k in range(rings) for f in (
        np.stack([k * n + at, k * n + after, (k + 1) * n + after], axis=1),
        np.stack([k * n + at, (k + 1) * n + after, (k + 1) * n + at], axis=1))])
    tip = np.stack([rings * n + at, rings * n + after, np.full(n, (rings + 1) * n)], axis=1)
    result = decimate(Mesh(vertices, np.concatenate([faces, tip])), n_vertices=rings * n + 1)
    assert result.reached
    assert (np.abs(result.decimated - [0, 0, 1]).max(axis=1) < 1e-6).sum() == 1


@pytest.mark.parametrize(("options", "message"), [
    ({"seed": 1.5}, "seed = 1.5: take a whole number"), ({"seed": None}, "seed = None: take a whole number"),
    ({"sharp_boundary_angle": float("nan")}, "sharp_boundary_angle = nan: take degrees"),
    ({"strategy": one_number}, "strategy one_number is compiled for")])
def test_options_of_another_kind_are_named(options, message):
    with pytest.raises(DecimationError, match=message):
        decimate(Mesh(*SHAPES["sphere"]), n_vertices=40, **options)


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_edges_without_length_collapse_first(strategy):
    vertices, faces = shapes.with_null_edges(SHAPES["sphere"], 20)
    distinct = np.unique(vertices, axis=0)
    result = decimate(Mesh(vertices, faces), n_vertices=len(distinct), strategy=strategy)
    assert result.reached
    # Each place has one vertex now, and none moved: 1e-15 is two roundings, 1e-9 what minimising a quadric may lose.
    assert farthest(distinct, result.decimated) < (1e-9 if strategy not in ("edge-length", "removal") else 1e-15)


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("count", [3, 16, 642])
def test_many_vertices_on_one_point_collapse_or_are_refused(count, strategy):
    mesh = Mesh(*shapes.with_cluster(SHAPES["sphere"], 0, count))
    result = decimate(mesh, n_vertices=643 - count, strategy=strategy)
    assert facts(result.coarse) == facts(mesh)
    assert result.reached or sum(result.counts.values()) > result.counts["legal"]


def test_a_vertex_of_three_hundred_neighbours_decimates():
    mesh = Mesh(*shapes.cone(300))
    result = decimate(mesh, n_vertices=30)
    assert result.reached
    assert facts(result.coarse) == facts(mesh)


def test_room_for_charts_grows_and_changes_nothing(monkeypatch):
    mesh = Mesh(*shapes.with_null_edges(SHAPES["sphere"], 30))
    expected = decimate(mesh, n_vertices=100)
    monkeypatch.setattr(door, "CHART_SLOTS", 0)
    assert same(decimate(mesh, n_vertices=100), expected)


# --- targets -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SHAPES)
def test_a_number_of_vertices_is_met_exactly(name):
    result = decimate(mesh_of(name), n_vertices=97)
    assert result.reached
    assert len(result.decimated) == len(result.coarse.vertices) == 97


@pytest.mark.parametrize("name", SHAPES)
def test_a_number_of_faces_is_met_or_undercut_by_one(name):
    result = decimate(mesh_of(name), n_faces=150)
    assert result.reached
    assert len(result.faces) in (149, 150)


def test_a_tetrahedron_cannot_be_collapsed_and_says_so():
    result = decimate(Mesh(*shapes.tetrahedron()), n_vertices=3)
    assert not result.reached
    assert len(result.faces) == 4
    assert {reason: n for reason, n in result.counts.items() if n} == {"link condition": 6}


@pytest.mark.parametrize(("name", "least"), [("sphere", 4), ("torus", 7), ("cylinder", 6), ("two components", 8)])
def test_a_target_below_what_the_topology_allows_stops_cleanly(name, least):
    # least vertices of a triangulation: a tetrahedron, Moebius' torus, a prism without lids, two tetrahedra
    mesh = mesh_of(name)
    result = decimate(mesh, n_vertices=1)
    assert not result.reached
    assert len(result.decimated) >= least
    assert facts(result.coarse) == facts(mesh)
    assert result.counts["link condition"] > 0
    assert result.counts["legal"] == len(mesh.vertices) - len(result.decimated)


@pytest.mark.parametrize("strategy", ["quadric", "edge-length"])
def test_two_triangles_become_one(strategy):
    # Two corners of this square have one face only.
    result = decimate(Mesh(*shapes.grid(2, 2)), n_faces=1, strategy=strategy)
    assert result.reached
    assert len(result.faces) == 1


def test_progress_counts_down_to_the_target():
    seen = []
    decimate(mesh_of("sphere"), n_faces=200, on_progress=lambda left, target: seen.append((left, target)))
    assert seen == sorted(seen, reverse=True)
    assert seen[-1] == (200, 200)


# --- scale, position, boundary ----------------------------------------------------------------------------------


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("power", [-20, 20])
def test_a_power_of_two_as_scale_gives_the_same_bits(power, strategy):
    vertices, faces = SHAPES["sphere with holes"]
    result = decimate(Mesh(vertices * 2.0**power, faces), n_vertices=80, strategy=strategy)
    expected = decimated("sphere with holes", strategy)
    assert np.array_equal(result.faces, expected.faces)
    assert np.array_equal(result.decimated, expected.decimated * 2.0**power)


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize(("scale", "shift"), [(1e-6, 0), (1e6, 0), (1, 1e4)])
def test_scale_and_position_change_nothing_but_rounding(scale, shift, strategy):
    vertices, faces = SHAPES["sphere with holes"]
    result = decimate(Mesh(vertices * scale + shift, faces), n_vertices=80, strategy=strategy)
    expected = decimated("sphere with holes", strategy)
    assert np.array_equal(result.faces, expected.faces)  # no two edges of this mesh cost the same
    # coordinates of 1e4 carry 1e-12 of the mesh's size; minimising a quadric may lose three more digits
    assert np.abs(result.decimated - (expected.decimated * scale + shift)).max() < 1e-9 * scale


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_rotating_the_input_rotates_the_output(strategy):
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    vertices, faces = SHAPES["torus"]
    result = decimate(Mesh(vertices @ turn.T, faces), n_vertices=80, strategy=strategy)
    expected = decimated("torus", strategy)
    assert np.array_equal(result.faces, expected.faces)
    assert np.abs(result.decimated - expected.decimated @ turn.T).max() < 1e-11  # as above, from 1e-16


def corners_left(result: SelfParameterization) -> int:
    x, y = result.decimated[:, 0], result.decimated[:, 1]
    return int((np.isclose(abs(x), 1, atol=1e-12) & np.isclose(abs(y), 1, atol=1e-12)).sum())


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_sharp_corners_of_a_boundary_stay_where_they_are(strategy):
    vertices, faces = shapes.grid(17, 17)
    patch = Mesh(vertices / 8 - [1, 1, 0], faces)
    assert corners_left(decimate(patch, n_vertices=30, strategy=strategy, sharp_boundary_angle=45)) == 4


def test_without_the_angle_a_corner_may_be_cut():
    vertices, faces = shapes.grid(17, 17)
    patch = Mesh(vertices / 8 - [1, 1, 0], faces)
    assert corners_left(decimate(patch, n_vertices=30, strategy="edge-length")) < 4


# --- errors ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("options", "message"), [
    ({}, r"n_vertices = None, n_faces = None: give exactly one target"),
    ({"n_vertices": 9, "n_faces": 9}, r"n_vertices = 9, n_faces = 9: give exactly one target"),
    ({"n_vertices": 643}, r"n_vertices = 643: the mesh has 642\. Take a target from 1 to 642"),
    ({"n_faces": 1281}, r"n_faces = 1281: the mesh has 1280\. Take a target from 1 to 1280"),
    ({"n_vertices": 0}, r"n_vertices = 0: .* from 1 to 642"),
    ({"n_faces": -4}, r"n_faces = -4: .* from 1 to 1280"),
    ({"n_faces": 9, "strategy": "fast"}, r"strategy 'fast' is not one of quadric, random.*numba\.cfunc"),
    ({"n_faces": 9, "strategy": len}, r"strategy .*len.* is no compiled function\. Decorate it with @numba\.cfunc"),
    ({"n_faces": 9, "flattening": "tutte"}, r"flattening 'tutte' is not one of conformal, uniform"),
    ({"n_faces": 9, "strategy": "random", "seed": -1}, r"seed = -1: take a whole number, at least 0"),
])  # fmt: skip
def test_what_cannot_be_asked_for_is_refused(options, message):
    with pytest.raises(DecimationError, match=message):
        decimate(mesh_of("sphere"), **options)


@pytest.mark.parametrize("name", ["min_normal_dot", "min_quality", "tiny"])
def test_a_criterion_out_of_range_is_refused(name):
    with pytest.raises(ValueError, match=rf"{name} = 1\.5: take a number in .*, or None"):
        Criteria(**{name: 1.5})


def test_boundary_shapes_have_boundaries():
    assert all(facts(mesh_of(name))[2] > 0 for name in OPEN)
    assert all(facts(mesh_of(name))[2] == 0 for name in CLOSED)


def test_the_order_in_memory_changes_nothing_but_time(monkeypatch):
    mesh = mesh_of("genus 2")
    expected = decimate(mesh, n_vertices=60)
    monkeypatch.setattr(door, "LARGE", 0)
    result = decimate(mesh, n_vertices=60)
    assert facts(result.coarse) == facts(expected.coarse)
    assert farthest(expected.decimated, result.decimated) < 1e-12  # the costs of a noisy mesh have no ties

    def centres_below(parameterization: SelfParameterization) -> np.ndarray:
        centres = np.full((len(mesh.faces), 3), 1 / 3)
        faces, barycentric = parameterization.to_coarse(np.arange(len(mesh.faces)), centres)
        return (barycentric[:, :, None] * parameterization.decimated[parameterization.faces[faces]]).sum(axis=1)

    np.testing.assert_allclose(centres_below(result), centres_below(expected), atol=1e-9)


def test_a_compilation_is_announced_once_on_a_machine(tmp_path, caplog):
    stats = SimpleNamespace(cache_path=str(tmp_path))
    fresh, known = (SimpleNamespace(py_func=run.py_func, stats=stats, signatures=x) for x in ([], ["compiled"]))

    def announced(kernel) -> list[str]:
        say_that_it_compiles.cache_clear()
        caplog.clear()
        announce(kernel, "kernels")
        return [record.message for record in caplog.records]

    assert announced(fresh) == ["neusub: compiling kernels, once on this machine ..."]
    announce(fresh, "kernels")  # another one that belongs to the first
    assert len(caplog.records) == 1
    assert announced(known) == []
    kept = tmp_path / "collapse.run-75.py311.nbi"  # as numba names them
    kept.touch()
    assert announced(fresh) == []
    os.utime(kept, (0, 0))  # of an older version of neusub
    assert len(announced(fresh)) == 1


@pytest.mark.parametrize("target", [2.5, True, "10"])
def test_a_target_that_is_no_whole_number_is_named(target):
    with pytest.raises(DecimationError, match="take a whole number"):
        decimate(Mesh(*shapes.icosphere(1)), n_faces=target)
