"""Stanford PLY, ASCII and binary, on array code.

Not on trimesh: its reader refuses binary files of mixed polygons, accepts truncated ASCII ones, and splits vertices.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray

from neusub.errors import MeshFileError
from neusub.mesh import Material
from neusub.raw import RawMesh, add_file, base_picture, face_materials, split_at_seams, triangulate, weld

if TYPE_CHECKING:
    from neusub.mesh import Mesh

__all__ = ["parse_ply", "write_ply"]

SIZES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"}
SIZES |= {"double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
SIZES |= {"int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8"}
UV_NAMES = [("s", "t"), ("u", "v"), ("texture_u", "texture_v")]
FACE_LISTS = ("vertex_indices", "vertex_index")
COUNT = " count"  # after a list's name; no property's name has a blank
EXACT = 2**53  # integers up to it are exact as doubles

# A property is (name, type, type of the count or None); an element is (name, number of rows, properties).
Property = tuple[str, str, str | None]
Columns = dict[str, Any]  # scalar: (n,); list: ((n,) counts, values of all rows)
Column = tuple[str, str, ndarray]  # to be written: type, name, values (n,), or (n, k) for lists of k


def parse_ply(data: bytes, path: Path) -> RawMesh:
    """The mesh of a PLY file.  Raises: MeshFileError for a header or a body that is not whole."""
    form, elements, comments, body = _header(data, path)
    read: dict[str, Columns] = {}
    values = _ascii_values(body, path) if form == "ascii" else body
    order = ">" if form == "binary_big_endian" else "<"
    at = 0
    for name, n_rows, properties in elements:
        try:
            if isinstance(values, bytes):
                read[name], at = _binary_element(values, at, n_rows, properties, order)
            else:
                read[name], at = _ascii_element(values, at, n_rows, properties)
        except (IndexError, ValueError):
            raise MeshFileError(
                f"{path}: the file ends within its {n_rows} rows of '{name}'. It is truncated: get it again."
            ) from None
    return _assemble(read, comments, path)


def _header(data: bytes, path: Path) -> tuple[str, list[tuple[str, int, list[Property]]], list[str], bytes]:
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise MeshFileError(
            f"{path}: no PLY header from 'ply' to 'end_header'. The file is truncated or of another kind."
        )
    form, elements, comments = "", [], []
    for line in data[:end].decode(errors="surrogateescape").splitlines()[1:]:
        words = line.split()
        try:
            if words[:1] == ["format"]:
                form = words[1]
            elif words[:1] == ["comment"]:
                comments.append(line.strip()[8:])
            elif words[:1] == ["element"]:
                elements.append((words[1], int(words[2]), []))
            elif words[:2] == ["property", "list"]:
                elements[-1][2].append((words[4], SIZES[words[3]], SIZES[words[2]]))
            elif words[:1] == ["property"]:
                elements[-1][2].append((words[2], SIZES[words[1]], None))
        except (IndexError, KeyError, ValueError):
            raise MeshFileError(f"{path}: the header line '{line.strip()}' is not PLY. Correct it.") from None
    if form not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise MeshFileError(f"{path}: unknown PLY format '{form}'. Save it as ascii or binary_little_endian.")
    return form, elements, comments, data[data.find(b"\n", end) + 1 :]


def _ascii_values(body: bytes, path: Path) -> ndarray:
    try:
        return np.array(body.split() or [b"0"], dtype="S").astype(np.float64)
    except ValueError as error:
        raise MeshFileError(f"{path}: {error}. Correct that value.") from None


def _ascii_element(values: ndarray, at: int, n: int, properties: list[Property]) -> tuple[Columns, int]:
    """n rows from `values[at:]`, at once if all rows have the lists' lengths of the first, else one by one."""
    lengths, width = {}, 0
    for name, _, count_type in properties if n else []:
        lengths[name] = 1 if count_type is None else int(values[at + width])
        width += lengths[name] + (count_type is not None)
    table = values[at : at + n * width]
    if len(table) == n * width:
        columns, k, table = {}, 0, table.reshape(n, width)
        for name, kind, count_type in properties:
            length = lengths.get(name, 0)
            if count_type is None:
                columns[name] = table[:, k].astype(kind) if n else np.zeros(0, kind)
            elif n == 0 or (table[:, k] == length).all():
                k += 1
                columns[name] = (np.full(n, length), table[:, k : k + length].astype(kind).reshape(-1))
            else:
                break
            k += length
        else:
            return columns, at + n * width

    def scalar(k: int, _: str) -> tuple[Any, int]:
        return values[k], k + 1

    def several(k: int, m: int, _: str) -> tuple[ndarray, " int"]:
        return values[k : k + m], k + m

    return _walk(n, properties, at, scalar, several)


def _binary_element(body: bytes, at: int, n: int, properties: list[Property], order: str) -> tuple[Columns, int]:
    fields, offset = [], at
    for name, kind, count_type in properties if n else []:
        if count_type is None:
            fields.append((name, order + kind))
            offset += np.dtype(kind).itemsize
        else:
            length = int(np.frombuffer(body, order + count_type, 1, offset)[0])
            fields += [(name + COUNT, order + count_type), (name, order + kind, (length,))]
            offset += np.dtype(count_type).itemsize + length * np.dtype(kind).itemsize
    row = np.dtype(fields)
    if at + n * row.itemsize <= len(body):
        table = np.frombuffer(body, row, n, at) if n else np.zeros(0, [(p[0], p[1]) for p in properties])
        same = all((table[p[0] + COUNT] == np.shape(table[p[0]])[-1]).all() for p in properties if p[2] and n)
        if same:
            columns: Columns = {
                p[0]: np.ascontiguousarray(table[p[0]])
                if p[2] is None
                else (np.full(n, np.shape(table[p[0]])[-1] if n else 0), table[p[0]].reshape(-1))
                for p in properties
            }
            return columns, at + n * row.itemsize

    def scalar(k: int, kind: str) -> tuple[Any, int]:
        return np.frombuffer(body, order + kind, 1, k)[0], k + np.dtype(kind).itemsize

    def several(k: int, m: int, kind: str) -> tuple[ndarray, " int"]:
        return (np.frombuffer(body, order + kind, m, k) if m else np.zeros(0, kind)), k + m * np.dtype(kind).itemsize

    return _walk(n, properties, at, scalar, several)


def _walk(n: int, properties: list[Property], at: int, scalar: Any, several: Any) -> tuple[Columns, int]:
    """Rows of different lengths, one by one.  Raises: ValueError or IndexError where the values run out."""
    found: dict[str, list[Any]] = {p[0]: [] for p in properties}
    for _ in range(n):
        for name, kind, count_type in properties:
            if count_type is None:
                value, at = scalar(at, kind)
            else:
                length, at = scalar(at, count_type)
                value, at = several(at, int(length), kind)
                if len(value) != int(length):
                    raise ValueError
            found[name].append(value)
    columns: Columns = {}
    for name, kind, count_type in properties:
        rows = found[name]
        columns[name] = (
            np.array(rows).astype(kind)
            if count_type is None
            else (np.array([len(row) for row in rows]), np.concatenate([*rows, []]).astype(kind))
        )
    return columns, at


def _assemble(read: dict[str, Columns], comments: list[str], path: Path) -> RawMesh:
    vertex, face = read.get("vertex", {}), read.get("face", {})
    if not {"x", "y", "z"} <= set(vertex):
        raise MeshFileError(f"{path}: no vertices with x, y and z. Save it as a mesh.")
    vertices = np.stack([vertex[k] for k in "xyz"], axis=1).astype(np.float64)
    raw = RawMesh(vertices, np.zeros((0, 3), dtype=np.int64), colors=_colors(vertex))
    name = next((name for name in FACE_LISTS if name in face), None)
    if name is None:
        if "tristrips" in read:
            raise MeshFileError(f"{path}: triangle strips are not read. Save it with triangles.")
        return raw
    counts, corners = (np.asarray(values).astype(np.int64) for values in face[name])
    if (counts < 3).any():
        raw.report.append(f"dropped {(counts < 3).sum()} polygons of less than three corners")
        corners = corners[np.repeat(counts >= 3, counts)]
    kept = np.flatnonzero(counts >= 3)
    triangles, polygon = triangulate(counts[kept], corners, vertices)
    raw.faces = corners[triangles]
    if (counts > 3).any():
        raw.report.append(f"cut {(counts > 3).sum()} polygons of more than three corners into triangles")
    for key, values in face.items():
        if not isinstance(values, tuple):
            raw.face_data[key] = np.asarray(values)[kept][polygon]
    _texture(raw, vertex, face, counts, kept, triangles)
    _materials(raw, [c[12:].strip() for c in comments if c.startswith("TextureFile ")], path.parent)
    return raw


def _materials(raw: RawMesh, names: list[str], folder: Path) -> None:
    """A material for each texture file; which of them a face has is its `texnumber`, as MeshLab writes it."""
    if not names:
        return
    for name in names:
        image = folder / name
        if not image.is_file():
            raw.report.append(f"material {image.stem}: no image at '{name}'")
        textures = (("map_Kd", image.name, image.read_bytes()),) if image.is_file() else ()
        raw.materials += (Material(image.stem, textures=textures),)
    first = np.zeros(len(raw.faces), dtype=np.int64)
    number = raw.face_data.pop("texnumber", raw.face_data.get("material", first))
    is_known = (number >= -1) & (number < len(names))
    if not is_known.all():
        raw.report.append(f"{(~is_known).sum()} faces have a texture that is none of the {len(names)}: left without")
    raw.face_data["material"] = np.where(is_known, number, -1).astype(np.int64)


def _texture(raw: RawMesh, vertex: Columns, face: Columns, counts: ndarray, kept: ndarray, triangles: ndarray) -> None:
    """UVs of the corners, or of the vertices; the latter, and normals, make seams, which are joined."""
    coordinates = face.get("texcoord")
    if isinstance(coordinates, tuple) and (coordinates[0] == 2 * counts).all() and len(kept) == len(counts):
        rows, index = np.unique(coordinates[1].reshape(-1, 2).astype(np.float64), axis=0, return_inverse=True)
        raw.uv, raw.uv_faces = rows, index.reshape(-1)[triangles].astype(np.int64)
    attributes = []
    for names in UV_NAMES:
        if raw.uv is None and set(names) <= set(vertex):
            raw.uv = np.stack([vertex[name] for name in names], axis=1).astype(np.float64)
            raw.uv_faces = raw.faces.copy()
            attributes.append(raw.uv)
    if {"nx", "ny", "nz"} <= set(vertex):
        attributes.append(np.stack([vertex[k] for k in ("nx", "ny", "nz")], axis=1).astype(np.float64))
    if attributes:
        weld(raw, np.concatenate(attributes, axis=1))


def _colors(vertex: Columns) -> ndarray | None:
    names = [name for name in ("red", "green", "blue", "alpha") if name in vertex]
    if len(names) < 3:
        return None
    columns = np.stack([vertex[name] for name in names], axis=1)
    return columns / {1: 255.0, 2: 65535.0}.get(columns.dtype.itemsize, 1.0)


def write_ply(mesh: Mesh, name: str) -> dict[str, bytes]:
    """Binary little-endian, positions as double, colours as uchar; a vertex on a UV seam is written once for each UV.

    Several textures are written as MeshLab does: the UVs are floats of the corners, vertices are not split, and
    `texnumber` is the texture of each face (-1: none).  Numbers of one per face go along.  What does not fit into a
    PLY is warned of: the rest of materials, other face data.
    Raises: MeshFileError for face data with a name of the PLY's own, or with integers that none of its types holds.
    """
    pictures, files, number = _pictures(mesh)
    several = len(pictures) > 1
    index, corners, uv = (np.arange(len(mesh.vertices)), mesh.faces, None) if several else split_at_seams(mesh)
    face: list[Column] = [("int", "vertex_indices", corners)]
    if several and mesh.uv is not None:
        face.append(("float", "texcoord", mesh.uv[mesh.uv_faces].reshape(-1, 6)))
    if pictures:
        face.append(("int", "texnumber", number))
    data = {k: v for k, v in mesh.face_data.items() if v.ndim == 1 and v.dtype.kind in "biuf" and k.split() == [k]}
    if pictures:
        data.pop("material", None)  # which the texture's number is
    for key, values in data.items():
        if key in [column[1] for column in face]:
            raise MeshFileError(f"face_data['{key}'] has the name of something else in a PLY. Give it another.")
        face.append((_exact_type(key, values), key, values))
    lost = _lost_materials(mesh) + [f"face data '{k}'" for k in mesh.face_data if k not in (*data, "material")]
    if lost:
        warnings.warn(f"{name}.ply: left out {', '.join(lost)}", stacklevel=3)
    header = ["ply", "format binary_little_endian 1.0", "comment neusub"]
    header += [f"comment TextureFile {picture}" for picture in pictures]
    vertex_lines, vertex_rows = _element("vertex", _vertex_columns(mesh, index, uv))
    face_lines, face_rows = _element("face", face)
    text = "\n".join([*header, *vertex_lines, *face_lines, "end_header\n"]).encode(errors="surrogateescape")
    return {f"{name}.ply": text + vertex_rows + face_rows, **files}


def _vertex_columns(mesh: Mesh, index: ndarray, uv: ndarray | None) -> list[Column]:
    columns: list[Column] = [("double", axis, mesh.vertices[index, k]) for k, axis in enumerate("xyz")]
    if uv is not None:
        columns += [("double", "s", uv[:, 0]), ("double", "t", uv[:, 1])]
    if mesh.colors is not None:
        bytes_ = np.rint(np.clip(mesh.colors[index], 0, 1) * 255)
        columns += [("uchar", c, values) for c, values in zip(("red", "green", "blue", "alpha"), bytes_.T)]
    return columns


def _pictures(mesh: Mesh) -> tuple[list[str], dict[str, bytes], ndarray]:
    """The texture of each material that has one, their files, and which of them each face has (-1: none)."""
    names, files = [], {}
    number = np.full(len(mesh.materials) + 1, -1)  # the last is that of faces without material
    for k, material in enumerate(mesh.materials):
        picture = base_picture(material)
        if picture:
            number[k] = len(names)
            names.append(add_file(files, *picture))
    return names, files, number[face_materials(mesh)]


def _lost_materials(mesh: Mesh) -> list[str]:
    """What of the materials does not fit into a PLY."""
    plain = sum(base_picture(material) is None for material in mesh.materials)
    others = sum(len(material.textures) for material in mesh.materials) - (len(mesh.materials) - plain)
    lost = [f"{plain} materials without a texture"] if plain else []
    if any(material.color or material.extra for material in mesh.materials):
        lost.append("colours and shading of materials")
    return lost + ([f"{others} textures other than base colours"] if others else [])


def _exact_type(name: str, values: ndarray) -> str:
    """The type that holds face data exactly.  Raises: MeshFileError for integers that none does."""
    if values.dtype.kind == "f":
        return "double"
    if values.dtype.itemsize == 1 and values.dtype.kind in "bu":
        return "uchar"
    low, high = int(values.min()), int(values.max())
    for kind in ("int", "uint"):
        if np.iinfo(SIZES[kind]).min <= low and high <= np.iinfo(SIZES[kind]).max:
            return kind
    if max(-low, high) > EXACT:
        raise MeshFileError(
            f"face_data['{name}'] goes from {low} to {high}; a PLY holds integers up to {EXACT}. Give smaller ones."
        )
    return "double"


def _element(element: str, columns: list[Column]) -> tuple[list[str], bytes]:
    """The header's lines and the rows."""
    lines, fields = [f"element {element} {len(columns[0][2])}"], []
    for kind, name, values in columns:
        is_list = values.ndim == 2
        lines.append(f"property {'list uchar ' if is_list else ''}{kind} {name}")
        fields += [(name + COUNT, "u1")] if is_list else []
        fields.append((name, "<" + SIZES[kind], values.shape[1:]))
    rows = np.empty(len(columns[0][2]), dtype=fields)
    for _, name, values in columns:
        rows[name] = values
        if values.ndim == 2:
            rows[name + COUNT] = values.shape[1]
    return lines, rows.tobytes()
