"""Distances between surfaces whose distance is known."""

import numpy as np
import pytest

import shapes
from neusub.mesh import Mesh
from neusub.metrics import distance, sample_surface, triangle_quality


def sphere(radius: float = 1.0, levels: int = 4) -> Mesh:
    vertices, faces = shapes.icosphere(levels)
    return Mesh(radius * vertices / np.linalg.norm(vertices, axis=1, keepdims=True), faces)


def plane(height: float, n: int = 4) -> Mesh:
    vertices, faces = shapes.grid(n, n)
    return Mesh(vertices + [0, 0, height], faces)


def test_a_mesh_has_no_distance_to_itself():
    result = distance(sphere(), sphere(), samples=2000)
    assert result.hausdorff < 1e-7
    assert result.normal_angle < 1e-3
    assert (result.flipped, result.degenerate) == (0, 0)


def test_offset_planes_are_exactly_their_offset_apart():
    result = distance(plane(0.25), plane(0.0), samples=1000)
    for value in (result.hausdorff, result.mean, result.rms_forward, result.rms_backward):
        assert value == pytest.approx(0.25, abs=1e-12)


def test_concentric_spheres_are_the_difference_of_their_radii_apart():
    result = distance(sphere(1.1), sphere(1.0))
    assert result.mean == pytest.approx(0.1, abs=1e-3)  # the chords of 5120 faces
    assert result.hausdorff == pytest.approx(0.1, abs=2e-3)


def test_a_part_lies_on_the_whole_but_not_the_other_way_round():
    whole = sphere()
    upper = whole.faces[(whole.vertices[whole.faces, 2] > 0).all(axis=1)]
    used, faces = np.unique(upper, return_inverse=True)
    half = Mesh(whole.vertices[used], faces.reshape(-1, 3))
    result = distance(half, whole)
    assert result.max_forward < 1e-7
    assert result.max_backward == pytest.approx(np.sqrt(2), abs=0.1)
    assert result.larger_side == "backward"


def test_a_rigid_motion_of_both_changes_nothing():
    turn, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    a, b = sphere(1.1, 2), sphere(1.0, 3)
    still = distance(a, b, samples=3000)
    moved = distance(Mesh(a.vertices @ turn.T + 5, a.faces), Mesh(b.vertices @ turn.T + 5, b.faces), samples=3000)
    assert moved.mean == pytest.approx(still.mean, abs=1e-12)
    assert moved.hausdorff == pytest.approx(still.hausdorff, abs=1e-12)


def test_the_seed_decides_the_samples():
    a, b = sphere(1.1, 2), sphere(1.0, 3)
    assert distance(a, b, 500, seed=3) == distance(a, b, 500, seed=3)
    assert distance(a, b, 500, seed=3).mean != distance(a, b, 500, seed=4).mean


def test_an_inside_out_sphere_is_flipped():
    ball = sphere(levels=2)
    assert distance(Mesh(ball.vertices, ball.faces[:, ::-1]), ball, 500).flipped == 1
    assert distance(Mesh(ball.vertices, ball.faces[:, ::-1]), ball, 500).normal_angle == pytest.approx(180, abs=1e-3)


def test_faces_without_area_are_counted_and_do_no_harm():
    mesh = Mesh(*shapes.collinear_face())
    result = distance(mesh, sphere(), 500)
    assert 0 < result.degenerate < 1
    assert np.isfinite(result.hausdorff)


def test_samples_are_uniform_by_area():
    vertices = np.array([[0, 0, 0], [3.0, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]])
    _, faces = sample_surface(Mesh(vertices, np.array([[0, 1, 2], [3, 4, 5]])), 20_000, np.random.default_rng(0))
    assert np.mean(faces == 0) == pytest.approx(0.75, abs=0.015)  # five standard deviations


def test_quality_is_one_for_an_equilateral_triangle_and_zero_without_area():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0], [2, 0, 0]])
    assert triangle_quality(vertices, np.array([[0, 1, 2], [0, 1, 3]])) == pytest.approx([1, 0])


def test_the_distance_equals_pymeshlabs():
    pymeshlab = pytest.importorskip("pymeshlab", reason="pymeshlab is not installed: its Hausdorff filter is no peer")
    a, b = sphere(1.0, 2), sphere(1.05, 3)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(a.vertices, a.faces))
    meshes.add_mesh(pymeshlab.Mesh(b.vertices, b.faces))
    theirs = meshes.get_hausdorff_distance(sampledmesh=0, targetmesh=1, samplevert=False, sampleface=True,
                                           samplenum=50_000)
    ours = distance(a, b, samples=50_000)
    assert ours.mean_forward == pytest.approx(theirs["mean"], rel=0.02)
    assert ours.max_forward == pytest.approx(theirs["max"], rel=0.02)


def test_what_cannot_be_measured_is_named():
    ball = Mesh(*shapes.icosphere(1))
    with pytest.raises(ValueError, match="seed = -1"):
        distance(ball, ball, seed=-1)
    with pytest.raises(TypeError, match="reference is a str: load a file"):
        distance(ball, "ball.obj")
