"""Files: what survives, what is joined, and what is refused by name."""

from __future__ import annotations

import io
import struct
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import shapes
from neusub import errors
from neusub.io import KINDS, load, read, save
from neusub.mesh import Material, Mesh
from neusub.repair import info, repair

DIRTY = Path(__file__).parents[2] / "shared" / "data" / "meshes" / "dirty"
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


def _written(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def _picture(color):
    buffer = io.BytesIO()
    Image.new("RGB", (4, 4), color).save(buffer, format="PNG")
    return buffer.getvalue()


def _rich_mesh():
    """A box with seams, two textured materials in turn, and colours."""
    materials = tuple(
        Material(name, (0.5, 0.25, 1.0, 1.0), (("map_Kd", f"{name}.png", _picture(name)),)) for name in ("red", "blue")
    )
    data = {"material": np.arange(12) // 6}
    colors = np.arange(24).reshape(8, 3) / 51.0
    return Mesh(**shapes.uv_box(), colors=colors, face_data=data, materials=materials)


def _corner_set(mesh, *arrays):
    """Each corner's values, in an order that does not depend on the numbering."""
    rows = np.concatenate([a.reshape(len(mesh.faces) * 3, -1) for a in arrays], axis=1).round(6) + 0.0
    return rows[np.lexsort(rows.T[::-1])]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", [shapes.cube, shapes.torus, shapes.open_cylinder, shapes.two_components])
def test_positions_and_connectivity_survive(tmp_path, kind, shape):
    mesh = Mesh(*shape())
    save(mesh, tmp_path / f"a{kind}")
    back = load(tmp_path / f"a{kind}")
    assert len(back.vertices) == len(mesh.vertices)
    assert np.allclose(back.vertices[back.faces], mesh.vertices[mesh.faces], atol=1e-6)  # float32 in STL and GLB
    assert info(back).genus == info(mesh).genus


@pytest.mark.parametrize("kind", [".obj", ".ply", ".off"])
@pytest.mark.parametrize("scale, shift", [(1, 0), (1e-6, 0), (1e6, 0), (1, 1e4)])
def test_float64_survives_bit_for_bit(tmp_path, kind, scale, shift):
    vertices, faces = shapes.icosphere(1)
    mesh = Mesh(vertices * scale + shift, faces)
    save(mesh, tmp_path / f"a{kind}")
    back = load(tmp_path / f"a{kind}")
    assert np.array_equal(back.vertices, mesh.vertices)
    assert np.array_equal(back.faces, mesh.faces)


@pytest.mark.parametrize("kind", [".obj", ".ply", ".glb"])
def test_texture_seams_survive_and_the_surface_stays_closed(tmp_path, kind):
    mesh = Mesh(**shapes.uv_box())
    save(mesh, tmp_path / f"a{kind}")
    back = load(tmp_path / f"a{kind}")
    assert len(back.vertices) == 8
    assert info(back).boundary_edges == 0
    expected = _corner_set(mesh, mesh.vertices[mesh.faces], mesh.uv[mesh.uv_faces])
    assert np.allclose(_corner_set(back, back.vertices[back.faces], back.uv[back.uv_faces]), expected, atol=2e-6)


@pytest.mark.parametrize("kind", [".obj", ".ply", ".glb"])
def test_colors_survive(tmp_path, kind):
    vertices, faces = shapes.cube()
    mesh = Mesh(vertices, faces, colors=np.arange(24).reshape(8, 3) / 51.0)
    save(mesh, tmp_path / f"a{kind}")
    back = load(tmp_path / f"a{kind}")
    expected = _corner_set(mesh, mesh.vertices[mesh.faces], mesh.colors[mesh.faces])
    assert np.allclose(_corner_set(back, back.vertices[back.faces], back.colors[back.faces, :3]), expected, atol=1e-5)


@pytest.mark.parametrize("kind", [".obj", ".glb"])
def test_several_materials_with_colors_and_textures_survive(tmp_path, kind):
    mesh = _rich_mesh()
    save(mesh, tmp_path / f"a{kind}")
    back = load(tmp_path / f"a{kind}")
    assert [m.name for m in back.materials] == ["red", "blue"]
    assert np.allclose(back.materials[0].color, (0.5, 0.25, 1, 1), atol=1 / 255)
    pictures = [Image.open(io.BytesIO(m.textures[0][2])).getpixel((0, 0))[:3] for m in back.materials]
    assert pictures == [(255, 0, 0), (0, 0, 255)]
    material = np.repeat(mesh.face_data["material"], 3)
    expected = _corner_set(mesh, mesh.vertices[mesh.faces], mesh.uv[mesh.uv_faces], mesh.colors[mesh.faces], material)
    material = np.repeat(back.face_data["material"], 3)
    colors = back.colors[back.faces, :3]
    found = _corner_set(back, back.vertices[back.faces], back.uv[back.uv_faces], colors, material)
    assert np.allclose(found, expected, atol=1e-5)
    assert info(back).boundary_edges == 0


def test_obj_keeps_groups_and_unknown_mtl_lines(tmp_path):
    _written(tmp_path, "m.mtl", "newmtl a\nKd 1 0 0\nNs 10\nillum 2\n")
    text = TRIANGLE + "v 1 1 0\nmtllib m.mtl\nusemtl a\ng left\nf 1 2 3\ng right side\nf 2 4 3\n"
    save(load(_written(tmp_path, "a.obj", text)), tmp_path / "b.obj")
    back = load(tmp_path / "b.obj")
    assert back.face_data["group"].tolist() == ["left", "right side"]
    assert back.materials[0].extra == ("Ns 10", "illum 2")


@pytest.mark.parametrize(
    "values",
    [np.arange(12), np.arange(12) / 7, np.arange(12) % 2 == 0, np.arange(12, dtype=np.uint8), 2**40 + np.arange(12),
     np.full(12, 4_000_000_000, dtype=np.uint32), np.arange(-6, 6, dtype=np.int8), np.full(12, -(2**53))],
    ids=lambda values: str(values.dtype),
)  # fmt: skip
@pytest.mark.parametrize("name", ["label", "count", "corners", "vertex_index", "vertex_indices#", "texcoord"])
def test_ply_keeps_numbers_of_faces(tmp_path, name, values):
    save(Mesh(*shapes.cube(), face_data={name: values}), tmp_path / "a.ply")
    assert np.array_equal(load(tmp_path / "a.ply").face_data[name], values)


@pytest.mark.parametrize(
    "name, values, words",
    [
        ("vertex_indices", np.arange(12), "has the name of something else"),
        ("label", 2**53 + np.arange(12), "goes from 9007199254740992 to 9007199254741003"),
    ],
)
def test_face_data_that_a_ply_cannot_hold_is_named(tmp_path, name, values, words):
    with pytest.raises(errors.MeshFileError, match=words):
        save(Mesh(*shapes.cube(), face_data={name: values}), tmp_path / "a.ply")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", [".obj", ".ply", ".off", ".glb"])
def test_coincident_vertices_stay_apart(tmp_path, kind):
    mesh = Mesh(*shapes.coincident_vertices())
    save(mesh, tmp_path / f"a{kind}")
    assert len(load(tmp_path / f"a{kind}").vertices) == len(mesh.vertices)


def _stl(triangles):
    head = b"\0" * 80 + struct.pack("<I", len(triangles))
    return head + b"".join(struct.pack("<12fH", *([0.0] * 3), *t.reshape(-1), 0) for t in triangles)


def _text_stl(triangles):
    facets = [
        "facet normal 0 0 0\nouter loop\n" + "".join("vertex {} {} {}\n".format(*p) for p in t) + "endloop\nendfacet\n"
        for t in triangles.tolist()
    ]
    return ("solid a\n" + "".join(facets) + "endsolid a\n").encode()


@pytest.mark.parametrize("write", [_stl, _text_stl])
def test_stl_joins_bit_equal_positions(tmp_path, write):
    vertices, faces = shapes.cube()
    mesh = load(_written(tmp_path, "a.stl", write(vertices[faces])))
    assert len(mesh.vertices) == 8
    assert info(mesh).genus == 0
    assert mesh.load_report == ("joined 28 vertices at equal positions; 8 are left",)


@pytest.mark.parametrize("shape", [shapes.two_tetrahedra_sharing_edge, shapes.bow_tie, shapes.fin_on_edge])
def test_a_weld_that_would_not_be_manifold_is_left_out(tmp_path, shape):
    vertices, faces = shape()
    mesh = load(_written(tmp_path, "a.stl", _stl(vertices[faces])))
    assert info(mesh).components == 2


def test_a_left_out_weld_is_reported(tmp_path):
    vertices, faces = shapes.two_tetrahedra_sharing_edge()
    mesh = load(_written(tmp_path, "a.stl", _stl(vertices[faces])))
    assert any("left 1 welds out" in line for line in mesh.load_report)


def test_ply_joins_across_a_normal_seam_only(tmp_path):
    """Two squares over one edge, each with its own vertices; their normals differ, or not."""
    head = "ply\nformat ascii 1.0\nelement vertex 6\n" + "".join(
        f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz")
    )
    head += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    places = ["0 0 0", "1 0 0", "0 1 0", "1 0 0", "1 1 0", "0 1 0"]
    for normals, expected in ((["0 0 1"] * 6, 6), (["0 0 1"] * 3 + ["0 1 0"] * 3, 4)):
        rows = "".join(f"{p} {n}\n" for p, n in zip(places, normals))
        mesh = load(_written(tmp_path, "a.ply", head + rows + "3 0 1 2\n3 3 4 5\n"))
        assert len(mesh.vertices) == expected


@pytest.mark.parametrize("n", [4, 5, 7])
@pytest.mark.parametrize("turn", range(7))
@pytest.mark.parametrize("axis", range(3))
def test_a_concave_polygon_is_cut_without_folds(tmp_path, n, turn, axis):
    angles = 2 * np.pi * np.arange(n) / n
    points = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    points[0] *= -0.2  # a dent
    points = np.roll(np.roll(points, turn, axis=0), axis, axis=1)
    text = "".join("v {} {} {}\n".format(*p) for p in points) + "f " + " ".join(map(str, range(1, n + 1)))
    mesh = load(_written(tmp_path, "a.obj", text))
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, (2 + axis) % 3] > 0).all()


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("polygons", [[[0, 1, 2], [0, 2, 3]], [[0, 1, 2, 3]], [[0, 1, 2, 3], [3, 2, 4]]])
def test_ply_polygons_are_read_in_every_format(tmp_path, form, polygons):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 2, 0]])[: 1 + max(map(max, polygons))]
    head = f"ply\nformat {form} 1.0\nelement vertex {len(vertices)}\n"
    head += "property float x\nproperty float y\nproperty float z\n"
    head += f"element face {len(polygons)}\nproperty list uchar int vertex_indices\nproperty int label\nend_header\n"
    if form == "ascii":
        rows = [*(" ".join(map(str, v)) for v in vertices), *(f"{len(p)} {' '.join(map(str, p))} 7" for p in polygons)]
        body = "\n".join(rows).encode()
    else:
        order = "<" if "little" in form else ">"
        body = vertices.astype(order + "f4").tobytes()
        for p in polygons:
            body += bytes([len(p)]) + np.array([*p, 7], dtype=order + "i4").tobytes()
    mesh = load(_written(tmp_path, "a.ply", head.encode() + body))
    assert len(mesh.faces) == sum(len(p) - 2 for p in polygons)
    assert (mesh.face_data["label"] == 7).all()


def test_unreferenced_vertices_are_dropped_with_a_warning(tmp_path):
    vertices, faces = shapes.isolated_first_last()
    text = "".join("v {} {} {}\n".format(*p) for p in vertices) + "".join("f {} {} {}\n".format(*f) for f in faces + 1)
    with pytest.warns(UserWarning, match="dropped 2 vertices"):
        mesh = load(_written(tmp_path, "a.obj", text))
    assert np.array_equal(mesh.vertices, vertices[1:-1])


@pytest.mark.parametrize(
    "text, kind, words",
    [
        (TRIANGLE + "f 1 2 4\n", errors.IndexRangeError, "line 4, 'f 1 2 4'"),
        (TRIANGLE + "f 0 1 2\n", errors.IndexRangeError, "line 4"),
        (TRIANGLE + "f -4 1 2\n", errors.IndexRangeError, "line 4"),
        (TRIANGLE + "vt 0 0\nf 1/1 2/2 3/1\n", errors.IndexRangeError, "1 texture vertices"),
        (TRIANGLE, errors.EmptyMeshError, "no faces"),
        (TRIANGLE + "v 1 x 2\nf 1 2 3\n", errors.MeshFileError, "line 4 is 'v 1 x 2'"),
        (TRIANGLE + "f 1 2 c\n", errors.MeshFileError, "corner 'c'"),
        (TRIANGLE + "f 1 2\n", errors.MeshFileError, "line 4 has 2 corners"),
        ("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", errors.NonFiniteError, "vertex 0"),
        ("v inf 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", errors.NonFiniteError, "vertex 0"),
        ("", errors.MeshFileError, "is empty"),
        ("\n\n", errors.MeshFileError, "is empty"),
    ],
)
def test_a_bad_obj_is_named_with_its_line(tmp_path, text, kind, words):
    with pytest.raises(kind, match=words):
        load(_written(tmp_path, "a.obj", text))


@pytest.mark.parametrize("kind", [".ply", ".glb", ".stl", ".off"])
@pytest.mark.parametrize("share", [0.01, 0.1, 0.5, 0.97])
def test_a_truncated_file_is_named(tmp_path, kind, share):
    save(Mesh(*shapes.icosphere(2)), tmp_path / f"a{kind}")
    data = (tmp_path / f"a{kind}").read_bytes()
    with pytest.raises(errors.MeshFileError):
        load(_written(tmp_path, f"b{kind}", data[: int(share * len(data))]))


def test_a_truncated_ascii_ply_is_named(tmp_path):
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    with pytest.raises(errors.MeshFileError, match="2 rows of 'face'"):
        load(_written(tmp_path, "a.ply", head + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"))


@pytest.mark.parametrize("kind", KINDS)
def test_an_empty_a_garbled_and_a_missing_file_and_a_folder_are_named(tmp_path, kind):
    (tmp_path / f"folder{kind}").mkdir()
    _written(tmp_path, f"empty{kind}", b"")
    for name in ("missing", "folder", "empty"):
        with pytest.raises(errors.MeshFileError):
            load(tmp_path / f"{name}{kind}")
    with pytest.raises(errors.NeusubError):
        load(_written(tmp_path, f"garbled{kind}", np.random.default_rng(0).bytes(5000)))


@pytest.mark.parametrize("name", ["a.xyz", "a", "a.obj.zip"])
def test_an_unknown_extension_is_named(tmp_path, name):
    with pytest.raises(errors.MeshFileError, match="Known are"):
        load(_written(tmp_path, name, b"v 0 0 0"))
    with pytest.raises(errors.MeshFileError, match="Known are"):
        save(Mesh(*shapes.cube()), tmp_path / name)


def test_a_missing_output_folder_is_named(tmp_path):
    with pytest.raises(errors.MeshFileError, match="does not exist"):
        save(Mesh(*shapes.cube()), tmp_path / "no" / "a.obj")


def test_an_output_folder_that_is_not_writable_is_named(tmp_path):
    folder = tmp_path / "closed"
    folder.mkdir()
    folder.chmod(0o500)
    try:
        probe = folder / "probe"
        try:
            probe.touch()
        except PermissionError:
            pass
        else:
            probe.unlink()
            pytest.skip("this user may write everywhere")
        with pytest.raises(errors.MeshFileError, match="not writable"):
            save(Mesh(*shapes.cube()), folder / "a.obj")
    finally:
        folder.chmod(0o700)


def test_an_existing_file_stays_without_overwrite(tmp_path):
    path = _written(tmp_path, "a.obj", b"mine")
    with pytest.raises(errors.MeshFileError, match="exists"):
        save(Mesh(*shapes.cube()), path, overwrite=False)
    assert path.read_bytes() == b"mine"


def test_saving_leaves_no_other_files(tmp_path):
    save(_rich_mesh(), tmp_path / "a.obj")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mtl", "a.obj", "blue.png", "red.png"]


@pytest.mark.skipif(not DIRTY.is_dir(), reason="the folder of dirty meshes is absent")
@pytest.mark.parametrize("name", sorted(p.name for p in DIRTY.glob("*")) if DIRTY.is_dir() else ["none"])
def test_a_dirty_file_gives_a_mesh_or_a_named_error(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            mesh = load(DIRTY / name)
        except errors.NeusubError as error:
            assert len(str(error)) > 20
        else:
            assert np.isfinite(mesh.vertices).all()
        raw = read(DIRTY / name)
        assert str(info(raw))
        try:
            repair(raw, split_edges=True, split_vertices=True)
        except errors.NeusubError as error:
            assert len(str(error)) > 20


def test_errors_name_the_elements_of_the_file_where_unused_vertices_were_dropped(tmp_path):
    path = tmp_path / "m.obj"
    path.write_text("v 9 9 9\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 0 -1 0\nf 2 3 4\nf 3 2 5\nf 2 3 6\n")
    with pytest.raises(errors.NonManifoldEdgeError, match=r"edge \(1, 2\)"), pytest.warns(UserWarning):
        load(path)
    with pytest.raises(errors.NonManifoldEdgeError, match=r"edge \(1, 2\)"):
        repair(read(path))
    path.write_text("v 9 9 9\nv 0 0 0\nv 1 0 0\nv nan 1 0\nf 2 3 4\n")
    with pytest.raises(errors.NonFiniteError, match="vertex 3"), pytest.warns(UserWarning):
        load(path)


@pytest.mark.parametrize("value, kept, line", [("255", 1.0, "count as 0 to 255"), ("1.5", 1.0, "cut to 0 to 1"),
                                               ("-0.5", 0.0, "cut to 0 to 1")])
def test_real_colours_of_files_are_brought_to_their_range(tmp_path, value, kept, line):
    path = tmp_path / "m.ply"
    path.write_text("ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
                    "property float red\nproperty float green\nproperty float blue\nelement face 1\n"
                    f"property list uchar int vertex_indices\nend_header\n0 0 0 {value} 0 0\n1 0 0 0 0 0\n0 1 0 0 0 0\n"
                    "3 0 1 2\n")
    mesh = load(path)
    assert mesh.colors[0, 0] == kept
    assert line in mesh.load_report[-1]


def test_threads_may_save_to_one_file(tmp_path):
    mesh = Mesh(*shapes.icosphere(1))
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: save(mesh, tmp_path / "m.ply"), range(40)))
    assert np.array_equal(load(tmp_path / "m.ply").faces, mesh.faces)
    assert [path.name for path in tmp_path.iterdir()] == ["m.ply"]


@pytest.mark.parametrize("kind", [".stl", ".glb"])
def test_single_precision_that_is_too_coarse_for_a_mesh_is_told(tmp_path, kind):
    vertices, faces = shapes.icosphere(1)
    near, far = Mesh(vertices, faces), Mesh(0.01 * vertices + 500_000, faces)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        save(near, tmp_path / f"near{kind}")
        save(far, tmp_path / "far.ply")
    with pytest.warns(UserWarning, match=r"steps of 0\.031 .* where edges are 0\.00\d+ long"):
        save(far, tmp_path / f"far{kind}")
