"""Truths of the map that a decimation leaves behind: bijective, continuous, exact where the surface is flat."""


import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shapes
from decimatable import OPEN, SHAPES, decimated, mesh_of, meshes
from neusub.errors import ParameterizationError, TooLargeError
from neusub.mesh import Mesh
from neusub.selfparam import STRATEGIES, SelfParameterization, decimate
from neusub.topology import topology_levels

COUNT = 20_000
EACH_SHAPE = pytest.mark.parametrize("name", SHAPES)
EACH_STRATEGY = pytest.mark.parametrize("strategy", STRATEGIES)
Points = tuple[np.ndarray, np.ndarray]


def random_points(n_faces: int, count: int = COUNT, seed: int = 0) -> Points:
    rng = np.random.default_rng(seed)
    return rng.integers(0, n_faces, count), rng.dirichlet([1, 1, 1], count)


def positions(mesh: Mesh, points: Points) -> np.ndarray:
    return np.einsum("nk,nkd->nd", points[1], mesh.vertices[mesh.faces[points[0]]])


def apart(mesh: Mesh, points: Points, others: Points) -> np.ndarray:
    """Distance of each point to its other, in diagonals of the box."""
    difference = positions(mesh, points) - positions(mesh, others)
    return np.linalg.norm(difference, axis=1) / np.linalg.norm(np.ptp(mesh.vertices, axis=0))


def areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def assert_returns(result: SelfParameterization, count: int = COUNT) -> None:
    """Both ways and back: 99.9 % within 1e-9 of the diagonal, all within 1e-6, by rounding in slivers."""
    down, up = random_points(len(result.fine.faces), count), random_points(len(result.faces), count)
    for distance in (apart(result.coarse, up, result.to_coarse(*result.to_fine(*up))),
                     apart(result.fine, down, result.to_fine(*result.to_coarse(*down)))):  # fmt: skip
        assert np.quantile(distance, 0.999) < 1e-9
        assert distance.max() < 1e-6


def assert_valid(points: Points, n_faces: int) -> None:
    faces, barycentric = points
    assert 0 <= faces.min() <= faces.max() < n_faces
    assert np.isfinite(barycentric).all()
    assert barycentric.min() >= 0
    assert np.abs(barycentric.sum(axis=1) - 1).max() < 1e-15


# --- there and back ----------------------------------------------------------------------------------------------


@EACH_SHAPE
def test_the_map_is_the_identity_before_the_first_collapse(name):
    mesh = mesh_of(name)
    result = decimate(mesh, n_vertices=len(mesh.vertices))
    assert result.reached
    assert np.array_equal(result.faces, mesh.faces)
    assert np.abs(result.decimated - mesh.vertices).max() < 1e-15 * np.ptp(mesh.vertices)  # normalised and back
    for there in (result.to_fine, result.to_coarse):
        points = random_points(len(mesh.faces))
        faces, barycentric = there(*points)
        assert np.array_equal(faces, points[0])
        assert np.abs(barycentric - points[1]).max() < 1e-15  # divided by their sum


@EACH_STRATEGY
@EACH_SHAPE
def test_images_have_valid_barycentric_coordinates(name, strategy):
    result = decimated(name, strategy)
    assert_valid(result.to_fine(*random_points(len(result.faces))), len(result.fine.faces))
    assert_valid(result.to_coarse(*random_points(len(result.fine.faces))), len(result.faces))


@EACH_STRATEGY
@EACH_SHAPE
def test_points_return(name, strategy):
    assert_returns(decimated(name, strategy))


@EACH_SHAPE
def test_points_return_with_uniform_weights_too(name):
    assert_returns(decimate(mesh_of(name), n_vertices=80, flattening="uniform"))


@pytest.mark.parametrize("turns", [0.75, 1.25, 2.25])
def test_points_return_where_a_boundary_vertex_has_faces_all_around_and_more(turns):
    mesh = Mesh(*shapes.bumpy(shapes.spiral_stair(turns)))
    assert_returns(decimate(mesh, n_vertices=len(mesh.vertices) // 2))


@given(meshes(), st.sampled_from(list(STRATEGIES)), st.floats(0, 1), st.sampled_from([None, 45.0]))
@settings(max_examples=50)
def test_points_of_random_meshes_return(mesh, strategy, share, angle):
    n_vertices = max(1, round(share * len(mesh.vertices)))
    assert_returns(decimate(mesh, n_vertices=n_vertices, strategy=strategy, sharp_boundary_angle=angle), 500)


@given(meshes(is_degenerate=True), st.sampled_from(list(STRATEGIES)))
@settings(max_examples=30)
def test_images_are_valid_where_faces_have_no_area(mesh, strategy):
    result = decimate(mesh, n_vertices=1, strategy=strategy)
    assert_valid(result.to_fine(*random_points(len(result.faces), 500)), len(mesh.faces))
    assert_valid(result.to_coarse(*random_points(len(mesh.faces), 500)), len(result.faces))


def test_points_of_faces_with_area_return_beside_edges_without_length():
    mesh = Mesh(*shapes.with_null_edges(SHAPES["sphere"], 20))
    result = decimate(mesh, n_vertices=80)
    up = random_points(len(result.faces))
    assert apart(result.coarse, up, result.to_coarse(*result.to_fine(*up))).max() < 1e-6
    faces, barycentric = random_points(len(mesh.faces))
    has_area = areas(mesh.vertices, mesh.faces)[faces] > 0
    down = faces[has_area], barycentric[has_area]
    assert apart(mesh, down, result.to_fine(*result.to_coarse(*down))).max() < 1e-6


def test_many_points_at_once_go_where_they_go_one_by_one():
    result, (faces, barycentric) = decimated("torus"), random_points(160)
    before = faces.copy(), barycentric.copy()
    at_once = result.to_fine(faces, barycentric)
    parts = [result.to_fine(faces[k : k + 1000], barycentric[k : k + 1000]) for k in range(0, COUNT, 1000)]
    assert all(np.array_equal(whole, np.concatenate(pieces)) for whole, pieces in zip(at_once, zip(*parts)))
    assert np.array_equal(faces, before[0])  # the caller's arrays stay as they are
    assert np.array_equal(barycentric, before[1])


def test_no_points_give_no_points():
    faces, barycentric = decimated("torus").to_fine(np.zeros(0, dtype=int), np.zeros((0, 3)))
    assert faces.shape == (0,)
    assert barycentric.shape == (0, 3)


# --- bijective and continuous ------------------------------------------------------------------------------------


@EACH_STRATEGY
@EACH_SHAPE
def test_points_of_the_fine_mesh_cover_every_coarse_face(name, strategy):
    result = decimated(name, strategy)
    faces, _ = result.to_coarse(*random_points(len(result.fine.faces)))
    assert len(np.unique(faces)) == len(result.faces)


@EACH_STRATEGY
@EACH_SHAPE
def test_areas_add_up_in_both_directions(name, strategy):
    # What a coarse face has of the fine area: counted from points that go down, and measured on an image that goes up.
    result = decimated(name, strategy)
    fine, count, levels = result.fine, 50_000, 4
    area = areas(fine.vertices, fine.faces)
    faces = np.random.default_rng(1).choice(len(area), count, p=area / area.sum())
    counted = np.bincount(result.to_coarse(faces, random_points(1, count)[1])[0], minlength=len(result.faces)) / count

    refined = topology_levels(result.faces, len(result.decimated), levels)[1]
    image = areas(result.transfer(fine.vertices, levels), refined)
    measured = image.reshape(-1, len(result.faces)).sum(axis=0) / area.sum()

    # five standard deviations of the count (faces that expect one point may get six), and what the image's chords cut
    assert (np.abs(counted - measured) < 5 * np.sqrt(measured / count) + 5 / count + 0.05 * measured).all()


@EACH_STRATEGY
@EACH_SHAPE
def test_the_map_turns_nothing_over(name, strategy):
    # Tiny triangles whose corners come to lie in one fine face keep their orientation, but for those across a kink.
    result = decimated(name, strategy)
    faces, centre = random_points(len(result.faces))
    corners = [result.to_fine(faces, 0.99999 * centre + 0.00001 * np.eye(3)[k]) for k in range(3)]
    in_one = (corners[0][0] == corners[1][0]) & (corners[1][0] == corners[2][0])
    turn = np.linalg.det(np.stack([barycentric[in_one] for _, barycentric in corners], axis=1))
    assert in_one.mean() > 0.99
    assert (turn > 0).mean() > 0.999


def edge_points(mesh: Mesh, count: int = COUNT) -> tuple[Points, Points]:
    """Random points of inner edges, each in the face on either side."""
    rng, topology = np.random.default_rng(0), mesh.topology
    there, back = rng.choice(topology.edge_halfedges[~topology.is_boundary_edge], count).T
    s = rng.random(count)
    return on_halfedges(there, s), on_halfedges(back, 1 - s)


def on_halfedges(halfedges: np.ndarray, s: np.ndarray) -> Points:
    barycentric = np.zeros((len(s), 3))
    rows = np.arange(len(s))
    barycentric[rows, halfedges % 3], barycentric[rows, (halfedges % 3 + 1) % 3] = 1 - s, s
    return halfedges // 3, barycentric


@EACH_STRATEGY
@EACH_SHAPE
def test_the_map_is_continuous_across_edges(name, strategy):
    result = decimated(name, strategy)
    left, right = edge_points(result.coarse)
    up = apart(result.fine, result.to_fine(*left), result.to_fine(*right))
    left, right = edge_points(result.fine)
    down = apart(result.coarse, result.to_coarse(*left), result.to_coarse(*right))
    for jump in (up, down):
        assert np.quantile(jump, 0.999) < 1e-9
        assert jump.max() < 1e-6


def distance_to_boundary(mesh: Mesh, points: Points) -> np.ndarray:
    """Barycentric coordinate that is zero on the boundary edge closest to each point, within its face."""
    faces, barycentric = points
    is_border = mesh.topology.twins.reshape(-1, 3)[faces] < 0
    return np.where(is_border, barycentric[:, [2, 0, 1]], np.inf).min(axis=1)


@EACH_STRATEGY
@pytest.mark.parametrize("name", OPEN)
def test_boundary_points_map_to_boundary_points(name, strategy):
    result, rng = decimated(name, strategy), np.random.default_rng(0)
    for source, target, there in ((result.coarse, result.fine, result.to_fine),
                                  (result.fine, result.coarse, result.to_coarse)):  # fmt: skip
        border = rng.choice(np.flatnonzero(source.topology.twins < 0), COUNT)
        image = there(*on_halfedges(border, rng.random(COUNT)))
        assert distance_to_boundary(target, image).max() < 1e-9  # rounding of the planes' coordinates


@EACH_SHAPE
def test_removal_sends_each_coarse_vertex_to_itself(name):
    result = decimated(name, "removal")
    assert np.isin(result.on_surface.vertices, result.fine.vertices).all()  # to the last bit
    ulp = 1e-15 * np.ptp(result.fine.vertices)
    assert np.abs(result.on_surface.vertices - result.decimated).max() < ulp  # normalised and back


# --- flat surfaces -----------------------------------------------------------------------------------------------


@EACH_STRATEGY
def test_a_flat_disc_with_its_boundary_held_maps_by_the_identity(strategy):
    disc = Mesh(*shapes.disc())
    result = decimate(disc, n_vertices=80, strategy=strategy, sharp_boundary_angle=1)  # it turns by 5.6 everywhere
    assert result.reached
    points = random_points(len(result.faces))
    there = positions(disc, result.to_fine(*points))
    # the flattening's energy is shifted by 1e-10 of its size
    assert np.abs(there - positions(result.coarse, points)).max() < 1e-8


@pytest.mark.parametrize("noise", [0, 0.3])
@pytest.mark.parametrize(("strategy", "angle"), [("quadric", None), ("quadric", 45), ("edge-length", 45),
                                                 ("removal", 45)])  # fmt: skip
def test_a_flat_square_that_keeps_its_corners_maps_by_the_identity(strategy, angle, noise):
    # Quadrics keep the corners by themselves; strategies with `spread` leave the straight sides a little.
    vertices, faces = shapes.grid(17, 13)
    inner = ((vertices[:, :2] > 0) & (vertices[:, :2] < [16, 12])).all(axis=1)
    vertices[inner, :2] += np.random.default_rng(0).uniform(-noise, noise, (inner.sum(), 2))
    square = Mesh(vertices, faces)
    result = decimate(square, n_vertices=20, strategy=strategy, sharp_boundary_angle=angle)
    assert result.reached
    points = random_points(len(result.faces))
    there = positions(square, result.to_fine(*points))
    assert np.abs(there - positions(result.coarse, points)).max() < 1e-6  # 1e-10 again, for sides of 16


# --- signals -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("levels", [0, 2])
@EACH_SHAPE
def test_an_affine_signal_transfers_to_its_value_at_the_image(name, levels):
    result, rng = decimated(name), np.random.default_rng(0)
    matrix, offset = rng.normal(size=(3, 4)), rng.normal(size=4)
    image = result.transfer(result.fine.vertices, levels)
    expected = image @ matrix + offset
    actual = result.transfer(result.fine.vertices @ matrix + offset, levels)
    assert np.abs(actual - expected).max() < 1e-14 * np.abs(expected).max()  # a few roundings of one sum


@pytest.mark.parametrize("shape", [(), (1,), (2, 3)])
def test_a_constant_signal_stays_constant_and_keeps_its_shape(shape):
    result = decimated("torus")
    values = result.transfer(np.full((len(result.fine.vertices), *shape), 7.0), levels=1)
    assert values.shape == (80 + len(result.coarse.topology.edges), *shape)
    assert np.abs(values - 7).max() < 1e-14


def test_the_vertices_on_the_surface_are_the_transferred_positions():
    result = decimated("genus 2")
    assert np.array_equal(result.on_surface.vertices, result.transfer(result.fine.vertices))


# --- errors ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("faces", "barycentric", "message"), [
    ([0, 9999], np.eye(3)[:2], r"point 1 lies in face 9999, but there are (160|768) faces"),
    ([-1], [[1, 0, 0]], r"point 0 lies in face -1, but there are"),
    ([0, 0], [[1, 0, 0], [1.5, -0.5, 0]], r"point 1 has barycentric coordinates \[1\.5, -0\.5, 0\.0\]: they must"),
    ([0], [[0.5, 0.5, 0.5]], r"point 0 has barycentric .*sum to 1"),
    ([0], [[np.nan, 0.5, 0.5]], r"point 0 has barycentric coordinates \[nan"),
    ([0], [[0.5, 0.5]], r"faces \(1,\) and barycentric \(1, 2\): give n indices and \(n, 3\) coordinates"),
    ([0, 1], [[1, 0, 0]], r"faces \(2,\) and barycentric \(1, 3\)"),
    ([0.0], [[1, 0, 0]], r"give n indices"),
    (0, [1, 0, 0], r"give n indices"),
])  # fmt: skip
@pytest.mark.parametrize("direction", ["to_fine", "to_coarse"])
def test_a_bad_point_is_refused(direction, faces, barycentric, message):
    with pytest.raises(ParameterizationError, match=message):
        getattr(decimated("torus"), direction)(faces, barycentric)


def test_a_point_in_a_face_that_is_not_there_has_no_position():
    with pytest.raises(ParameterizationError, match="point 0 lies in face -1"):
        decimated("torus").points(np.array([-1]), np.array([[1.0, 0, 0]]))


def test_levels_that_cannot_fit_into_memory_are_refused():
    with pytest.raises(TooLargeError, match="at 20 levels"):
        decimated("torus").transfer(np.zeros(384), levels=20)


def test_a_signal_of_another_mesh_is_refused():
    with pytest.raises(ParameterizationError, match="values has 80 rows for 384 fine vertices: give one for each"):
        decimated("torus").transfer(np.zeros(80))
