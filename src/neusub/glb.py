"""GLB and glTF on trimesh: its reader and writer take care of the container, this of seams, materials and nodes."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

import numpy as np
from numpy import ndarray

from neusub.errors import MeshFileError
from neusub.mesh import Material
from neusub.raw import RawMesh, base_picture, face_materials, join_copies, split_at_seams, weld

if TYPE_CHECKING:
    from neusub.mesh import Mesh

__all__ = ["parse_glb", "write_glb"]


# Extensions that a file may require: without these the triangles are the same.
HARMLESS = ("KHR_texture_", "EXT_texture_", "KHR_materials_", "KHR_lights_", "KHR_animation_", "KHR_node_", "KHR_xmp",
            "EXT_mesh_features", "EXT_structural_metadata", "CESIUM_primitive_outline", "KHR_mesh_quantization")
COMPRESSED = ("KHR_draco_", "EXT_meshopt_", "KHR_meshopt_")


def parse_glb(data: bytes, path: Path) -> RawMesh:
    """All triangles of the scene, in world coordinates, joined across seams (UV, normal, primitive) and at copies.

    Raises MeshFileError for a file that needs an extension which is not read, or has quantized positions or UVs,
    and for a missing buffer of a glTF file.
    """
    from trimesh.exchange.gltf import load_glb, load_gltf
    from trimesh.scene.transforms import SceneGraph

    is_binary = data[:4] == b"glTF"
    header = _header(data, is_binary)
    _check_extensions(header, path)
    images = _FilesBeside(path.parent)
    content: dict[str, Any] = dict((load_glb if is_binary else load_gltf)(io.BytesIO(data), resolver=images))
    graph = SceneGraph()
    for edge in content["graph"]:
        graph.update(**edge)
    parts: list[tuple[dict[str, Any], ndarray]] = []
    place = {name: k for k, name in enumerate(content["geometry"])}
    # trimesh keeps nodes in a set: go through them in the file's order of meshes, then by name
    for node in sorted(graph.nodes_geometry, key=lambda node: (place.get(graph[node][1], -1), str(node))):
        matrix, name = graph[node]
        part = content["geometry"].get(name, {})
        if len(part.get("faces", ())):
            parts.append((part, np.asarray(matrix, dtype=np.float64)))
    if not parts:
        return RawMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    raw = _joined(parts)
    raw.report.extend(f"no image at '{uri}'; the texture is left out" for uri in images.missing)
    raw.report.extend(_textures_left_out(raw, header, images.missing))
    return raw


def _header(data: bytes, is_binary: bool) -> dict[str, Any]:
    """The JSON of the file; of a GLB it is the first chunk."""
    from trimesh.util import decode_text

    text = data
    if is_binary:
        length, = struct.unpack_from("<I", data, 12)
        text = data[20 : 20 + length]
    return json.loads(decode_text(text))


def _primitives(header: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for mesh in header.get("meshes") or ():
        yield from mesh.get("primitives") or ()


def _check_extensions(header: dict[str, Any], path: Path) -> None:
    """Raises MeshFileError where trimesh would read other positions than the file has, or none."""
    can_draco = find_spec("DracoPy") is not None  # trimesh calls it by itself
    for name in header.get("extensionsRequired") or ():
        if not (name.startswith(HARMLESS) or (can_draco and name.startswith("KHR_draco_"))):
            way = "without compression" if name.startswith(COMPRESSED) else "without it"
            raise MeshFileError(f"{path} needs the glTF extension {name}, which is not read. Export the mesh {way}.")
    accessors: list[dict[str, Any]] = header.get("accessors") or []
    used = (primitive.get("attributes", {}).get(name) for primitive in _primitives(header)
            for name in ("POSITION", "TEXCOORD_0"))
    if any(accessors[number].get("normalized") for number in used if number is not None):
        raise MeshFileError(f"{path} has positions or UVs in shares of the range of integers (KHR_mesh_quantization), "
                            "which are not read. Export the mesh without quantization.")


def _textures_left_out(raw: RawMesh, header: dict[str, Any], missing: list[str]) -> Iterator[str]:
    """A line for each material in use whose texture is not here, or not as the file has it."""
    bare = {material.name for material in raw.materials if not material.textures}
    has_bare_unnamed = any(name.startswith("material_") for name in bare)
    materials: list[dict[str, Any]] = header.get("materials") or []
    for number in sorted({primitive.get("material", -1) for primitive in _primitives(header)} - {-1}):
        texture = (materials[number].get("pbrMetallicRoughness") or {}).get("baseColorTexture")
        name = str(materials[number].get("name", ""))
        if texture is None:
            continue
        if name.replace(" ", "_") in bare or (not name and has_bare_unnamed):
            if not missing:  # those have their own line
                yield f"material {name or number}: its image cannot be read; the texture is left out"
        elif "KHR_texture_transform" in texture.get("extensions", {}):
            yield f"material {name or number}: KHR_texture_transform left out; its texture may be off"


class _FilesBeside(dict[str, bytes]):
    """The files that URIs name, relative to the folder; trimesh passes over images that are missing in silence."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder, self.missing = folder, []

    def __missing__(self, uri: str) -> bytes:
        file = self.folder / unquote(uri)
        if not file.is_file():
            self.missing.append(uri)
            raise MeshFileError(f"{file} is missing: the mesh refers to it. Put it there.")
        return file.read_bytes()


def _joined(parts: list[tuple[dict[str, Any], ndarray]]) -> RawMesh:
    vertices, faces, uvs, colors, attributes, materials, material = [], [], [], [], [], [], []
    start = 0
    for k, (part, matrix) in enumerate(parts):
        corners = np.asarray(part["faces"], dtype=np.int64) + start
        mirrors = np.linalg.det(matrix[:3, :3]) < 0
        faces.append(corners[:, ::-1] if mirrors else corners)
        vertices.append(np.asarray(part["vertices"], dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3])
        n = len(vertices[-1])
        start += n
        visual = part.get("visual")
        uvs.append(getattr(visual, "uv", None))
        colors.append(_vertex_colors(part, visual, n))
        normals = part.get("vertex_normals")
        seam = np.zeros((n, 6))
        seam[:, 0] = k
        if uvs[-1] is not None:
            seam[:, 1:3] = uvs[-1]
        if normals is not None and len(normals) == n:
            seam[:, 3:] = normals
        attributes.append(seam)
        material.append(np.full(len(corners), _material_index(getattr(visual, "material", None), materials)))
    raw = RawMesh(np.concatenate(vertices), np.concatenate(faces))
    if any(c is not None for c in colors):
        raw.colors = np.concatenate([np.ones((len(v), 4)) if c is None else c for c, v in zip(colors, vertices)])
        if (raw.colors[:, 3] == 1).all():  # opaque: the writer adds the fourth column by itself
            raw.colors = raw.colors[:, :3].copy()
    seams = join_copies(raw, np.concatenate(attributes))
    if any(uv is not None for uv in uvs):
        raw.uv, raw.uv_faces = seams[:, 1:3].copy(), raw.faces.copy()
    if materials:
        raw.materials = tuple(m for m, _ in materials)
        raw.report.extend(line for m, found in materials for line in _left_out(m, found))
        raw.face_data["material"] = np.concatenate(material)
    weld(raw, seams)
    return raw


def _vertex_colors(part: dict[str, Any], visual: Any, n: int) -> ndarray | None:
    colors = part.get("vertex_colors")
    if colors is None and getattr(visual, "kind", None) == "vertex":
        colors = visual.vertex_colors
    if colors is None:
        colors = getattr(visual, "vertex_attributes", {}).get("color")
    if colors is None or len(colors) != n:
        return None
    colors = np.asarray(colors)
    rgba = np.ones((n, 4))
    scale = {"u1": 255.0, "u2": 65535.0}.get(colors.dtype.str[1:], 1.0)
    rgba[:, : colors.shape[1]] = colors / scale
    return rgba


# What of a material is not kept, and the value that it has where it is absent (glTF 2.0, section 5.19).
LOST = {"normalTexture": None, "occlusionTexture": None, "metallicRoughnessTexture": None, "emissiveTexture": None,
        "emissiveFactor": (0.0, 0.0, 0.0), "alphaMode": "OPAQUE", "alphaCutoff": 0.5, "doubleSided": False}


def _left_out(material: Material, found: Any) -> list[str]:
    """A line for the properties of what was found that the material does not keep."""
    values = {key: getattr(found, key, None) for key in LOST}
    if values["alphaMode"] == "BLEND" and material.color is not None and material.color[3] < 1:
        del values["alphaMode"]  # which says no more than this alpha does
    lost = [key for key, value in values.items() if value is not None and np.any(value != LOST[key])]
    return [f"material {material.name}: {', '.join(lost)} left out"] if lost else []


def _material_index(found: Any, materials: list[tuple[Material, Any]]) -> int:
    """The index of trimesh's material in the list, to which it is added if new; -1 for none."""
    if found is None:
        return -1
    for k, (_, known) in enumerate(materials):
        if known is found:
            return k
    factor = getattr(found, "baseColorFactor", None)
    color = None
    if factor is not None:
        factor = np.asarray(factor)
        r, g, b, a = (factor / 255.0 if factor.dtype.kind in "iu" else factor).tolist()
        is_opaque = getattr(found, "alphaMode", None) in (None, "OPAQUE")  # alpha means nothing then
        color = (r, g, b, 1.0 if is_opaque else a)
    name = getattr(found, "name", None) or f"material_{len(materials)}"
    image = getattr(found, "baseColorTexture", None)
    textures = ()
    if image is not None:
        buffer = io.BytesIO()
        image.save(buffer, format="PNG")
        textures = (("map_Kd", f"{name}.png".replace("/", "_"), buffer.getvalue()),)
    materials.append((Material(str(name).replace(" ", "_"), color, textures, _metal_lines(found)), found))
    return len(materials) - 1


def _metal_lines(found: Any) -> tuple[str, ...]:
    """Pm and Pr as of an MTL file.  There a material without Pm is no metal; in a GLB, without factor, it is one."""
    if getattr(found, "metallicRoughnessTexture", None) is not None:
        return ()  # the factors scale the texture, which is left out
    metallic, roughness = getattr(found, "metallicFactor", None), getattr(found, "roughnessFactor", None)
    values = {"Pm": 1.0 if metallic is None else metallic or None, "Pr": roughness}
    return tuple(f"{key} {value!r}" for key, value in values.items() if value is not None)


def write_glb(mesh: Mesh, name: str) -> dict[str, bytes]:
    """One primitive for each material, positions as float32 (the format's); vertices are split at UV seams.

    Face data other than the material do not fit into a GLB.
    """
    import trimesh
    from trimesh.visual import ColorVisuals, TextureVisuals

    index, faces, uv = split_at_seams(mesh)
    material = face_materials(mesh)
    scene = trimesh.Scene()
    for k in np.unique(material):
        part = faces[material == k]
        used, corners = np.unique(part, return_inverse=True)
        piece = trimesh.Trimesh(mesh.vertices[index[used]], corners.reshape(-1, 3), process=False)
        colors = None if mesh.colors is None else _bytes_rgba(mesh.colors[index[used]])
        if k >= 0 or uv is not None:
            pbr = _pbr(mesh.materials[k] if k >= 0 else Material())
            piece.visual = TextureVisuals(uv=None if uv is None else uv[used], material=pbr)
            if colors is not None:
                piece.visual.vertex_attributes["color"] = colors
        elif colors is not None:
            piece.visual = ColorVisuals(piece, vertex_colors=colors)
        scene.add_geometry(piece, geom_name=f"{name}_{max(int(k), 0)}")
    content = scene.export(file_type="glb")
    assert isinstance(content, bytes)
    return {f"{name}.glb": content}


def _bytes_rgba(colors: ndarray) -> ndarray:
    rgba = np.full((len(colors), 4), 255, dtype=np.uint8)
    rgba[:, : colors.shape[1]] = np.rint(np.clip(colors, 0, 1) * 255)
    return rgba


def _pbr(material: Material) -> Any:
    from PIL import Image
    from trimesh.visual.material import PBRMaterial

    values: dict[str, Any] = {"name": material.name, "metallicFactor": 0.0}
    if material.color is not None:
        values["baseColorFactor"] = np.array(material.color)
        values["alphaMode"] = "BLEND" if material.color[3] < 1 else None
    picture = base_picture(material)
    if picture:
        values["baseColorTexture"] = Image.open(io.BytesIO(picture[1]))
    for line in material.extra:
        key, _, value = line.partition(" ")
        if key in ("Pm", "Pr"):
            values["metallicFactor" if key == "Pm" else "roughnessFactor"] = float(value)
    return PBRMaterial(**values)
