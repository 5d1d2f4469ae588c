"""Info says what a mesh is; repair gives a valid mesh or names what only a guess could mend."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shapes
from neusub import errors
from neusub.mesh import Mesh
from neusub.problems import find_problems
from neusub.raw import RawMesh
from neusub.repair import info, repair


@pytest.mark.parametrize("g", range(4))
def test_genus_is_the_number_of_handles(g):
    assert info(RawMesh(*shapes.genus(g))).genus == g


@pytest.mark.parametrize(
    "shape, loops, genus",
    [(shapes.grid(), 1, 0), (shapes.open_cylinder(), 2, 0), (shapes.torus(), 0, 1), (shapes.cone(), 1, 0)],
)
def test_boundary_loops_and_genus_of_known_shapes(shape, loops, genus):
    found = info(RawMesh(*shape))
    assert (found.boundary_loops, found.genus) == (loops, genus)


def test_components_are_counted_and_their_handles_added():
    (a, f), (b, g) = shapes.torus(), shapes.two_components()
    found = info(RawMesh(np.concatenate([a, b]), np.concatenate([f, g + len(a)])))
    assert (found.components, found.genus) == (3, 1)


def test_equilateral_triangles_have_quality_one():
    found = info(Mesh(*shapes.icosahedron()))
    assert found.quality == pytest.approx((1, 1), abs=1e-12)
    assert found.edge_length[0] == pytest.approx(found.edge_length[2], abs=1e-12)


@pytest.mark.parametrize(
    "shape",
    [shapes.fin_on_edge, shapes.bow_tie, shapes.with_nan, shapes.index_out_of_range, shapes.no_faces, shapes.moebius],
)
def test_info_lists_every_problem_and_never_raises(shape):
    vertices, faces = shape()
    found = info(RawMesh(vertices, faces))
    assert [str(p) for p in found.problems] == [str(p) for p in find_problems(vertices, faces)]
    assert str(found.problems[0]) in str(found)


def test_info_of_a_good_mesh_says_so():
    assert "no problems" in str(info(Mesh(*shapes.cube())))


def _soup(shape):
    """Each face with its own three vertices."""
    vertices, faces = shape()
    return RawMesh(vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3))


def test_info_names_the_remedy_for_faces_with_their_own_vertices():
    found = info(_soup(shapes.cube))
    assert found.coincident_edges == 36
    assert "36 boundary edges lie on each other. Run 'neusub repair --weld'" in str(found)
    assert info(Mesh(*shapes.open_cylinder())).coincident_edges == 0


@pytest.mark.parametrize("shape", [shapes.cube, shapes.flipped_face])
def test_repair_welds_if_asked_to(shape):
    mesh, changes = repair(_soup(shape), weld=True)
    assert (len(mesh.vertices), info(mesh).boundary_edges) == (len(shape()[0]), 0)
    assert changes[0].startswith("joined")
    assert mesh.load_report == tuple(changes)
    assert info(repair(_soup(shape))[0]).coincident_edges == 3 * len(mesh.faces)


@pytest.mark.parametrize(
    "shape, words",
    [
        (shapes.flipped_face, "turned 1 faces, the first being face 4"),
        (shapes.duplicate_face, "removed 1 copies of faces, the first being face 20"),
        (shapes.repeated_vertex, "removed 1 faces with a repeated vertex, the first being face 20"),
        (shapes.isolated_first_last, "dropped 2 unreferenced vertices, the first being vertex 0"),
    ],
)
def test_repair_gives_back_the_icosahedron_and_says_how(shape, words):
    mesh, changes = repair(RawMesh(*shape()))
    vertices, faces = shapes.icosahedron()
    assert changes == [words]
    assert mesh.load_report == (words,)
    assert np.array_equal(mesh.vertices, vertices)
    rolled = [np.roll(mesh.faces, k, axis=1) for k in range(3)]
    assert all(any((r[f] == faces[f]).all() for r in rolled) for f in range(20))


@given(st.lists(st.booleans(), min_size=20, max_size=20), st.booleans())
@settings(max_examples=30)
def test_repair_turns_the_minority(flips, is_open):
    vertices, faces = shapes.grid(6, 3) if is_open else shapes.icosahedron()
    flips = np.array(flips)
    mixed = np.where(flips[:, None], faces[:, ::-1], faces)
    mesh, _ = repair(RawMesh(vertices, mixed))
    assert (mesh.faces != mixed).any(axis=1).sum() == min(flips.sum(), 20 - flips.sum())


def test_texture_corners_turn_with_their_faces():
    box = shapes.uv_box()
    turned = {**box, "faces": box["faces"].copy(), "uv_faces": box["uv_faces"].copy()}
    for key in ("faces", "uv_faces"):
        turned[key][5] = turned[key][5, ::-1]
    mesh, _ = repair(RawMesh(**turned))
    assert np.array_equal(mesh.faces, box["faces"])
    assert np.array_equal(mesh.uv_faces, box["uv_faces"])


@pytest.mark.parametrize(
    "shape, kind",
    [
        (shapes.fin_on_edge, errors.NonManifoldEdgeError),
        (shapes.two_tetrahedra_sharing_edge, errors.NonManifoldEdgeError),
        (shapes.bow_tie, errors.NonManifoldVertexError),
        (shapes.moebius, errors.OrientationError),
        (shapes.with_nan, errors.NonFiniteError),
        (shapes.index_out_of_range, errors.IndexRangeError),
        (shapes.no_faces, errors.EmptyMeshError),
    ],
)
def test_what_only_a_guess_could_mend_is_raised(shape, kind):
    with pytest.raises(kind):
        repair(RawMesh(*shape()))


@pytest.mark.parametrize(
    "shape, components",
    [(shapes.fin_on_edge, 2), (shapes.two_tetrahedra_sharing_edge, 2), (shapes.bow_tie, 2)],
)
def test_splitting_when_asked_gives_each_sheet_its_own_vertices(shape, components):
    mesh, changes = repair(RawMesh(*shape()), split_edges=True, split_vertices=True)
    assert info(mesh).components == components
    assert len(changes) == 1


def test_a_double_sided_square_becomes_one_sided():
    mesh, _ = repair(RawMesh(*shapes.double_sided_square()))
    assert len(mesh.faces) == 2


@pytest.mark.parametrize("shape", [shapes.coincident_vertices, shapes.collinear_face])
def test_zero_area_faces_collapse_and_topology_stays(shape):
    raw = RawMesh(*shape())
    mesh, changes = repair(raw)
    before, after = info(raw), info(mesh)
    assert before.zero_area_faces > 0
    assert after.zero_area_faces == 0
    assert (after.genus, after.boundary_loops) == (before.genus, before.boundary_loops)
    assert any("zero-area" in line for line in changes)
    assert not any("kept" in line for line in changes)


def with_caps(vertices, faces, count, rng):
    """A vertex in the middle of some edges of a closed mesh, but on one side only: a flat face lies along the edge."""
    topology = Mesh(vertices, faces).topology
    faces, vertices, used = faces.copy(), list(vertices), set()
    for e in rng.permutation(len(topology.edges)):
        h = topology.edge_halfedges[e, 0]
        f, side = divmod(int(h), 3)
        if f in used or len(used) == count:
            continue
        used.add(f)
        p, q, far = np.roll(faces[f], -side)
        vertices.append(0.75 * vertices[p] + 0.25 * vertices[q])
        middle = len(vertices) - 1
        faces[f] = (p, middle, far)
        faces = np.concatenate([faces, [(middle, q, far), (p, q, middle)]])
    return np.array(vertices), faces


def enclosed(vertices, faces):
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return (a * np.cross(b, c)).sum() / 6


def test_corners_in_a_line_stay_where_they_are():
    vertices, faces = with_caps(*shapes.bumpy(shapes.icosphere(2), 0.3), 60, np.random.default_rng(0))
    mesh, changes = repair(RawMesh(vertices.copy(), faces.copy()))
    assert changes == ["flipped 60 edges of zero-area faces"]
    np.testing.assert_array_equal(mesh.vertices, vertices)
    assert len(mesh.faces) == len(faces)
    assert info(mesh).zero_area_faces == 0
    assert enclosed(mesh.vertices, mesh.faces) == pytest.approx(enclosed(vertices, faces))


def test_a_flat_face_takes_over_uvs_and_data_of_the_face_that_it_shares():
    """Without a seam its own UV of the middle is taken, across one the place between the neighbour's."""
    vertices = np.array([[0.0, 0, 0], [4, 0, 0], [1, 0, 0], [2, -3, 0], [2, 3, 0]])
    faces = np.array([[0, 1, 2], [1, 0, 3], [0, 2, 4], [2, 1, 4]])
    data = {"label": np.array([7, 8, 9, 9])}
    uv = np.concatenate([vertices[:, :2], vertices[:, :2] + 10])
    seamless = RawMesh(vertices, faces, uv.copy(), faces.copy(), face_data=dict(data))
    mesh, changes = repair(seamless)
    assert changes == ["flipped 1 edges of zero-area faces"]
    assert mesh.face_data["label"].tolist() == [8, 8, 9, 9]
    np.testing.assert_array_equal(mesh.uv_faces, mesh.faces)
    apart = faces.copy()
    apart[1] += 5  # the face below has a chart of its own
    mesh, _ = repair(RawMesh(vertices, faces, uv.copy(), apart, face_data=dict(data)))
    moved = np.array([10, 10, 0, 0])[:, None, None]
    np.testing.assert_allclose(mesh.uv[mesh.uv_faces], mesh.vertices[mesh.faces][..., :2] + moved)
    assert data["label"].tolist() == [7, 8, 9, 9]


def test_faces_are_named_by_their_numbers_in_the_file():
    vertices, faces = shapes.icosahedron()
    faces = np.concatenate([[[0, 0, 1]], faces, faces[:1]])
    faces[10] = faces[10, ::-1]
    _, changes = repair(RawMesh(vertices, faces))
    assert changes == ["removed 1 faces with a repeated vertex, the first being face 0",
                       "removed 1 copies of faces, the first being face 21", "turned 1 faces, the first being face 10"]


@pytest.mark.parametrize("shape", [shapes.fin_on_edge, shapes.bow_tie, shapes.moebius], ids=lambda s: s.__name__)
def test_errors_name_faces_by_their_numbers_in_the_file_too(shape):
    """The numbers after removals are of a mesh that nobody sees."""
    vertices, faces = shape()

    def error_of(faces: np.ndarray) -> str:
        with pytest.raises(errors.MeshError) as raised:
            repair(RawMesh(vertices, faces))
        return str(raised.value)

    plain, later = error_of(faces), error_of(np.concatenate([[[0, 0, 1]], faces]))
    named, named_later = ([int(n) for n in re.findall(r"\d+", re.search(r"faces:? (\d+(, | and |))+", text)[0])]
                          for text in (plain, later))
    assert named_later == [n + 1 for n in named]


def test_a_flat_face_at_the_border_is_removed():
    vertices = np.array([[0.0, 0, 0], [4, 0, 0], [1, 0, 0], [2, 3, 0]])
    mesh, changes = repair(RawMesh(vertices, np.array([[0, 1, 2], [0, 2, 3], [2, 1, 3]])))
    assert changes == ["removed 1 zero-area faces at the border"]
    assert mesh.faces.tolist() == [[0, 2, 3], [2, 1, 3]]


def test_a_flat_tetrahedron_is_kept_and_reported():
    vertices, faces = shapes.tetrahedron()
    mesh, changes = repair(RawMesh(vertices * [1, 0, 0], faces))
    assert len(mesh.faces) == 4
    assert changes == ["kept 4 zero-area faces, which no collapse and no flip mends"]


def test_repair_leaves_its_input_as_it_was():
    vertices, faces = shapes.flipped_face()
    raw = RawMesh(vertices.copy(), faces.copy())
    repair(raw)
    assert np.array_equal(raw.faces, faces)
    assert raw.report == []
