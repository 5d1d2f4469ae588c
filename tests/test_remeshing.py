"""Truths of remeshing to subdivision connectivity."""

from itertools import pairwise

import numpy as np
import pytest

import shapes
from neusub.errors import DecimationError
from neusub.mesh import Mesh
from neusub.metrics import point_distance
from neusub.remeshing import remesh


def sphere() -> Mesh:
    return Mesh(*shapes.bumpy(shapes.icosphere(3)))


def test_each_level_is_the_midpoint_refinement_of_the_one_before():
    levels = remesh(sphere(), n_faces=80, levels=3)
    assert len(levels[0].faces) == 80
    for coarse, fine in pairwise(levels):
        np.testing.assert_array_equal(fine.faces, coarse.topology.refined_faces)
        np.testing.assert_allclose(fine.vertices[: len(coarse.vertices)], coarse.vertices, atol=1e-12)


def test_every_vertex_lies_on_the_original_surface():
    mesh = sphere()
    for level in remesh(mesh, n_vertices=50, levels=2):
        # Positions are sums of three products: rounding of the diagonal (about 3.5) times a few units.
        assert point_distance(level.vertices, mesh)[0].max() < 1e-7


def test_labels_come_from_the_original_face_under_each_new_one():
    bare = sphere()
    centre = bare.vertices[bare.faces].mean(axis=1)
    mesh = Mesh(bare.vertices, bare.faces, face_data={"side": (centre[:, 0] > 0).astype(np.int64)})
    result = remesh(mesh, n_faces=120, levels=3)[-1]
    np.testing.assert_array_equal(result.face_data["side"], mesh.face_data["side"][result.face_data["original_face"]])
    x = result.vertices[result.faces].mean(axis=1)[:, 0]
    clear = np.abs(x) > 0.1
    assert (result.face_data["side"][clear] == (x[clear] > 0)).all()


def test_colours_are_interpolated_and_uvs_follow_their_chart():
    vertices, faces = shapes.grid(16, 16)
    uv = vertices[:, :2] / 15
    mesh = Mesh(vertices, faces, uv=uv, uv_faces=faces, colors=np.column_stack([uv, np.zeros(len(uv))]))
    result = remesh(mesh, n_faces=60, levels=2)[-1]
    assert result.load_report == ()
    # Both are affine in the position on this flat patch, and so is every face of the map.
    np.testing.assert_allclose(result.colors[:, :2], result.vertices[:, :2] / 15, atol=1e-9)
    corners = result.vertices[result.faces][..., :2] / 15
    np.testing.assert_allclose(result.uv[result.uv_faces], corners, atol=1e-9)


def test_faces_across_a_seam_are_reported():
    cube = shapes.uv_box()
    mesh = Mesh(**cube)
    for _ in range(3):
        mesh = mesh.refined(np.concatenate([mesh.vertices, mesh.vertices[mesh.topology.edges].mean(axis=1)]))
    result = remesh(mesh, n_faces=60, levels=1, strategy="random")[-1]
    assert "lie across a seam" in result.load_report[0]


def test_a_base_that_cannot_get_so_small_says_which_criterion_stopped_it():
    with pytest.raises(DecimationError, match=r"the base stopped at \d+ vertices.*Refused: .*link condition"):
        remesh(Mesh(*shapes.refined(shapes.genus(3), 1)), n_vertices=5)


def test_a_negative_level_is_refused():
    with pytest.raises(DecimationError, match="levels = -1"):
        remesh(sphere(), n_faces=80, levels=-1)
