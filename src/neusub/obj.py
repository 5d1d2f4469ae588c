"""Wavefront OBJ and MTL, on array code.

Not on trimesh: its reader splits vertices at UV seams, sorts them by their use, and drops groups, so that the one rule
for OBJ here (`v` rows stay as they are, in their order) could not be kept.
"""

from __future__ import annotations

import re
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray

from neusub.errors import IndexRangeError, MeshFileError
from neusub.mesh import Material
from neusub.raw import RawMesh, add_file, face_materials, triangulate

if TYPE_CHECKING:
    from neusub.mesh import Mesh

__all__ = ["formatted_rows", "parse_obj", "write_obj"]


BOM = b"\xef\xbb\xbf"  # some editors put it before UTF-8
UNNAMED = "default"  # material of faces that have none, where others have one
COLOURED = {6, 7}  # numbers of a vertex with a colour
# What may stand before the file name of a texture in an MTL file: -bm 0.5, -s 2 2 1, -clamp on, -imfchan r, ...
TEXTURE_OPTIONS = re.compile(r"(?:-[a-z]+\s+(?:(?:on|off|[rgbmlz]|sphere|cube_\w+|[-+.\d][-+.\deE]*)\s+)+)+")


def parse_obj(text: bytes, path: Path) -> RawMesh:
    """The mesh of an OBJ file.  Raises: MeshFileError for what is no number, IndexRangeError, each with the line."""
    if text[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise MeshFileError(f"{path} is in UTF-16. Save it as UTF-8, or as plain ASCII.")
    lines = _lines(text.removeprefix(BOM))
    vertices, colors, uncoloured = _positions(lines, path)
    uv_lines = [line[3:] for line in lines if line[:3] == b"vt "]
    uv = _rows(uv_lines, 2, lines, b"vt", path) if uv_lines else None
    at = np.array([i for i, line in enumerate(lines) if line[:2] == b"f "], dtype=np.int64)
    counts, corners, uv_corners = _corners([lines[i][2:] for i in at], at, path)
    _absolute(corners, counts, at, lines, b"v ", len(vertices), "vertices")
    is_textured = False
    if uv is not None and len(corners):
        absent = uv_corners == 0
        uv_corners[absent] = 1
        _absolute(uv_corners, counts, at, lines, b"vt ", len(uv), "texture vertices")
        if absent.any():  # a corner without UV takes one of its own
            uv_corners[absent] = len(uv)
            uv = np.concatenate([uv, [[0.0, 0.0]]])
        is_textured = not absent.all()
    triangles, polygon = triangulate(counts, corners, vertices)
    raw = RawMesh(vertices, corners[triangles], colors=colors)
    if is_textured:
        raw.uv, raw.uv_faces = uv, uv_corners[triangles]
    if uncoloured:
        raw.report.append(f"left out the colours: {uncoloured} of {len(vertices)} vertices have none")
    if (counts > 3).any():
        raw.report.append(f"cut {(counts > 3).sum()} polygons of more than three corners into triangles")
    _face_states(raw, lines, at, polygon, path)
    return raw


def _lines(text: bytes) -> list[bytes]:
    """The lines without comments, tabs and leading blanks; a continued line is joined and followed by empty ones."""
    if b"\\" in text:
        text = re.sub(rb"(?:[^\n]*\\\r?\n)+[^\n]*", _join_continued, text)
    if b"\t" in text:
        text = text.replace(b"\t", b" ")
    lines = text.splitlines()
    if b"#" in text:
        lines = [line.split(b" #" if b"mtl" in line else b"#", 1)[0] if b"#" in line else line for line in lines]
    if b"\n " in text or text[:1] == b" ":
        lines = [line.lstrip() for line in lines]
    return lines


def _join_continued(match: re.Match[bytes]) -> bytes:
    block = match.group()
    return re.sub(rb"\\\r?\n", b" ", block) + b"\n" * (block.count(b"\n"))


def _positions(lines: list[bytes], path: Path) -> tuple[ndarray, ndarray | None, int]:
    """Positions, colours if all vertices have one, and how many have none where others have."""
    rows = [line[2:] for line in lines if line[:2] == b"v "]
    if not rows:
        return np.zeros((0, 3)), None, 0
    widths = [len(row.split()) for row in rows]
    if set(widths) <= COLOURED:
        values = _rows(rows, min(widths), lines, b"v", path)
        colors = values[:, -3:]
        return values[:, :3].copy(), colors / 255.0 if colors.max() > 1.0 else colors.copy(), 0
    without = sum(width not in COLOURED for width in widths)
    return _rows(rows, 3, lines, b"v", path), None, without if without < len(rows) else 0


def _rows(rows: list[bytes], width: int, lines: list[bytes], key: bytes, path: Path) -> ndarray:
    """The first `width` numbers of each row; missing ones after the first are an error, except the v of a `vt`."""
    tokens = b" ".join(rows).split()
    if len(tokens) != width * len(rows) or any(len(row.split()) != width for row in rows):
        tokens = [token for row in rows for token in (row.split() + [b"0"] * (key == b"vt"))[:width]]
    try:
        if len(tokens) != width * len(rows):
            raise ValueError
        return np.array(tokens, dtype="S").astype(np.float64).reshape(-1, width)
    except ValueError:
        i, line = 0, b""
        for i, line in enumerate(lines):  # noqa: B007 (used after the loop)
            if line[: len(key) + 1] == key + b" ":
                try:
                    if len([float(x) for x in line.split()[1:]][:width]) == width or key == b"vt":
                        continue
                except ValueError:
                    pass
                break
        shown = line[:60].decode(errors="replace")
        raise MeshFileError(f"{path}: line {i + 1} is '{shown}', not {width} numbers. Correct it.") from None


def _corners(rows: list[bytes], at: ndarray, path: Path) -> tuple[ndarray, ndarray, ndarray]:
    """Corners of each polygon, and of each corner the vertex and the texture vertex (0: none), as in the file."""
    split = [row.split() for row in rows]
    counts = np.array([len(row) for row in split], dtype=np.int64)
    if (counts < 3).any():
        k = int(np.argmax(counts < 3))
        raise MeshFileError(f"{path}: the face in line {at[k] + 1} has {counts[k]} corners. Give three or more.")
    tokens = [token for row in split for token in row]
    slashes = {token.count(b"/") for token in tokens}
    if slashes <= {0}:
        table = np.array(tokens, dtype="S")[:, None] if tokens else np.zeros((0, 1), dtype="S1")
    else:
        padded = b"/".join([token + b"/0" * (2 - token.count(b"/")) for token in tokens])
        table = np.array(padded.replace(b"//", b"/0/").split(b"/"), dtype="S")
    try:
        numbers = table.astype(np.int64).reshape(len(tokens), 1 if slashes <= {0} else 3)
    except ValueError:
        owner = np.repeat(at, counts)
        i = next((i for i, t in enumerate(tokens) if not re.fullmatch(rb"-?\d+(/-?\d*){0,2}", t)), 0)
        shown = tokens[i].decode(errors="replace")
        raise MeshFileError(f"{path}: line {owner[i] + 1} has the corner '{shown}', no index. Correct it.") from None
    uv = numbers[:, 1].copy() if numbers.shape[1] > 1 else np.zeros(len(tokens), dtype=np.int64)
    return counts, numbers[:, 0].copy(), uv


def _absolute(index: ndarray, counts: ndarray, at: ndarray, lines: list[bytes], key: bytes, n: int, noun: str) -> None:
    """Turn the file's indices into ones from 0, in place; a negative one counts back from its line."""
    is_bad = (index == 0) | (index > n)
    negative = index < 0
    if negative.any():
        rows = np.array([i for i, line in enumerate(lines) if line.startswith(key)], dtype=np.int64)
        before = np.repeat(np.searchsorted(rows, at), counts)
        is_bad |= negative & (index + before < 0)
        index[negative] += before[negative] + 1
    if is_bad.any():
        k = int(np.argmax(is_bad))
        line = int(np.repeat(at, counts)[k])
        shown = lines[line][:60].decode(errors="replace")
        raise IndexRangeError(
            f"the face in line {line + 1}, '{shown}', points outside the {n} {noun} "
            "of the file. Correct the index; indices count from 1, or back from -1."
        )
    index -= 1


def _face_states(raw: RawMesh, lines: list[bytes], at: ndarray, polygon: ndarray, path: Path) -> None:
    """Material and group of each face, from the last `usemtl`, `g` or `o` before it."""
    library: dict[str, Material] = {}
    for line in lines:
        if line.startswith(b"mtllib "):
            for file in _libraries(path.parent, decoded(line[7:].strip())):
                library.update(_read_mtl(file, raw.report))
    names, index = _states(lines, at, b"usemtl ")
    if names and len(polygon):
        raw.face_data["material"] = index[polygon]
        raw.materials = tuple(library.get(name, Material(name)) for name in names)
    for key in (b"g ", b"o "):
        names, index = _states(lines, at, key)
        if len(names) > 1 and len(polygon):
            raw.face_data["group"] = np.array([*names, ""])[index[polygon]]
            break


def _states(lines: list[bytes], at: ndarray, key: bytes) -> tuple[list[str], ndarray]:
    """The names that faces use in order of appearance, and which of them holds at each face line (-1: none yet)."""
    rows = [i for i, line in enumerate(lines) if line.startswith(key) or line == key[:-1]]  # `g` alone has no name
    spelled = [decoded(lines[i][len(key) :].strip()) for i in rows]
    numbers = {name: k for k, name in enumerate(dict.fromkeys(spelled))}
    number = np.array([-1] + [numbers[name] for name in spelled], dtype=np.int64)
    return list(numbers), number[np.searchsorted(np.array(rows, dtype=np.int64), at)]


def decoded(text: bytes) -> str:
    """UTF-8, or else Latin-1, in which any bytes are a text: names that differ stay different."""
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text.decode("latin-1")


def named_file(folder: Path, name: str) -> Path:
    """The file of that name; if there is none, one whose name is the same in Latin-1."""
    path = folder / name
    if not path.is_file():
        with suppress(UnicodeError):
            latin = folder / name.encode("latin-1").decode(errors="surrogateescape")
            return latin if latin.is_file() else path
    return path


def _libraries(folder: Path, names: str) -> list[Path]:
    """The files of an `mtllib`: several, or one whose name has blanks."""
    whole = named_file(folder, names)
    return [whole] if whole.is_file() else [named_file(folder, name) for name in names.split()]


def _image(folder: Path, words: str) -> tuple[str, Path]:
    """The options before a texture's file name, and the file."""
    def found(name: str) -> Path:
        return named_file(folder, name.strip().split("  ")[0].replace("\\", "/"))

    options = TEXTURE_OPTIONS.match(words)
    if options is None or found(words).is_file():
        return "", found(words)
    return " " + options.group().strip(), found(words[options.end() :])


def _read_mtl(path: Path, report: list[str]) -> dict[str, Material]:
    if not path.is_file():
        report.append(f"the material file {path.name} is missing; materials keep their names only")
        return {}
    materials: dict[str, Material] = {}
    text = "\n".join(map(decoded, path.read_bytes().removeprefix(BOM).splitlines()))
    for block in re.split(r"^\s*newmtl\s+", text, flags=re.MULTILINE)[1:]:
        name, *body = [re.split(r"(?:^|\s)#", line)[0].strip() for line in block.splitlines()]
        color, alpha, textures, extra = None, 1.0, [], []
        for line in filter(None, body):
            role, rest = (*line.split(None, 1), "")[:2]
            if role == "Kd" and re.fullmatch(r"[\s\d.eE+-]+", rest) and len(rest.split()) >= 3:
                color = tuple(float(x) for x in rest.split()[:3])
            elif role == "d" and re.fullmatch(r"[\d.eE+-]+", rest.strip()):
                alpha = float(rest)
            elif role == "Tr" and re.fullmatch(r"[\d.eE+-]+", rest.strip()):
                alpha = 1 - float(rest)
            elif role.lower().startswith(("map_", "norm", "bump", "disp")):
                options, image = _image(path.parent, rest)
                if image.is_file():
                    textures.append((role + options, image.name, image.read_bytes()))
                else:
                    extra.append(line)
                    report.append(f"material {name}: no image at '{rest.strip()}'; the line is kept, no file is copied")
            else:
                extra.append(line)
        if color is None and alpha != 1:
            color = (1.0, 1.0, 1.0)  # an opacity alone leaves the texture as it is
        rgba = None if color is None else (color[0], color[1], color[2], alpha)
        materials[name] = Material(name, rgba, tuple(textures), tuple(extra))
    return materials


def write_obj(mesh: Mesh, name: str) -> dict[str, bytes]:
    """The files of the mesh: `name`.obj, and `name`.mtl and textures where there are materials."""
    files: dict[str, bytes] = {}
    names = _unique([*(material.name for material in mesh.materials), UNNAMED])
    parts = [b"# neusub\n"]
    if mesh.materials:
        parts.append(f"mtllib {name}.mtl\n".encode(errors="surrogateescape"))
        files.update(_mtl_files(mesh, name, names))
    rows = mesh.vertices if mesh.colors is None else np.concatenate([mesh.vertices, mesh.colors[:, :3]], axis=1)
    parts.append(formatted_rows(rows, "v" + " %r" * rows.shape[1] + "\n"))
    if mesh.uv is not None and mesh.uv_faces is not None:
        parts.append(formatted_rows(mesh.uv, "vt %r %r\n"))
        corners = np.stack([mesh.faces, mesh.uv_faces], axis=2).reshape(-1, 6) + 1
        row = "f %d/%d %d/%d %d/%d\n"
    else:
        corners, row = mesh.faces + 1, "f %d %d %d\n"
    for header, start, stop in _runs(mesh, names):
        parts.append(header + formatted_rows(corners[start:stop], row))
    return {f"{name}.obj": b"".join(parts), **files}


def formatted_rows(rows: ndarray, row: str, block: int = 65536) -> bytes:
    """`row % values` for each row, a block of rows in one formatting call; %r gives the shortest exact digits."""
    return b"".join(
        (row * len(part) % tuple(part.reshape(-1).tolist())).encode()
        for part in (rows[i : i + block] for i in range(0, len(rows), block))
    )


def _unique(names: list[str]) -> list[str]:
    """The names, numbered where there was one like it before."""
    known: dict[str, None] = {}
    for name in names:
        fresh = (f"{name}_{k}" if k > 1 else name for k in count(1))
        known[next(candidate for candidate in fresh if candidate not in known)] = None
    return list(known)


def _runs(mesh: Mesh, names: list[str]) -> list[tuple[bytes, int, int]]:
    """Stretches of faces with one group and one material, each with the lines that announce them; order is kept.

    names: of the materials, and one for faces without any."""
    n = len(mesh.faces)
    changed = np.zeros(n, dtype=bool)
    changed[0] = True
    group, material = mesh.face_data.get("group"), face_materials(mesh)
    for values in (group, material):
        if values is not None and values.ndim == 1:
            changed[1:] |= values[1:] != values[:-1]
    starts = np.flatnonzero(changed)
    runs, dressed = [], False
    for start, stop in zip(starts, [*starts[1:], n]):
        header = "" if group is None else f"g {group[start]}\n"
        dressed |= bool(material[start] >= 0)
        if dressed:  # a name holds until the next
            header += f"usemtl {names[material[start]]}\n"
        runs.append((header.encode(), int(start), int(stop)))
    return runs


def _mtl_files(mesh: Mesh, name: str, names: list[str]) -> dict[str, bytes]:
    files: dict[str, bytes] = {}
    lines = []
    for own, material in zip(names, mesh.materials):
        lines.append(f"newmtl {own}")
        if material.color is not None:
            lines += ["Kd " + " ".join(map(repr, material.color[:3])), f"d {material.color[3]!r}"]
        lines += material.extra
        for role, file_name, content in material.textures:
            lines.append(f"{role} {add_file(files, file_name, content)}")
    if (face_materials(mesh) < 0).any():
        lines.append(f"newmtl {names[-1]}")
    files[f"{name}.mtl"] = ("\n".join(lines) + "\n").encode(errors="surrogateescape")  # names of textures
    return files
