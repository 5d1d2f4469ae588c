"""Truths of fitted maps: refinements keep closer to the surface, and the map stays what it was otherwise."""

import igl
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shapes
from decimatable import OPEN, decimated, mesh_of, meshes
from neusub import distance
from neusub.errors import ParameterizationError
from neusub.map_pictures import chart_faces
from neusub.mesh import Mesh
from neusub.metrics import triangle_quality
from neusub.remeshing import remesh, with_signals
from neusub.selfparam import STRATEGIES, SelfParameterization, decimate, fitting
from neusub.selfparam.distances import squared_distance
from neusub.selfparam.fitting import FOLD, prepare
from neusub.selfparam.fitting import distance as sample_distance
from neusub.selfparam.mapping import UV
from neusub.selfparam.maps import decimate_maps
from neusub.selfparam.surface import frame_of
from test_selfparam_points import EACH_SHAPE, assert_returns, assert_valid, random_points


def spiky() -> Mesh:
    """A sphere with twelve horns."""
    vertices, faces = shapes.icosphere(5)
    closeness = (vertices @ shapes.icosahedron()[0].T).max(axis=1)
    return Mesh(vertices * (1 + 1.5 * np.exp((closeness - 1) * 30))[:, None], faces)


@pytest.mark.parametrize("strategy", ["quadric", "uniform", "random"])
@pytest.mark.parametrize("levels", [1, 2])
def test_refinements_keep_closer_to_the_surface(strategy, levels):
    mesh = spiky()
    result = decimate(mesh, n_faces=300, strategy=strategy)
    before, after = (distance(with_signals(r, levels), mesh) for r in (result, result.fitted(levels)))
    assert after.mean < 0.95 * before.mean
    assert after.hausdorff < 0.95 * before.hausdorff


def test_more_passes_bring_it_closer():
    mesh = spiky()
    result = decimate(mesh, n_faces=300)
    none, one, five = (distance(with_signals(result.fitted(2, n), 2), mesh).mean for n in (0, 1, 5))
    assert none > one > five


@EACH_SHAPE
def test_points_return(name):
    result = decimated(name).fitted()
    assert_returns(result)
    faces, _ = result.to_coarse(*random_points(len(result.fine.faces)))
    assert len(np.unique(faces)) == len(result.faces)


@pytest.mark.parametrize("n_faces", [4, 6, 20])
def test_points_return_over_the_coarsest_bases(n_faces):
    assert_returns(decimate(mesh_of("sphere"), n_faces=n_faces).fitted(3))


def test_points_of_fitted_maps_of_removals_return():
    assert_returns(decimate_maps(mesh_of("torus"), n_vertices=80).fitted())


@given(meshes(is_degenerate=True), st.sampled_from(list(STRATEGIES)), st.floats(0, 1), st.integers(0, 3))
@settings(max_examples=50)
def test_images_of_random_meshes_are_valid(mesh, strategy, share, levels):
    n_vertices = max(1, round(share * len(mesh.vertices)))
    result = decimate(mesh, n_vertices=n_vertices, strategy=strategy).fitted(levels)
    assert np.isfinite(result.decimated).all()
    assert_valid(result.to_fine(*random_points(len(result.faces), 500)), len(mesh.faces))
    assert_valid(result.to_coarse(*random_points(len(mesh.faces), 500)), len(result.faces))


@given(meshes(), st.sampled_from(list(STRATEGIES)), st.floats(0, 1))
@settings(max_examples=50)
def test_points_of_random_meshes_return(mesh, strategy, share):
    n_vertices = max(1, round(share * len(mesh.vertices)))
    assert_returns(decimate(mesh, n_vertices=n_vertices, strategy=strategy).fitted(), 500)


def test_coarse_vertices_lie_at_their_images_and_faces_are_the_same():
    result = decimate(spiky(), n_faces=300)
    fitted = result.fitted()
    assert np.array_equal(fitted.faces, result.faces)
    assert np.abs(fitted.decimated - fitted.on_surface.vertices).max() < 1e-12
    assert np.abs(fitted.decimated - result.on_surface.vertices).max() > 0.01
    again = result.fitted(passes=0)
    assert np.abs(again.on_surface.vertices - result.on_surface.vertices).max() == 0


def test_no_triangle_of_a_slide_gets_thinner_than_the_criteria_allow():
    result = decimate(spiky(), n_faces=300)
    fitted = result.fitted()
    slides = range(int(result.charts.used[0]), int(fitted.charts.used[0]))
    assert len(slides) > 50
    for c in slides:
        uv = fitted.charts.uv[slice(*fitted.charts.starts[c : c + 2, UV])]
        solid = np.column_stack([uv, np.zeros(len(uv))])
        before, after = (triangle_quality(solid, chart_faces(fitted, c, is_after)[0]) for is_after in (False, True))
        assert after.min() > min(0.2, before.min()) - 1e-12


def test_samples_pay_for_triangles_that_face_away():
    result = decimate(mesh_of("sphere"), n_faces=100)
    fit = prepare(result, 1, *frame_of(result.fine.vertices))
    fit.patch[0, 0, 0], fit.patch[0, 1, 0], fit.patch[0, 0, 1] = (0, 0, 0), (2, 0, 0), (0, 1, 0)
    fit.samples[7] = 0.5, 0.25, 0.3
    for height, expected in ((1.0, 0.09), (0.0, 0.09), (-1.0, 0.09 + FOLD * 4)):
        fit.normals[7] = 0, 0, height
        assert sample_distance(fit, 7, 0, 0.25, 0.25) == pytest.approx(expected)


def test_a_fitted_map_can_be_saved_and_fitted_again(tmp_path):
    fitted = decimate(spiky(), n_faces=300).fitted(passes=1)
    fitted.save(tmp_path / "map.safetensors")
    loaded = SelfParameterization.load(tmp_path / "map.safetensors")
    assert np.array_equal(loaded.fitted().decimated, fitted.fitted().decimated)


def test_the_result_does_not_depend_on_scale_and_place():
    mesh = mesh_of("sphere")
    reference = decimate(mesh, n_faces=150).fitted().decimated
    for scale, shift in ((1e-6, 0.0), (1e6, 0.0), (1.0, 1e4)):
        moved = decimate(Mesh(mesh.vertices * scale + shift, mesh.faces), n_faces=150).fitted()
        assert np.abs((moved.decimated - shift) / scale - reference).max() < 1e-9


@pytest.mark.parametrize("name", OPEN)
def test_the_boundary_stays(name):
    result = decimated(name)
    border = result.coarse.topology.is_boundary_vertex
    fitted = result.fitted()
    np.testing.assert_allclose(fitted.decimated[border], result.on_surface.vertices[border], atol=1e-12)
    assert np.abs(fitted.decimated[~border] - result.on_surface.vertices[~border]).max() > 0.01


def test_a_part_of_the_samples_does_as_well(monkeypatch):
    mesh = spiky()
    result = decimate(mesh, n_faces=300, strategy="uniform")
    plain, whole = (distance(with_signals(r, 1), mesh).mean for r in (result, result.fitted(1)))
    monkeypatch.setattr(fitting, "DENSE", 3)
    assert len(prepare(result, 2, *frame_of(mesh.vertices)).samples) == 3600 < len(mesh.vertices)
    part = distance(with_signals(result.fitted(1), 1), mesh).mean
    assert max(whole, part) < 0.95 * plain
    assert whole != part


def test_what_is_flat_needs_no_fit():
    vertices, faces = shapes.refined(shapes.grid(6, 6), 2)
    result = decimate(Mesh(vertices, faces), n_faces=60)
    assert np.array_equal(result.fitted().versions, result.versions)


def test_remesh_fits_unless_told_not_to():
    mesh = spiky()
    fitted, plain = (remesh(mesh, n_faces=300, fit=fit)[-1] for fit in (True, False))
    assert distance(fitted, mesh).mean < 0.95 * distance(plain, mesh).mean


@pytest.mark.parametrize("numbers", [{"levels": -1}, {"levels": 7}, {"passes": -1}, {"passes": 21}])
def test_numbers_out_of_range_are_named(numbers):
    name, value = next(iter(numbers.items()))
    with pytest.raises(ParameterizationError, match=f"{name} = {value}: take a number from"):
        decimated("sphere").fitted(**numbers)


def test_distances_to_triangles_are_those_of_igl():
    rng = np.random.default_rng(0)
    for _ in range(200):
        u, v, p = rng.standard_normal((3, 3)) * rng.choice([0.01, 1, 1], (3, 1))
        expected = igl.point_mesh_squared_distance(p[None], np.array([[0, 0, 0], u, v]), np.array([[0, 1, 2]]))[0][0]
        assert squared_distance(*u, *v, *p) == pytest.approx(expected, rel=1e-9, abs=1e-12)
