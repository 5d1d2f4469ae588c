"""What a mesh is, what it refuses, and how its data follow refinement."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import shapes
from neusub import errors
from neusub.mesh import Material, Mesh
from neusub.problems import find_problems

GOOD = {
    "tetrahedron": shapes.tetrahedron(),
    "cube": shapes.cube(),
    "icosphere": shapes.icosphere(1),
    "torus": shapes.torus(),
    "genus 3": shapes.genus(3),
    "open patch": shapes.grid(),
    "open cylinder": shapes.open_cylinder(),
    "cone": shapes.cone(),
    "two components": shapes.two_components(),
    "all flipped": shapes.all_flipped(),
    "coincident vertices": shapes.coincident_vertices(),
    "collinear face": shapes.collinear_face(),
    "tiny": (shapes.cube()[0] * 1e-6, shapes.cube()[1]),
    "huge": (shapes.cube()[0] * 1e6, shapes.cube()[1]),
    "far away": (shapes.cube()[0] + 1e4, shapes.cube()[1]),
}
BAD = {
    "fin on an edge": (
        shapes.fin_on_edge(),
        errors.NonManifoldEdgeError,
        r"edge \(0, 1\) belongs to 3 faces: 1, 2, 20\.",
    ),
    "two tetrahedra sharing an edge": (
        shapes.two_tetrahedra_sharing_edge(),
        errors.NonManifoldEdgeError,
        r"edge \(0, 1\) belongs to 4 faces",
    ),
    "bow-tie": (
        shapes.bow_tie(),
        errors.NonManifoldVertexError,
        "vertex 0 joins 2 separate fans of faces, with faces 0, 1",
    ),
    "duplicate face": (shapes.duplicate_face(), errors.DuplicateFaceError, "faces 3 and 20 "),
    "double-sided square": (
        shapes.double_sided_square(),
        errors.DuplicateFaceError,
        r"faces 0 and 2 .*and 1 more face\)",
    ),
    "NaN": (shapes.with_nan(), errors.NonFiniteError, "vertex 7 is"),
    "Inf": (shapes.with_inf(), errors.NonFiniteError, "vertex 7 is"),
    "too far": (shapes.too_far(), errors.NonFiniteError, r"vertex 7 is .* of absolute value at most 1e\+75"),
    "flipped face": (shapes.flipped_face(), errors.OrientationError, r"faces \d+ and \d+ .*and 2 more such edges"),
    "Moebius strip": (shapes.moebius(), errors.OrientationError, "the same way"),
    "index out of range": (shapes.index_out_of_range(), errors.IndexRangeError, "face 5 is .* 12 vertices"),
    "negative index": (shapes.negative_index(), errors.IndexRangeError, "face 5 is"),
    "repeated vertex": (shapes.repeated_vertex(), errors.RepeatedVertexError, r"face 20 is \(2, 2, 5\)"),
    "isolated first and last vertex": (
        shapes.isolated_first_last(),
        errors.UnreferencedVertexError,
        r"vertex 0 .*and 1 more vertex\)",
    ),
    "no faces": (shapes.no_faces(), errors.EmptyMeshError, "12 vertices and no faces"),
}


@pytest.mark.parametrize("name", GOOD)
def test_a_manifold_is_accepted(name):
    vertices, faces = GOOD[name]
    mesh = Mesh(vertices, faces)
    assert np.array_equal(mesh.vertices, vertices)
    assert np.array_equal(mesh.faces, faces)


@pytest.mark.parametrize("name", BAD)
def test_a_bad_mesh_raises_its_own_error_which_names_the_element(name):
    (vertices, faces), kind, words = BAD[name]
    with pytest.raises(kind, match=words):
        Mesh(vertices, faces)


@pytest.mark.parametrize("name", BAD)
def test_the_first_problem_found_is_the_one_raised(name):
    (vertices, faces), kind, _ = BAD[name]
    assert type(find_problems(vertices, faces)[0]) is kind


def test_all_problems_are_found_at_once():
    vertices, faces = shapes.bow_tie()
    vertices = np.concatenate([vertices, [[np.nan, 0, 0]]])
    faces = np.concatenate([faces, faces[:1]])
    kinds = [type(p).__name__ for p in find_problems(vertices, faces)]
    assert kinds == ["NonFiniteError", "DuplicateFaceError", "OrientationError", "NonManifoldVertexError",
                     "UnreferencedVertexError"]  # fmt: skip


@pytest.mark.parametrize(
    "values",
    [
        {"vertices": np.zeros((4, 2))},
        {"vertices": "no numbers"},
        {"faces": np.zeros((1, 4), dtype=int)},
        {"faces": np.zeros((1, 3))},
        {"uv": np.zeros((3, 2))},
        {"uv": np.zeros((3, 3)), "uv_faces": shapes.tetrahedron()[1]},
        {"uv": np.zeros((4, 2)), "uv_faces": shapes.tetrahedron()[1][:2]},
        {"colors": np.zeros((3, 3))},
        {"colors": np.zeros((4, 2))},
        {"face_data": {"label": np.zeros(3)}},
    ],
)
def test_an_array_that_does_not_fit_raises_shape_error(values):
    vertices, faces = shapes.tetrahedron()
    with pytest.raises(errors.ShapeError):
        Mesh(**{"vertices": vertices, "faces": faces, **values})


def test_a_uv_index_out_of_range_is_named():
    vertices, faces = shapes.tetrahedron()
    with pytest.raises(errors.IndexRangeError, match="uv_faces 0"):
        Mesh(vertices, faces, uv=np.zeros((2, 2)), uv_faces=faces)


def test_a_material_index_out_of_range_is_named():
    vertices, faces = shapes.tetrahedron()
    with pytest.raises(errors.IndexRangeError, match="1 materials"):
        Mesh(vertices, faces, face_data={"material": np.arange(4)}, materials=(Material(),))


def test_the_arrays_are_read_only_copies():
    vertices, faces = shapes.tetrahedron()
    mesh = Mesh(vertices, faces)
    vertices[:] = 0
    assert mesh.vertices.any()
    with pytest.raises(ValueError):
        mesh.vertices[0] = 0


def test_integer_colors_count_to_255():
    vertices, faces = shapes.tetrahedron()
    mesh = Mesh(vertices, faces, colors=np.full((4, 3), 51, dtype=np.uint8))
    assert np.allclose(mesh.colors, 0.2, atol=1e-15)


def _refined(mesh):
    return mesh.refined(np.concatenate([mesh.vertices, mesh.vertices[mesh.topology.edges].mean(axis=1)]))


@pytest.mark.parametrize("name", ["cube", "genus 3", "open cylinder", "two components", "collinear face"])
def test_a_refined_manifold_is_a_manifold(name):
    fine = _refined(Mesh(*GOOD[name]))
    assert find_problems(fine.vertices, fine.faces) == []


def test_texture_seams_stay_seams_under_refinement():
    mesh = Mesh(**shapes.uv_box())
    fine = _refined(mesh)
    # each of the six charts is one square of two triangles: 4 + 5 edges
    assert len(fine.uv) == 6 * 9
    assert len(np.unique(fine.uv_faces)) == 6 * 9


def test_each_refined_uv_is_the_affine_image_of_its_position():
    mesh = Mesh(**shapes.uv_box())
    fine = _refined(mesh)
    for k in range(12):
        corners = mesh.vertices[mesh.faces[k]]
        for f in range(k, 48, 12):
            weights = np.linalg.lstsq(corners.T, fine.vertices[fine.faces[f]].T, rcond=None)[0]
            if np.linalg.matrix_rank(corners) == 3:
                assert np.allclose(weights.T @ mesh.uv[mesh.uv_faces[k]], fine.uv[fine.uv_faces[f]], atol=1e-12)


def test_face_data_follow_their_faces_through_refinement():
    vertices, faces = shapes.cube()
    fine = _refined(Mesh(vertices, faces, face_data={"label": np.arange(12)}))
    centre = vertices[faces].mean(axis=1)
    assert np.allclose(fine.vertices[fine.faces[36:]].mean(axis=1), centre[fine.face_data["label"][36:]], atol=1e-15)
    assert np.array_equal(fine.face_data["label"], np.tile(np.arange(12), 4))


def test_replacing_vertices_keeps_the_rest():
    mesh = Mesh(**shapes.uv_box(), face_data={"label": np.arange(12)})
    moved = mesh.replace_vertices(mesh.vertices * 2)
    assert moved.topology is not None
    assert np.array_equal(moved.vertices, mesh.vertices * 2)
    assert moved.uv is mesh.uv
    assert moved.face_data is mesh.face_data


def test_replacing_vertices_refuses_another_number_of_them():
    mesh = Mesh(*shapes.cube())
    with pytest.raises(errors.ShapeError):
        mesh.replace_vertices(mesh.vertices[:-1])


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda mesh: pickle.loads(pickle.dumps(mesh))])
def test_a_copy_of_a_mesh_is_as_frozen_as_the_mesh(copied):
    mesh = Mesh(**shapes.uv_box(), face_data={"label": np.arange(12)})
    again = copied(mesh)
    for array in (again.vertices, again.faces, again.uv, again.uv_faces, again.face_data["label"]):
        assert not array.flags.writeable
    assert np.array_equal(again.topology.edges, mesh.topology.edges)
    assert np.array_equal(again.face_data["label"], mesh.face_data["label"])


def test_face_data_take_no_new_entries_unchecked():
    mesh = Mesh(*shapes.cube(), face_data=None)
    with pytest.raises(TypeError, match="assignment"):
        mesh.face_data["label"] = np.arange(3)


@pytest.mark.parametrize("value", [128.0, -0.5, 1.01])
def test_a_colour_out_of_range_is_named(value):
    vertices, faces = shapes.cube()
    colors = np.full((len(vertices), 3), 0.5)
    colors[3, 1] = value
    with pytest.raises(errors.IndexRangeError, match=r"color of vertex 3 .* integers from 0 to 255"):
        Mesh(vertices, faces, colors=colors)
    colors[3, 1] = np.clip(value, 0, 1) + 1e-9 * np.sign(value)  # rounding
    assert Mesh(vertices, faces, colors=colors).colors[3, 1] == np.clip(value, 0, 1)
