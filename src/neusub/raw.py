"""A mesh as a file gave it, unchecked, and what every file kind needs: polygons to triangles, welds along seams."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64, Int64
from numpy import ndarray

from neusub.errors import MeshError
from neusub.mesh import Material, Mesh
from neusub.problems import EdgeGroups, face_edge_groups, find_problems, vertex_fans

__all__ = [
    "RawMesh", "add_file", "bad_vertices", "base_picture", "count_coincident", "face_materials", "join_copies",
    "split_at_seams", "triangulate", "weld",
]  # fmt: skip


@dataclass
class RawMesh:
    """The fields of `mesh.Mesh`, unchecked; `report` says what reading the file did."""

    vertices: Float64[ndarray, "nV 3"]
    faces: Int64[ndarray, "nF 3"]
    uv: Float64[ndarray, "nT 2"] | None = None
    uv_faces: Int64[ndarray, "nF 3"] | None = None
    colors: Float64[ndarray, "nV C"] | None = None
    face_data: dict[str, ndarray] = field(default_factory=dict)
    materials: tuple[Material, ...] = ()
    report: list[str] = field(default_factory=list)
    origin: ndarray | None = None  # of each face its number before others were taken away, where that is to be told
    numbered: tuple[ndarray, ndarray, ndarray | None] | None = None  # vertices, faces, origin: as errors name them

    def checked(self) -> Mesh:
        """The mesh, with the report as its load report.  Raises: the `MeshError`s of `Mesh`."""
        self.bring_colors_to_range()
        try:
            return Mesh(
                vertices=self.vertices,
                faces=self.faces,
                uv=self.uv,
                uv_faces=self.uv_faces,
                colors=self.colors,
                face_data=self.face_data,
                materials=self.materials,
                load_report=tuple(self.report),
            )
        except MeshError as error:
            before = find_problems(*(self.numbered or (self.vertices, self.faces, self.origin)))
            raise next((problem for problem in before if type(problem) is type(error)), error) from None

    def bring_colors_to_range(self) -> None:
        """Colours that a file gives as real numbers, to 0 .. 1, in place."""
        if self.colors is None or self.colors.dtype.kind != "f" or not np.isfinite(self.colors).all():
            return
        low, high = self.colors.min(initial=0), self.colors.max(initial=0)
        if 1 < high <= 255 and (self.colors == np.rint(self.colors)).all():
            self.report.append(f"colours are whole numbers up to {high:g}: they count as 0 to 255")
            self.colors = self.colors / 255
        elif high > 1 or low < 0:
            self.report.append(f"colours from {low:g} to {high:g} are cut to 0 to 1")
        self.colors = self.colors.clip(0, 1)

    def take_faces(self, keep: ndarray) -> None:
        """Keep the faces `keep` (indices or a mask) and what lies on them, in place."""
        self.faces = self.faces[keep]
        self.uv_faces = None if self.uv_faces is None else self.uv_faces[keep]
        self.face_data = {name: values[keep] for name, values in self.face_data.items()}
        self.origin = None if self.origin is None else self.origin[keep]

    def number_of(self, face: int) -> int:
        """The number of a face in the file."""
        return int(face if self.origin is None else self.origin[face])

    def drop_unreferenced(self) -> Int64[ndarray, " nDropped"]:
        """Drop the vertices that no face uses, in place; returns their old indices.  Trusts the indices' range."""
        used = np.zeros(len(self.vertices), dtype=bool)
        used[self.faces] = True
        if not used.all():
            self.numbered = self.numbered or (self.vertices, self.faces, self.origin)
            self.faces = (np.cumsum(used) - 1)[self.faces]
            self.vertices = self.vertices[used]
            self.colors = None if self.colors is None else self.colors[used]
        return np.flatnonzero(~used)


def triangulate(
    counts: Int64[ndarray, " nP"], corners: Int64[ndarray, " nC"], vertices: Float64[ndarray, "nV 3"]
) -> tuple[Int64[ndarray, "nF 3"], Int64[ndarray, " nF"]]:
    """Triangles as positions in `corners`, and the polygon of each, in the polygons' order.

    counts: corners of each polygon, 3 or more.  A convex polygon becomes a fan, a quad the pair over the diagonal
    whose two normals agree better (the shorter on a tie); ears are cut from others.
    """
    first = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)
    triangles, owners = [], []
    for n in np.unique(counts):
        polygons = np.flatnonzero(counts == n)
        at = first[polygons, None] + np.arange(n)
        fan = np.stack([np.zeros(n - 2, dtype=np.int64), np.arange(1, n - 1), np.arange(2, n)], axis=1)
        pattern = np.tile(fan, (len(at), 1, 1))
        if n > 3:
            _bend_fans(pattern, vertices[np.clip(corners[at], 0, max(len(vertices) - 1, 0))])
        triangles.append(np.take_along_axis(at, pattern.reshape(len(at), -1), axis=1).reshape(-1, 3))
        owners.append(np.repeat(polygons, n - 2))
    if not triangles:
        return np.zeros((0, 3), dtype=np.int64), np.zeros(0, dtype=np.int64)
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(triangles)[order], owner[order]


def _bend_fans(pattern: Int64[ndarray, "nP n-2 3"], points: Float64[ndarray, "nP n 3"]) -> None:
    """Replace, in place, the fans that fold over: quads by their other diagonal, larger polygons by ear cutting."""
    n = points.shape[1]
    with np.errstate(invalid="ignore", over="ignore"):
        if n == 4:
            agree, length = [], []
            for k in (0, 1):  # the diagonal from corner k to corner k + 2
                p, q, r, s = (points[:, (k + i) % 4] for i in range(4))
                agree.append((np.cross(q - p, r - p) * np.cross(r - p, s - p)).sum(axis=1) > 0)
                length.append(((r - p) ** 2).sum(axis=1))
            other = (agree[1] & ~agree[0]) | ((agree[0] == agree[1]) & (length[1] < length[0] * (1 - 1e-9)))
            pattern[other] = [[1, 2, 3], [3, 0, 1]]
            return
        ahead = np.roll(points, -1, axis=1)
        normal = np.cross(points, ahead).sum(axis=1)  # Newell's
        fan = np.cross(points[:, 1:-1] - points[:, :1], points[:, 2:] - points[:, :1])
        folded = ((fan * normal[:, None]).sum(axis=2) < 0).any(axis=1)
    for k in np.flatnonzero(folded):
        pattern[k] = _cut_ears(points[k], normal[k])


def _cut_ears(points: Float64[ndarray, "n 3"], normal: ndarray) -> list[tuple[int, int, int]]:
    """Triangles of a simple polygon: cut a convex corner whose triangle holds no other corner, again and again."""
    axis = int(np.argmax(np.abs(normal)))
    flat = np.delete(points, axis, axis=1) * ([-1, 1] if (axis == 1) != (normal[axis] < 0) else [1, 1])

    def area(a: ndarray, b: ndarray, c: ndarray) -> ndarray:
        return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])

    left, triangles = list(range(len(points))), []
    while len(left) > 3:
        for i in range(len(left)):
            ear = (left[i - 1], left[i], left[(i + 1) % len(left)])
            a, b, c = flat[list(ear)]
            rest = flat[[k for k in left if k not in ear]]
            inside = (area(a, b, rest) >= 0) & (area(b, c, rest) >= 0) & (area(c, a, rest) >= 0)
            if area(a, b, c) > 0 and not inside.any():
                break
        else:  # not a simple polygon: any corner will do
            i, ear = 1, (left[0], left[1], left[2])
        triangles.append(ear)
        del left[i]
    return [*triangles, (left[0], left[1], left[2])]


def weld(raw: RawMesh, attributes: Float64[ndarray, "nV K"] | None) -> None:
    """Join, in place, the two sides of each seam: pairs of border edges whose ends have bit-equal positions.

    attributes: UV, normal, primitive of each vertex; a seam is where vertices at one position differ in them, and only
    there is anything joined.  None: join wherever positions are equal (STL).  Border edges that meet more than one
    partner would make an edge with three faces: they are left apart and reported.  Vertices keep their order, the
    first of those joined stays.  Per-corner UVs must be set before.
    """
    n = len(raw.vertices)
    if len(raw.faces) == 0 or raw.faces.min() < 0 or raw.faces.max() >= n:
        return
    site = _groups_of_equal_rows(raw.vertices)
    on_seam = np.ones(n, dtype=bool) if attributes is None else _differs_within(site, attributes)
    tail, head = _border(raw.faces, n)
    mine = (on_seam[tail] | on_seam[head]) & (site[tail] != site[head])
    apart = len(tail) - mine.sum() - len(np.unique(np.sort(site[np.stack([tail, head], 1)[~mine]], axis=1), axis=0))
    if apart:
        raw.report.append(f"left {apart} border edges apart that coincide with others without a seam between them")
    tail, head = tail[mine], head[mine]
    h, g, crowded = _partners(site, tail, head)
    same = site[tail[h]] == site[tail[g]]
    pairs = np.concatenate(
        [
            np.stack([tail[h], np.where(same, tail[g], head[g])], axis=1),
            np.stack([head[h], np.where(same, head[g], tail[g])], axis=1),
        ]
    )
    target = _joined(pairs, n)
    left_out = crowded + _undo_bad(raw.faces, target)
    _apply_weld(raw, target, "seams" if attributes is not None else "equal positions")
    if left_out:
        raw.report.append(f"left {left_out} welds out, which would have made the mesh non-manifold")


def join_copies(raw: RawMesh, attributes: Float64[ndarray, "nV K"]) -> Float64[ndarray, "nU K"]:
    """Join, in place, pairs of border edges that run in opposite directions and are alike in all that is kept.

    Exporters write such copies where only something else differs, tangents for one.
    attributes: as of `weld`; with positions and colours they are what is bit-equal at both ends.  Returns those of the
    vertices that are left.  What stays apart is not reported: that `weld` does, which comes next.
    """
    n = len(raw.vertices)
    if len(raw.faces) == 0 or raw.faces.min() < 0 or raw.faces.max() >= n:
        return attributes
    colors = [] if raw.colors is None else [raw.colors]
    site = _groups_of_equal_rows(np.hstack([raw.vertices, attributes, *colors]))
    tail, head = _border(raw.faces, n)
    proper = site[tail] != site[head]
    tail, head = tail[proper], head[proper]
    h, g, _ = _partners(site, tail, head)
    opposite = site[tail[h]] == site[head[g]]
    h, g = h[opposite], g[opposite]
    pairs = np.stack([np.concatenate([tail[h], head[h]]), np.concatenate([head[g], tail[g]])], axis=1)
    target = _joined(pairs, n)
    _undo_bad(raw.faces, target)
    return attributes[_apply_weld(raw, target, "edges written twice")]


def count_coincident(vertices: Float64[ndarray, "nV 3"], faces: Int64[ndarray, "nF 3"]) -> int:
    """Border edges that lie where just one other does, as all do where each face has its own vertices."""
    tail, head = _border(faces, len(vertices))
    ends, index = np.unique(np.concatenate([tail, head]), return_inverse=True)
    if len(ends) == 0:
        return 0
    site = _groups_of_equal_rows(vertices[ends])
    tail, head = index[: len(tail)], index[len(tail) :]
    proper = site[tail] != site[head]
    return 2 * len(_partners(site, tail[proper], head[proper])[0])


def _partners(site: ndarray, tail: ndarray, head: ndarray) -> tuple[Int64[ndarray, " n"], Int64[ndarray, " n"], int]:
    """Pairs of the edges tail -> head that alone lie between the same two sites, and at how many places more do."""
    low, high = np.minimum(site[tail], site[head]), np.maximum(site[tail], site[head])
    _, edge, counts = np.unique(low * len(site) + high, return_inverse=True, return_counts=True)
    order = np.argsort(edge, kind="stable")
    start = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)[counts == 2]
    return order[start], order[start + 1], int((counts > 2).sum())


def _apply_weld(raw: RawMesh, target: Int64[ndarray, " nV"], where: str) -> ndarray:
    """Put each vertex's target in its place; returns which vertices are kept."""
    kept = target == np.arange(len(target))
    if not kept.all():
        raw.faces = (np.cumsum(kept) - 1)[target[raw.faces]]
        raw.vertices = raw.vertices[kept]
        raw.colors = None if raw.colors is None else raw.colors[kept]
        raw.report.append(f"joined {(~kept).sum()} vertices at {where}; {len(raw.vertices)} are left")
    return kept


def _border(faces: Int64[ndarray, "nF 3"], n_vertices: int) -> tuple[Int64[ndarray, " nB"], Int64[ndarray, " nB"]]:
    """Where the half-edges with no face beside them begin and end."""
    groups = face_edge_groups(faces, n_vertices)
    border = groups.halfedges[groups.starts[groups.counts == 1]]
    return faces.reshape(-1)[border], faces[:, [1, 2, 0]].reshape(-1)[border]


def _undo_bad(faces: Int64[ndarray, "nF 3"], target: Int64[ndarray, " nV"]) -> int:
    """Take back, in place, the welds that made edges with three faces or vertices with two fans; returns how many."""
    n, undone = len(target), 0
    already = bad_vertices(faces, n)
    for _ in range(8):
        welded = target[faces]
        bad = np.setdiff1d(bad_vertices(welded, n), already)
        members = np.flatnonzero(np.isin(target, bad) & (target != np.arange(n)))
        if len(members) == 0:
            return undone
        target[members] = members
        undone += len(members)
    undone += int((target != np.arange(n)).sum())
    target[:] = np.arange(n)
    return undone


def bad_vertices(faces: Int64[ndarray, "nF 3"], n_vertices: int) -> Int64[ndarray, " nBad"]:
    """Vertices of edges with three or more faces, and vertices with more than one fan."""
    groups: EdgeGroups = face_edge_groups(faces, n_vertices)
    crowded = groups.halfedges[groups.starts[groups.counts > 2]]
    n_fans, fan = vertex_fans(groups)
    at_vertex = np.zeros(n_fans, dtype=np.int64)
    at_vertex[fan] = groups.tail
    several = np.flatnonzero(np.bincount(at_vertex, minlength=n_vertices) > 1)
    return np.unique(np.concatenate([groups.tail[crowded], groups.head[crowded], several]))


def _joined(pairs: Int64[ndarray, "n 2"], n: int) -> Int64[ndarray, " n"]:
    """The lowest index of each class, from the pairs that are joined."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(pairs), dtype=bool), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    _, label = connected_components(graph.tocsr(), directed=False)
    return np.unique(label, return_index=True)[1][label].astype(np.int64)


def _groups_of_equal_rows(rows: ndarray) -> Int64[ndarray, " n"]:
    """A number for each row, the same for bit-equal rows (0 and -0 count as equal)."""
    rows = rows + 0.0
    order = np.lexsort(rows.T[::-1])
    is_new = np.concatenate([[True], (rows[order[1:]] != rows[order[:-1]]).any(axis=1)])
    group = np.empty(len(rows), dtype=np.int64)
    group[order] = np.cumsum(is_new) - 1
    return group


def _differs_within(group: Int64[ndarray, " n"], attributes: Float64[ndarray, "n K"]) -> ndarray:
    """Whether the group of each vertex holds different attributes."""
    kind = _groups_of_equal_rows(attributes)
    low = np.full(group.max() + 1, np.iinfo(np.int64).max)
    high = np.full(group.max() + 1, -1)
    np.minimum.at(low, group, kind)
    np.maximum.at(high, group, kind)
    return (low != high)[group]


def split_at_seams(mesh: Mesh) -> tuple[Int64[ndarray, " n"], Int64[ndarray, "nF 3"], Float64[ndarray, "n 2"] | None]:
    """For files with one UV per vertex: the vertex of each row to write, the faces over the rows, the rows' UVs.

    Rows 0 .. nV - 1 are the vertices themselves, each with one of its UVs; its other UVs follow in more rows.
    """
    n = len(mesh.vertices)
    if mesh.uv is None or mesh.uv_faces is None:
        return np.arange(n), mesh.faces, None
    uv_row = _groups_of_equal_rows(mesh.uv)  # two rows of equal UVs are no seam in such a file
    uv = np.zeros((uv_row.max() + 1, 2))
    uv[uv_row] = mesh.uv
    pairs, row = np.unique(mesh.faces * len(uv) + uv_row[mesh.uv_faces], return_inverse=True)
    vertex, texture = pairs // len(uv), pairs % len(uv)
    is_first = np.concatenate([[True], vertex[1:] != vertex[:-1]])
    place = np.where(is_first, vertex, n - 1 + np.cumsum(~is_first))
    index, rows_uv = np.arange(n + int((~is_first).sum())), np.zeros((n + int((~is_first).sum()), 2))
    index[place], rows_uv[place] = vertex, uv[texture]
    return index, place[row].reshape(-1, 3), rows_uv


def face_materials(mesh: Mesh) -> Int64[ndarray, " nF"]:
    """The material of each face, -1 for none; where the faces do not say, it is the first."""
    material = mesh.face_data.get("material")
    if not mesh.materials or material is None or material.ndim != 1:
        return np.full(len(mesh.faces), 0 if mesh.materials else -1)
    return material.astype(np.int64)


def base_picture(material: Material) -> tuple[str, bytes] | None:
    """File name and bytes of the base colour's texture."""
    return next((texture[1:] for texture in material.textures if texture[0].split()[0] == "map_Kd"), None)


def add_file(files: dict[str, bytes], name: str, content: bytes) -> str:
    """Add a file, in place; its name, which is another where the name stands for another content."""
    while files.get(name, content) != content:
        name = "_" + name
    files[name] = content
    return name
