"""Mesh files: OBJ (with MTL), PLY, STL, OFF and GLB; glTF is read like GLB, and not written.

`read` gives what the file says, unchecked; `load` checks it; `save` writes.  What is joined on reading:

| kind | vertices | order of vertices | besides positions and faces |
|---|---|---|---|
| OBJ | never joined | the file's | UVs with seams, materials, textures, groups, colours; float64 |
| PLY | only across a UV or normal seam | the file's | UVs with seams, base textures, 8-bit colours, numbers per face |
| GLB | across a UV, normal or primitive seam; copies | the file's | UVs with seams, materials, base textures, colours |
| STL | wherever positions are bit-equal | of first use | nothing; float32 |
| OFF | never joined | the file's | nothing; float64 |

Copies are border edges alike in all of this, which a GLB has where vertices differ in what is not kept.
"""

from __future__ import annotations

import io
import os
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from neusub.errors import MeshFileError, NeusubError
from neusub.files import content_of, replacing
from neusub.mesh import Material, Mesh
from neusub.raw import RawMesh, triangulate, weld

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["KINDS", "RawMesh", "load", "read", "save"]

KINDS = (".obj", ".ply", ".stl", ".off", ".glb")  # read and written
READ_ONLY = (".gltf",)
SINGLE = (".stl", ".glb")  # hold coordinates in single precision


def read(path: str | os.PathLike[str]) -> RawMesh:
    """The mesh in a file, unchecked; its `report` says what was done to it.

    Raises: MeshFileError for a missing file, a folder, an unknown extension, an empty, truncated or garbled file;
    IndexRangeError for an OBJ index that points nowhere, with its line.
    """
    path = Path(path)
    if path.is_dir():
        raise MeshFileError(f"{path} is a folder. Give a mesh file.")
    kind = _known_kind(path, (*KINDS, *READ_ONLY))
    data = content_of(path)
    if not data.strip():
        raise MeshFileError(f"{path} is empty. Get it again.")
    try:
        return _parse(data, kind, path)
    except NeusubError:
        raise
    except Exception as error:  # whatever a parser trips over in a garbled file
        raise MeshFileError(
            f"{path} cannot be read as {kind[1:].upper()} ({type(error).__name__}: {str(error)[:120]}). "
            "It is truncated or garbled: get it again."
        ) from error


def load(path: str | os.PathLike[str]) -> Mesh:
    """The checked mesh in a file; what reading did is in its `load_report`.

    Vertices without faces are dropped with a warning.  Raises: as `read`, and the `MeshError`s of `Mesh`.
    """
    raw = read(path)
    in_range = len(raw.faces) > 0 and raw.faces.min() >= 0 and raw.faces.max() < len(raw.vertices)
    dropped = raw.drop_unreferenced() if in_range else np.zeros(0, dtype=np.int64)
    if len(dropped):
        line = f"dropped {len(dropped)} vertices that no face uses, the first being vertex {dropped[0]}"
        raw.report.append(line)
        warnings.warn(f"{path}: {line}", stacklevel=2)
    return raw.checked()


def save(mesh: Mesh, path: str | os.PathLike[str], overwrite: bool = True) -> None:
    """Write the mesh, and its MTL and texture files beside it; each file appears whole or not at all.

    A texture never takes the place of another picture: it is written as NAME_TEXTURE then, NAME being the mesh file's.
    Warns where the single precision of STL and GLB is too coarse for the mesh.
    Raises: MeshFileError for an unknown extension, a missing or unwritable folder, and, without `overwrite`, a file
    that exists.
    """
    path = Path(path)
    writer = _writer(_known_kind(path, KINDS))
    folder = path.parent
    if path.is_dir():
        raise MeshFileError(f"{path} is a folder. Give a file name in it.")
    if not folder.is_dir():
        raise MeshFileError(f"the folder {folder} does not exist. Make it first.")
    if path.exists() and not overwrite:
        raise MeshFileError(f"{path} exists. Allow overwriting, or give another name.")
    _warn_of_single_precision(mesh, path)
    files = writer(mesh, path.stem)
    own = (path.stem + path.suffix.lower(), f"{path.stem}.mtl")
    others = [content for name, content in files.items() if name not in own and _differs(folder / name, content)]
    if others:
        files = writer(mesh.replace_materials(tuple(_renamed(m, others, path.stem) for m in mesh.materials)), path.stem)
    main = files.pop(own[0])
    for name, content in files.items():
        target = folder / name
        if target.exists() and not _differs(target, content):
            continue
        if target.exists() and not overwrite:
            raise MeshFileError(f"{target} exists. Allow overwriting, or give another name.")
        _write_whole(target, content)
    _write_whole(path, main)


def _warn_of_single_precision(mesh: Mesh, path: Path) -> None:
    """Say so where the format's numbers move vertices by a hundredth of an edge: small meshes far from the origin."""
    if path.suffix.lower() not in SINGLE:
        return
    step = float(np.spacing(np.float32(np.abs(mesh.vertices).max())))
    a, b, _ = (mesh.vertices[column] for column in mesh.faces.T)
    edge = float(np.median(np.linalg.norm(a - b, axis=1)))
    if step > edge / 100:
        warnings.warn(f"{path}: {path.suffix[1:].upper()} has single precision, steps of {step:.2g} at these "
                      f"coordinates, where edges are {edge:.2g} long. Move it to the origin, or write OBJ or PLY.",
                      stacklevel=3)


def _differs(path: Path, content: bytes) -> bool:
    """Whether there is a file with another content."""
    return path.exists() and path.read_bytes() != content


def _renamed(material: Material, pictures: list[bytes], prefix: str) -> Material:
    """The material with other file names for some of its pictures."""
    return replace(material, textures=tuple((role, f"{prefix}_{name}" if content in pictures else name, content)
                                            for role, name, content in material.textures))


def _write_whole(path: Path, content: bytes) -> None:
    try:
        with replacing(path) as new:
            new.write_bytes(content)
    except MeshFileError:
        raise
    except OSError as error:
        raise MeshFileError(f"{path} cannot be written: {error.strerror}. Check space and permissions.") from None


def _known_kind(path: Path, kinds: tuple[str, ...]) -> str:
    kind = path.suffix.lower()
    if kind not in kinds:
        raise MeshFileError(f"{path} has the extension '{path.suffix}'. Known are: {', '.join(kinds)}.")
    return kind


def _parse(data: bytes, kind: str, path: Path) -> RawMesh:
    if kind == ".obj":
        from neusub.obj import parse_obj

        return parse_obj(data, path)
    if kind == ".ply":
        from neusub.ply import parse_ply

        return parse_ply(data, path)
    if kind in (".glb", ".gltf"):
        from neusub.glb import parse_glb

        return parse_glb(data, path)
    return _parse_stl(data, path) if kind == ".stl" else _parse_off(data, path)


def _writer(kind: str) -> Callable[[Mesh, str], dict[str, bytes]]:
    if kind == ".obj":
        from neusub.obj import write_obj

        return write_obj
    if kind == ".ply":
        from neusub.ply import write_ply

        return write_ply
    if kind == ".glb":
        from neusub.glb import write_glb

        return write_glb
    return _write_stl if kind == ".stl" else _write_off


def _parse_stl(data: bytes, path: Path) -> RawMesh:
    from trimesh.exchange.stl import load_stl

    is_text = data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:2000]
    if is_text:
        whole = data.count(b"endfacet") == data.count(b"facet normal") and b"endsolid" in data
    else:
        whole = len(data) >= 84 and len(data) >= 84 + 50 * int(np.frombuffer(data, "<u4", 1, 80)[0])
    if not whole:
        raise MeshFileError(f"{path}: the file ends within its facets. It is truncated: get it again.")
    content = load_stl(io.BytesIO(data))
    if "faces" not in content:
        if not (is_text and b"facet normal" in data):
            raise MeshFileError(f"{path}: the file has no facets. Get it again.")
        raise MeshFileError(f"{path}: several solids in one STL file are not read. Save them as one.")
    vertices = np.asarray(content["vertices"], dtype=np.float64)
    raw = RawMesh(vertices, np.asarray(content["faces"], dtype=np.int64).reshape(-1, 3))
    if len(raw.faces):
        weld(raw, None)
    return raw


def _write_stl(mesh: Mesh, name: str) -> dict[str, bytes]:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    facets = np.zeros(len(mesh.faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    facets["corners"] = mesh.vertices[mesh.faces]
    header = b"neusub".ljust(80) + np.uint32(len(facets)).tobytes()
    return {f"{name}.stl": header + facets.tobytes()}


def _parse_off(data: bytes, path: Path) -> RawMesh:
    """Not on trimesh, whose reader triangulates and takes vertices apart in silence."""
    rows = [row for row in (line.split(b"#", 1)[0].split() for line in data.splitlines()) if row]
    if rows[0][0] != b"OFF":
        raise MeshFileError(f"{path}: the file does not begin with OFF. Only plain OFF is read: save it so.")
    header, rows = (rows[0][1:], rows[1:]) if len(rows[0]) > 1 else (rows[1], rows[2:])
    n_vertices, n_polygons = int(header[0]), int(header[1])
    if len(rows) < n_vertices + n_polygons:
        raise MeshFileError(
            f"{path}: {len(rows)} rows for {n_vertices} vertices and {n_polygons} faces. It is truncated."
        )
    vertices = np.array([row[:3] for row in rows[:n_vertices]], dtype="S").astype(np.float64).reshape(-1, 3)
    polygons = rows[n_vertices : n_vertices + n_polygons]
    count = np.array([int(row[0]) for row in polygons], dtype=np.int64)
    flat = np.array([x for n, row in zip(count, polygons) for x in row[1 : n + 1]] or [b"0"], dtype="S").astype(
        np.int64
    )
    triangles, _ = triangulate(count, flat, vertices)
    raw = RawMesh(vertices, flat[triangles])
    if (count > 3).any():
        raw.report.append(f"cut {(count > 3).sum()} polygons of more than three corners into triangles")
    return raw


def _write_off(mesh: Mesh, name: str) -> dict[str, bytes]:
    from neusub.obj import formatted_rows

    head = f"OFF\n{len(mesh.vertices)} {len(mesh.faces)} 0\n".encode()
    rows = formatted_rows(mesh.vertices, "%r %r %r\n") + formatted_rows(mesh.faces, "3 %d %d %d\n")
    return {f"{name}.off": head + rows}
