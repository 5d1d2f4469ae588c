"""GLB: what is joined, and what becomes of materials and images."""

from __future__ import annotations

import base64
import io
import json

import numpy as np
import pytest
import trimesh
from PIL import Image

import shapes
from neusub import errors
from neusub.io import load, save
from neusub.mesh import Material, Mesh
from neusub.repair import info
from test_io import _picture


def _soup(vertices, faces, **visual):
    """Each face with its own three vertices, as exporters write them whose tangents differ."""
    triangles = np.arange(3 * len(faces)).reshape(-1, 3)
    return trimesh.Trimesh(vertices[faces].reshape(-1, 3), triangles, process=False, **visual)


def test_glb_joins_vertices_that_are_alike_in_all_that_is_kept(tmp_path):
    _soup(*shapes.cube()).export(tmp_path / "a.glb")
    mesh = load(tmp_path / "a.glb")
    assert (len(mesh.vertices), info(mesh).boundary_edges) == (8, 0)
    assert mesh.load_report == ("joined 28 vertices at edges written twice; 8 are left",)


def test_glb_keeps_one_uv_of_vertices_that_are_alike(tmp_path):
    vertices, faces = shapes.cube()
    uv = vertices[faces].reshape(-1, 3)[:, :2] / 2
    _soup(vertices, faces, visual=trimesh.visual.TextureVisuals(uv=uv)).export(tmp_path / "a.glb")
    mesh = load(tmp_path / "a.glb")
    assert np.array_equal(mesh.uv_faces, mesh.faces)
    assert np.allclose(mesh.uv, mesh.vertices[:, :2] / 2)


def test_glb_leaves_vertices_of_other_colours_apart(tmp_path):
    colors = np.repeat(np.arange(12) * 20, 3)[:, None] * [1, 1, 1, 0] + [0, 0, 0, 255]
    _soup(*shapes.cube(), vertex_colors=colors.astype(np.uint8)).export(tmp_path / "a.glb")
    assert len(load(tmp_path / "a.glb").vertices) == 36


def test_glb_leaves_faces_apart_that_would_not_agree(tmp_path):
    """The second of two triangles is turned: joined, they would be no oriented surface."""
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    _soup(vertices, np.array([[0, 1, 2], [1, 2, 3]])).export(tmp_path / "a.glb")
    assert len(load(tmp_path / "a.glb").vertices) == 6


def test_what_a_glb_material_loses_is_reported(tmp_path):
    vertices, faces = shapes.cube()
    material = trimesh.visual.material.PBRMaterial(name="skin", doubleSided=True, emissiveFactor=[1, 0, 0])
    visual = trimesh.visual.TextureVisuals(uv=vertices[:, :2], material=material)
    trimesh.Trimesh(vertices, faces, visual=visual, process=False).export(tmp_path / "skin.glb")
    assert "material skin: emissiveFactor, doubleSided left out" in load(tmp_path / "skin.glb").load_report


def test_what_a_glb_material_has_by_default_is_no_loss(tmp_path):
    vertices, faces = shapes.cube()
    defaults = {"doubleSided": False, "emissiveFactor": [0.0, 0, 0], "alphaMode": "OPAQUE", "alphaCutoff": 0.5}
    visual = trimesh.visual.TextureVisuals(material=trimesh.visual.material.PBRMaterial(name="skin", **defaults))
    trimesh.Trimesh(vertices, faces, visual=visual, process=False).export(tmp_path / "skin.glb")
    mesh = load(tmp_path / "skin.glb")
    assert mesh.materials[0].name == "skin"
    assert not mesh.load_report


@pytest.mark.parametrize("alpha", [0.2, 1.0])
@pytest.mark.parametrize("extra", [(), ("Pm 1.0", "Pr 0.25")])
def test_glb_keeps_transparency_and_metal(tmp_path, alpha, extra):
    material = Material("skin", (1.0, 0.4, 0.2, alpha), extra=extra)
    save(Mesh(*shapes.cube(), materials=(material,)), tmp_path / "a.glb")
    mesh = load(tmp_path / "a.glb")
    assert mesh.materials == (material,)
    assert not mesh.load_report
    (written,) = _header(tmp_path / "a.glb")["materials"]
    assert written["pbrMetallicRoughness"]["metallicFactor"] == len(extra) / 2
    assert written.get("alphaMode", "OPAQUE") == ("BLEND" if alpha < 1 else "OPAQUE")


def _header(path):
    data = path.read_bytes()
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


def test_an_opaque_glb_material_has_no_alpha_and_is_a_metal_unless_it_says_no(tmp_path):
    vertices, faces = shapes.cube()
    material = trimesh.visual.material.PBRMaterial(name="skin", baseColorFactor=[1.0, 0, 0, 0.2])
    visual = trimesh.visual.TextureVisuals(material=material)
    trimesh.Trimesh(vertices, faces, visual=visual, process=False).export(tmp_path / "skin.glb")
    (material,) = load(tmp_path / "skin.glb").materials
    assert material == Material("skin", (1.0, 0.0, 0.0, 1.0), extra=("Pm 1.0",))


def _with_uris(path, **uris):
    """A GLB of a textured cube, with URIs in the place of its own bytes (images, buffers)."""
    vertices, faces = shapes.cube()
    material = trimesh.visual.material.PBRMaterial(name="skin", baseColorTexture=Image.new("RGB", (4, 4), "red"))
    visual = trimesh.visual.TextureVisuals(uv=vertices[:, :2], material=material)

    def refer(tree):
        for key, uri in uris.items():
            tree[key][0] = {"uri": uri, "byteLength": tree["buffers"][0]["byteLength"]}

    scene = trimesh.Scene(trimesh.Trimesh(vertices, faces, visual=visual, process=False))
    path.write_bytes(trimesh.exchange.gltf.export_glb(scene, tree_postprocessor=refer))
    return path


def test_images_beside_a_glb_are_read(tmp_path):
    (tmp_path / "my textures").mkdir()
    (tmp_path / "my textures" / "a.png").write_bytes(_picture("blue"))
    embedded = "data:image/png;base64," + base64.b64encode(_picture("blue")).decode()
    for uri in ("my%20textures/a.png", embedded):
        mesh = load(_with_uris(tmp_path / "a.glb", images=uri))
        ((role, _, content),) = mesh.materials[0].textures
        assert role == "map_Kd"
        assert Image.open(io.BytesIO(content)).getpixel((0, 0)) == (0, 0, 255)
        assert not mesh.load_report


def test_a_missing_image_of_a_glb_is_reported(tmp_path):
    mesh = load(_with_uris(tmp_path / "a.glb", images="Textures/a.png"))
    assert mesh.load_report == ("no image at 'Textures/a.png'; the texture is left out",)
    assert not mesh.materials[0].textures


def test_missing_bytes_of_a_glb_are_named(tmp_path):
    with pytest.raises(errors.MeshFileError, match=r"a\.bin is missing"):
        load(_with_uris(tmp_path / "a.glb", buffers="a.bin"))


def _gltf(folder, **extra):
    """A cube as glTF: JSON, and its buffer in a file beside it."""
    for name, content in trimesh.Scene(trimesh.Trimesh(*shapes.cube(), process=False)).export(file_type="gltf").items():
        (folder / name).write_bytes(content)
    path = folder / "model.gltf"
    path.write_text(json.dumps(json.loads(path.read_text()) | extra))
    return path


def test_gltf_is_read_with_the_buffers_beside_it(tmp_path):
    mesh = load(_gltf(tmp_path))
    assert (len(mesh.vertices), len(mesh.faces)) == (8, 12)
    with pytest.raises(errors.MeshFileError, match=r"extension '\.gltf'\. Known are: \.obj"):
        save(mesh, tmp_path / "b.gltf")
    next(tmp_path.glob("*.bin")).unlink()
    with pytest.raises(errors.MeshFileError, match="bin is missing: the mesh refers to it"):
        load(tmp_path / "model.gltf")


def test_compressed_gltf_is_refused_by_name(tmp_path):
    path = _gltf(tmp_path, extensionsRequired=["KHR_materials_unlit", "EXT_meshopt_compression"])
    with pytest.raises(errors.MeshFileError, match="glTF extension EXT_meshopt_compression, which is not read"):
        load(path)


def test_quantized_positions_are_read_as_integers_and_refused_as_shares(tmp_path):
    path = _gltf(tmp_path, extensionsRequired=["KHR_mesh_quantization"])
    tree = json.loads(path.read_text())
    accessor = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    view = tree["bufferViews"][accessor["bufferView"]]
    buffer = tmp_path / tree["buffers"][view["buffer"]]["uri"]
    start, count = view.get("byteOffset", 0), accessor["count"]
    data = bytearray(buffer.read_bytes())
    corners = np.frombuffer(bytes(data[start : start + 12 * count]), np.float32).reshape(-1, 3)
    steps = np.zeros((count, 4), np.int16)  # of eight bytes, as a stride has to be a multiple of four
    steps[:, :3] = 100 * corners
    data[start : start + 8 * count] = steps.tobytes()
    buffer.write_bytes(data)
    view["byteStride"], accessor["componentType"] = 8, 5122
    path.write_text(json.dumps(tree))
    np.testing.assert_array_equal(load(path).vertices, steps[:, :3])
    accessor["normalized"] = True
    path.write_text(json.dumps(tree))
    with pytest.raises(errors.MeshFileError, match="has positions or UVs in shares"):
        load(path)


def _textured_gltf(folder, change):
    """A cube with a texture; change: what is done to the image and to its mention in the material."""
    vertices, faces = shapes.cube()
    material = trimesh.visual.material.PBRMaterial(name="the skin", baseColorTexture=Image.new("RGB", (2, 2), "red"))
    visual = trimesh.visual.TextureVisuals(uv=vertices[:, :2], material=material)
    files = trimesh.Scene(trimesh.Trimesh(vertices, faces, process=False, visual=visual)).export(file_type="gltf")
    for name, content in files.items():
        (folder / name).write_bytes(content)
    path = folder / "model.gltf"
    tree = json.loads(path.read_text())
    change(tree["images"][0], tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"])
    path.write_text(json.dumps(tree))
    return path


def test_a_texture_transform_is_reported(tmp_path):
    def scale(image, texture):
        texture["extensions"] = {"KHR_texture_transform": {"scale": [2, 2]}}

    mesh = load(_textured_gltf(tmp_path, scale))
    assert mesh.materials[0].textures
    assert "material the skin: KHR_texture_transform left out; its texture may be off" in mesh.load_report


def test_an_image_that_cannot_be_read_is_reported(tmp_path):
    def garble(image, texture):
        image.clear()
        image["uri"] = "data:image/png;base64,AAAA"

    mesh = load(_textured_gltf(tmp_path, garble))
    assert not mesh.materials[0].textures
    assert "material the skin: its image cannot be read; the texture is left out" in mesh.load_report
