"""Truths of decimation: what its criteria refuse and what its strategies choose."""

import igl
import numba
import numpy as np
import pytest

import shapes
from decimatable import SHAPES, decimated, mesh_of
from neusub.mesh import Mesh
from neusub.metrics import distance, triangle_quality
from neusub.selfparam import PLACE, REASONS, STRATEGIES, Criteria, decimate
from neusub.selfparam import decimation as door
from neusub.selfparam.collapse import PAUSED, offer_all, run
from neusub.selfparam.surface import make_ring
from patches import bipyramid
from test_selfparam import facts, farthest, same

# --- criteria ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("name", SHAPES)
def test_no_coarse_triangle_is_worse_than_the_bound_or_the_worst_of_the_input(name, strategy):
    mesh, result = mesh_of(name), decimated(name, strategy)
    bound = min(0.2, triangle_quality(mesh.vertices, mesh.faces).min())
    assert triangle_quality(result.decimated, result.faces).min() > bound - 1e-12  # rounding of the positions


@pytest.mark.parametrize(("parameter", "value", "reasons"), [
    ("min_normal_dot", None, ["normal flip"]),
    ("min_quality", None, ["quality in space", "quality in the plane"]),
    ("plane_flips", False, ["plane flip before", "plane flip after"]),
])  # fmt: skip
def test_a_criterion_that_is_off_refuses_nothing(parameter, value, reasons):
    assert all(decimated("stretched").counts[reason] > 0 for reason in reasons)
    result = decimate(mesh_of("stretched"), n_vertices=80, criteria=Criteria(**{parameter: value}))
    assert all(result.counts[reason] == 0 for reason in reasons)


@pytest.mark.parametrize("strategy", ["quadric", "random"])
def test_what_is_far_smaller_than_a_coarse_face_vanishes_and_the_map_holds(strategy):
    mesh = Mesh(*shapes.pocket())

    def inside(criteria: Criteria) -> int:
        result = decimate(mesh, n_vertices=40, strategy=strategy, criteria=criteria)
        off_centre = np.linalg.norm(result.decimated - [0, 0, shapes.POCKET_HEIGHT], axis=1)
        points = np.random.default_rng(0).dirichlet([1, 1, 1], 5000)
        faces = np.arange(5000) % len(result.faces)
        back_faces, back = result.to_coarse(*result.to_fine(faces, points))
        corners = result.decimated[result.faces]
        moved = np.einsum("nk,nkd->nd", points, corners[faces]) - np.einsum("nk,nkd->nd", back, corners[back_faces])
        assert result.reached and np.abs(moved).max() < 1e-6
        return int((off_centre < 1.3 * shapes.POCKET).sum())

    assert inside(Criteria(tiny=None)) > 5 > 1 >= inside(Criteria())


def test_every_edge_that_is_tried_is_counted_once():
    plan, user = door.checked_strategy("quadric")
    work, _, _ = door.prepare(mesh_of("stretched"), plan, (40, 0), 0, Criteria(), "conformal", None)
    offer_all(work, user)
    status = PAUSED
    while status == PAUSED:
        is_tried, before = work.queue.size[0] > 0, work.counts.sum()  # an empty queue is filled again instead
        status = run(work, user, 40, 0, 1)
        assert status != PAUSED or work.counts.sum() == before + is_tried
    assert dict(zip(REASONS, work.counts))["legal"] == len(mesh_of("stretched").vertices) - work.sizes[0]


def test_a_ring_larger_than_the_scratch_arrays_is_refused_under_its_name():
    plan, user = door.checked_strategy("quadric")
    work, _, _ = door.prepare(mesh_of("sphere"), plan, (1, 0), 0, Criteria(), "conformal", None)
    work = work._replace(ring=make_ring(5))  # rings of the sphere have six vertices and more
    offer_all(work, user)
    n_edges = len(mesh_of("sphere").topology.edges)
    run(work, user, 1, 0, n_edges)
    assert dict(zip(REASONS, work.counts))["valence"] == n_edges


def test_inner_edges_between_boundary_vertices_never_collapse():
    vertices, faces = shapes.grid(5, 4)
    vertices[17] = vertices[12]  # both ends of the edge that cuts off a corner: without length, it is tried first
    result = decimate(Mesh(vertices, faces), n_vertices=1)
    assert result.counts["boundary"] >= 1
    assert facts(result.coarse) == (1, 1, 1)


# --- strategies --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape, n_faces", [(bipyramid(100), 100), (shapes.grid(60, 2), 20)])
def test_faces_that_stay_as_thin_as_they_were_do_not_stop_a_removal(shape, n_faces):
    vertices, faces = shape
    mesh = Mesh(vertices * [0.1, 1, 1], faces)  # thinner than the bound
    assert triangle_quality(mesh.vertices, mesh.faces).min() < 0.2
    assert decimate(mesh, n_faces=n_faces, strategy="removal").reached


@pytest.mark.parametrize("name", SHAPES)
def test_removal_keeps_input_vertices(name):
    fine, coarse = mesh_of(name).vertices, decimated(name, "removal").decimated
    assert farthest(coarse, fine) < 1e-15 * np.ptp(fine)  # two roundings of the normalised frame


def test_the_same_seed_gives_the_same_bytes_and_another_one_does_not():
    one, again, other = (decimate(mesh_of("sphere"), n_vertices=80, strategy="random", seed=s) for s in (1, 1, 2))
    assert same(one, again)
    assert not np.array_equal(one.faces, other.faces)


@numba.cfunc(PLACE)
def edge_length_of_a_user(a, b, quadric, position):
    cost = 0.0
    for axis in range(3):
        cost += (a[axis] - b[axis]) ** 2
        position[axis] = (a[axis] + b[axis]) / 2
    return cost


@numba.cfunc(PLACE)
def never(a, b, quadric, position):
    return np.inf


@pytest.mark.parametrize("name", ["sphere", "sphere with holes"])
def test_a_users_strategy_does_what_the_built_in_one_does_and_compiles_no_kernel(name):
    built_in = decimate(mesh_of(name), n_vertices=80, strategy="edge-length")
    kernels = len(run.signatures)
    assert same(decimate(mesh_of(name), n_vertices=80, strategy=edge_length_of_a_user), built_in)
    assert len(run.signatures) == kernels


def test_an_edge_of_infinite_cost_stays():
    result = decimate(mesh_of("sphere"), n_vertices=80, strategy=never)
    assert not result.reached
    assert np.array_equal(result.faces, mesh_of("sphere").faces)


def test_quadric_positions_are_as_close_to_a_sphere_as_those_of_qslim():
    sphere = Mesh(*shapes.icosphere(4))
    vertices, faces = igl.qslim(np.asfortranarray(sphere.vertices), np.asfortranarray(sphere.faces, np.int32), 200)[:2]
    ours = decimate(sphere, n_faces=200).coarse
    # Measured 0.99 times; room for other libraries' order of equal costs.
    assert distance(ours, sphere).mean < 1.3 * distance(Mesh(vertices, faces), sphere).mean
