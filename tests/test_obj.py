"""OBJ and MTL, and textures of PLY, as exporters write them; materials that must not get into each other's way."""

from __future__ import annotations

import io
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import shapes
from neusub import errors
from neusub.io import load, read, save
from neusub.mesh import Material, Mesh
from test_io import TRIANGLE, _corner_set, _picture, _rich_mesh, _written

TWO_FACES = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\n"
LOWER, UPPER = "f 1/1 2/2 3/3\n", "f 1/1 3/3 4/2\n"


def test_a_byte_order_mark_is_no_part_of_the_first_word(tmp_path):
    mesh = load(_written(tmp_path, "a.obj", b"\xef\xbb\xbf" + (TRIANGLE + "f 1 2 3\n").encode()))
    assert len(mesh.vertices) == 3
    _written(tmp_path, "m.mtl", b"\xef\xbb\xbfnewmtl red\nKd 1 0 0\n")
    mesh = load(_written(tmp_path, "b.obj", "\ufeffmtllib m.mtl\n" + TRIANGLE + "usemtl red\nf 1 2 3\n"))
    assert mesh.materials == (Material("red", (1.0, 0.0, 0.0, 1.0)),)


def test_utf_16_is_named(tmp_path):
    with pytest.raises(errors.MeshFileError, match="UTF-16"):
        read(_written(tmp_path, "a.obj", (TRIANGLE + "f 1 2 3\n").encode("utf-16")))


def test_colours_that_some_vertices_lack_are_left_out_and_reported(tmp_path):
    coloured = TRIANGLE.replace("\n", " 1 0 0\n")
    assert load(_written(tmp_path, "a.obj", coloured + "f 1 2 3\n")).colors is not None
    mesh = load(_written(tmp_path, "b.obj", coloured.replace(" 1 0 0\n", "\n", 1) + "f 1 2 3\n"))
    assert mesh.colors is None
    assert mesh.load_report == ("left out the colours: 1 of 3 vertices have none",)


def test_several_material_files_and_names_with_blanks(tmp_path):
    for name, file in (("red", "a.mtl"), ("blue", "b.mtl"), ("green", "c d.mtl")):
        _written(tmp_path, file, f"newmtl {name}\nKd\t0.5 0 0\n")
    text = f"mtllib a.mtl b.mtl\nmtllib c d.mtl\n{TWO_FACES}usemtl red\n{LOWER}usemtl green\n{UPPER}"
    mesh = load(_written(tmp_path, "m.obj", text))
    assert [(m.name, m.color) for m in mesh.materials] == [(n, (0.5, 0.0, 0.0, 1.0)) for n in ("red", "green")]


def test_names_that_differ_stay_different(tmp_path):
    """Numbers after a #, and letters of Latin-1."""
    names = ["a#1", "a#2"], ["rö", "rä"]
    for pair, coding in zip(names, ("utf-8", "latin-1")):
        mtl = "".join(f"newmtl {name}\nKd {k} 0 0 # shade\n" for k, name in enumerate(pair))
        _written(tmp_path, "m.mtl", mtl.encode(coding))
        text = f"mtllib m.mtl\n{TWO_FACES}usemtl {pair[0]} # the first\n{LOWER}usemtl {pair[1]}\n{UPPER}"
        mesh = load(_written(tmp_path, "m.obj", text.encode(coding)))
        assert [(m.name, m.color[0]) for m in mesh.materials] == [(pair[0], 0.0), (pair[1], 1.0)]


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are any bytes on Linux")
@pytest.mark.parametrize("kind", [".obj", ".ply"])
def test_a_file_name_that_is_no_utf_8_keeps_its_materials(tmp_path, kind):
    """A texture, too, gets such a name, as another picture has its own."""
    name = b"tex\xe9".decode(errors="surrogateescape")
    _written(tmp_path, "a.png", _picture("red"))
    material = Material("rö", None, (("map_Kd", "a.png", _picture("blue")),))
    mesh = Mesh(**shapes.uv_box(), face_data={"material": np.zeros(12, np.int64)}, materials=(material,))
    save(mesh, tmp_path / f"{name}{kind}")
    back = load(tmp_path / f"{name}{kind}")
    assert back.materials[0].textures == (("map_Kd", f"{name}_a.png", _picture("blue")),)
    assert kind == ".ply" or back.materials[0].name == "rö"
    assert not [line for line in back.load_report if "missing" in line or "no image" in line]


def test_transparency_is_read_both_ways_round(tmp_path):
    _written(tmp_path, "m.mtl", "newmtl a\nKd 1 0 0\nTr 0.25\nnewmtl b\nKd 1 0 0\nd 0.75\n")
    mesh = load(_written(tmp_path, "m.obj", f"mtllib m.mtl\n{TWO_FACES}usemtl a\n{LOWER}usemtl b\n{UPPER}"))
    assert [m.color for m in mesh.materials] == [(1.0, 0.0, 0.0, 0.75)] * 2
    save(mesh, tmp_path / "n.obj")
    assert "Tr" not in (tmp_path / "n.mtl").read_text()


def test_opacity_without_a_colour_is_kept(tmp_path):
    _written(tmp_path, "b.png", _picture("red"))
    _written(tmp_path, "m.mtl", "newmtl glass\nd 0.25\nmap_Kd b.png\n")
    mesh = load(_written(tmp_path, "m.obj", f"mtllib m.mtl\n{TWO_FACES}usemtl glass\n{LOWER}{UPPER}"))
    save(mesh, tmp_path / "n.obj")
    assert load(tmp_path / "n.obj").materials[0].color == mesh.materials[0].color == (1.0, 1.0, 1.0, 0.25)


@pytest.mark.filterwarnings("ignore:n.ply. left out 1 textures")
@pytest.mark.parametrize("kind", [".obj", ".glb", ".ply"])
def test_textures_with_options_come_along(tmp_path, kind):
    folder = tmp_path / "out"
    folder.mkdir()
    _written(tmp_path, "a b.png", _picture("red"))
    _written(tmp_path, "m.mtl", "newmtl a\nmap_Kd -s 2 2 1 -clamp on a b.png\nmap_Bump -bm 0.5 a b.png\n")
    mesh = load(_written(tmp_path, "m.obj", f"mtllib m.mtl\n{TWO_FACES}usemtl a\n{LOWER}{UPPER}"))
    assert not mesh.load_report
    save(mesh, folder / f"n{kind}")
    if kind == ".obj":
        assert "map_Kd -s 2 2 1 -clamp on a b.png\nmap_Bump -bm 0.5 a b.png" in (folder / "n.mtl").read_text()
    (texture,) = [t for t in load(folder / f"n{kind}").materials[0].textures if t[0].startswith("map_Kd")]
    assert Image.open(io.BytesIO(texture[2])).convert("RGB").getpixel((0, 0)) == (255, 0, 0)


def test_a_group_without_a_name_ends_the_one_before(tmp_path):
    mesh = load(_written(tmp_path, "m.obj", f"{TWO_FACES}g a\n{LOWER}g\n{UPPER}"))
    assert mesh.face_data["group"].tolist() == ["a", ""]


def test_materials_of_one_name_are_written_apart(tmp_path):
    materials = tuple(Material("mat", (float(k), 0.0, 0.0, 1.0)) for k in range(2))
    mesh = Mesh(*shapes.cube(), face_data={"material": np.arange(12) % 2}, materials=materials)
    save(mesh, tmp_path / "a.obj")
    back = load(tmp_path / "a.obj")
    colors = [back.materials[k].color for k in back.face_data["material"]]
    assert colors == [materials[k % 2].color for k in range(12)]


def test_faces_without_material_stay_so_in_an_obj(tmp_path):
    mesh = Mesh(*shapes.cube(), face_data={"material": np.arange(12) % 2 - 1},
                materials=(Material("default", (1.0, 0.0, 0.0, 1.0)),))
    save(mesh, tmp_path / "a.obj")
    back = load(tmp_path / "a.obj")
    colors = [None if k < 0 else back.materials[k].color for k in back.face_data["material"]]
    assert colors == [None if k < 0 else (1.0, 0.0, 0.0, 1.0) for k in mesh.face_data["material"]]


@pytest.mark.parametrize("kind", [".obj", ".ply", ".glb"])
def test_where_faces_do_not_say_theirs_the_material_is_the_first(tmp_path, kind):
    materials = tuple(Material(c, None, (("map_Kd", f"{c}.png", _picture(c)),)) for c in ("red", "blue"))
    save(Mesh(**shapes.uv_box(), materials=materials), tmp_path / f"a{kind}")
    back = load(tmp_path / f"a{kind}")
    assert {back.materials[k].name for k in back.face_data["material"]} == {"red"}


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("kind", [".obj", ".ply"])
def test_a_texture_never_replaces_another_meshs(tmp_path, kind, overwrite):
    for color in ("red", "green"):
        material = Material("m", None, (("map_Kd", "texture.png", _picture(color)),))
        mesh = Mesh(**shapes.uv_box(), face_data={"material": np.zeros(12, np.int64)}, materials=(material,))
        save(mesh, tmp_path / f"{color}{kind}", overwrite=overwrite)
    for color in ("red", "green"):
        assert load(tmp_path / f"{color}{kind}").materials[0].textures[0][2] == _picture(color)


def test_ply_keeps_colours_of_faces_as_bytes(tmp_path):
    mesh = Mesh(*shapes.cube(), face_data={"red": np.arange(12, dtype=np.uint8)})
    save(mesh, tmp_path / "a.ply")
    assert b"property uchar red" in (tmp_path / "a.ply").read_bytes()
    assert load(tmp_path / "a.ply").face_data["red"].tolist() == list(range(12))


@pytest.mark.parametrize("textured", [(0, 1), (0,), (1,), ()])
def test_ply_keeps_the_texture_of_each_face(tmp_path, textured):
    """Of two materials both have a texture, or one, or none; the last faces have no material."""
    material = np.arange(12) // 5
    material[material == 2] = -1
    mesh = _rich_mesh()
    materials = tuple(m if k in textured else replace(m, textures=()) for k, m in enumerate(mesh.materials))
    mesh = Mesh(**shapes.uv_box(), face_data={"material": material}, materials=materials)
    with pytest.warns(UserWarning, match="a.ply: left out .*colours and shading of materials"):
        save(mesh, tmp_path / "a.ply")
    back = load(tmp_path / "a.ply")
    assert [m.name for m in back.materials] == [("red", "blue")[k] for k in textured]
    if textured:
        found = [back.materials[k].name if k >= 0 else "" for k in back.face_data["material"]]
        assert found == ["" if k not in textured else ("red", "blue")[k] for k in material]
    else:
        assert back.face_data["material"].tolist() == material.tolist()
    expected = _corner_set(mesh, mesh.vertices[mesh.faces], mesh.uv[mesh.uv_faces])
    assert np.allclose(_corner_set(back, back.vertices[back.faces], back.uv[back.uv_faces]), expected, atol=2e-6)
    assert len(back.vertices) == 8


def test_ply_textures_of_one_name_are_written_apart(tmp_path):
    materials = tuple(Material(c, None, (("map_Kd", "texture.png", _picture(c)),)) for c in ("red", "blue"))
    mesh = Mesh(**shapes.uv_box(), face_data={"material": np.arange(12) % 2}, materials=materials)
    save(mesh, tmp_path / "a.ply")
    assert [m.textures[0][2] for m in load(tmp_path / "a.ply").materials] == [_picture("red"), _picture("blue")]


def _meshlab_ply(numbers):
    """Two triangles with UVs on the corners and a number of a texture each, a.png or b.png."""
    head = "ply\nformat ascii 1.0\ncomment VCGLIB generated\ncomment TextureFile a.png\ncomment TextureFile b.png\n"
    head += "element vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n"
    head += "property list uchar int vertex_indices\nproperty list uchar float texcoord\nproperty int texnumber\n"
    rows = "".join(f"3 {c} 6 0 0 1 0 0 1 {k}\n" for c, k in zip(("0 1 2", "0 2 3"), numbers))
    return f"{head}end_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n{rows}"


def test_the_texture_number_of_a_ply_face_is_its_material(tmp_path):
    _written(tmp_path, "a.png", _picture("red"))
    mesh = load(_written(tmp_path, "a.ply", _meshlab_ply([1, 0])))
    assert mesh.face_data["material"].tolist() == [1, 0]
    assert set(mesh.face_data) == {"material"}
    assert [(m.name, len(m.textures)) for m in mesh.materials] == [("a", 1), ("b", 0)]
    assert mesh.load_report == ("material b: no image at 'b.png'",)


def test_a_texture_number_without_texture_is_reported(tmp_path):
    for name in ("a.png", "b.png"):
        _written(tmp_path, name, _picture("red"))
    mesh = load(_written(tmp_path, "a.ply", _meshlab_ply([1, 2])))
    assert mesh.face_data["material"].tolist() == [1, -1]
    assert mesh.load_report == ("1 faces have a texture that is none of the 2: left without",)


@pytest.mark.parametrize(
    "text, n_vertices, n_faces",
    [
        (TRIANGLE + "f -3 -2 -1\n", 3, 1),
        (TRIANGLE + "f 1 2 3\n" + TRIANGLE + "f -3 -2 -1\n", 6, 2),
        (TRIANGLE.replace(" ", "\t") + "f\t1\t2\t3\n", 3, 1),
        ((TRIANGLE + "f 1 2 3\n").replace("\n", "\r\n"), 3, 1),
        ("# a comment\n  " + TRIANGLE + "  f 1 2 3 # another\n", 3, 1),
        (TRIANGLE + "vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\n", 3, 1),
        (TRIANGLE + "vn 0 0 1\nf 1//1 2//1 3//1\n", 3, 1),
        (TRIANGLE + "vt 0 0\nf 1/1 2/1 3/1\n", 3, 1),
        (TRIANGLE + "f 1 2 \\\n 3\n", 3, 1),
        (TRIANGLE + "v 1 1 0\nf 1 2 4 3\n", 4, 2),
        (TRIANGLE + "v 1 1 0\nv 0 2 0\nf 1 2 4 3\nf 3 4 5\n", 5, 3),
        ("v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 3\n", 3, 1),
        ("v 0 0 0 1\nv 1 0 0 1\nv 0 1 0 1\nf 1 2 3\n", 3, 1),
    ],
    ids=["negative", "negative twice", "tabs", "CRLF", "comments", "v/vt/vn", "v//vn", "v/vt", "continued line", "quad",
         "mixed", "colours", "weights"],
)  # fmt: skip
def test_every_way_to_write_an_obj_is_read(tmp_path, text, n_vertices, n_faces):
    mesh = load(_written(tmp_path, "a.obj", text))
    assert (len(mesh.vertices), len(mesh.faces)) == (n_vertices, n_faces)
    assert np.allclose(np.cross(*(mesh.vertices[mesh.faces[0]][1:] - mesh.vertices[mesh.faces[0]][0])), [0, 0, 1])


def test_obj_vertex_colors_are_read(tmp_path):
    mesh = load(_written(tmp_path, "a.obj", "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 3\n"))
    assert np.array_equal(mesh.colors, np.eye(3))


def test_triangulating_is_reported(tmp_path):
    mesh = load(_written(tmp_path, "a.obj", TRIANGLE + "v 1 1 0\nf 1 2 4 3\n"))
    assert mesh.load_report == ("cut 1 polygons of more than three corners into triangles",)
