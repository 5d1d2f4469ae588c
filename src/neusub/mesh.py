"""The mesh that everything works on: checked once, here, and frozen.

`Mesh` is an oriented 2-manifold of triangles, with or without boundary, of any number of components.  Zero-area faces
are allowed.  Data lie on vertices (`colors`), on corners (`uv_faces` into `uv`, so that seams stay seams) and on faces
(`face_data`; the key "material" indexes `materials`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64
from numpy import ndarray

from neusub.errors import (
    DuplicateFaceError,
    EmptyMeshError,
    IndexRangeError,
    MeshError,
    NonFiniteError,
    NonManifoldEdgeError,
    NonManifoldVertexError,
    OrientationError,
    RepeatedVertexError,
    ShapeError,
    UnreferencedVertexError,
)
from neusub.topology import Topology, build_topology, refine_corners

__all__ = ["Material", "Mesh", "check_is_mesh", "face_edge_groups", "find_problems", "vertex_fans"]

FARTHEST = 1e75  # coordinate: squares of areas stay finite


@dataclass(frozen=True)
class Material:
    """How a group of faces looks.  Texture files are kept as they came, undecoded.

    color: linear factors r, g, b, a in [0, 1].  textures: (role, file name, bytes), the role being the word of an MTL
    file ("map_Kd" is the base colour), with its options ("map_Kd -s 2 2 1").  extra: further lines of the MTL file,
    word by word.
    """

    name: str = "material"
    color: tuple[float, float, float, float] | None = None
    textures: tuple[tuple[str, str, bytes], ...] = ()
    extra: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Mesh:
    """An oriented manifold triangle mesh, checked on construction; its arrays are copies and read-only.

    vertices (nV, 3): positions, any length unit.  faces (nF, 3): counter-clockwise seen from outside.
    uv (nT, 2) and uv_faces (nF, 3): texture coordinates, v upwards, and each corner's index into them.
    colors (nV, 3 or 4): RGB or RGBA in [0, 1]; integer input counts as 0 .. 255.
    face_data: name -> (nF, ...), which follows its faces through refinement.
    Raises: the `MeshError` of the first kind that `find_problems` finds; `ShapeError` for arrays that do not fit.
    """

    vertices: Float64[ndarray, "nV 3"]
    faces: Int64[ndarray, "nF 3"]
    uv: Float64[ndarray, "nT 2"] | None = None
    uv_faces: Int64[ndarray, "nF 3"] | None = None
    colors: Float64[ndarray, "nV C"] | None = None
    face_data: Mapping[str, ndarray] = field(default_factory=dict)
    materials: tuple[Material, ...] = ()
    load_report: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        vertices = as_floats(self.vertices, "vertices", (3,))
        faces = as_indices(self.faces, "faces")
        for problem in iterate_problems(vertices, faces):
            raise problem
        uv, uv_faces = checked_uv(self.uv, self.uv_faces, len(faces))
        self._fill(
            vertices=vertices,
            faces=faces,
            uv=uv,
            uv_faces=uv_faces,
            colors=checked_colors(self.colors, len(vertices)),
            face_data=checked_face_data(self.face_data, len(faces), len(self.materials)),
            materials=tuple(self.materials),
            load_report=tuple(self.load_report),
        )

    @classmethod
    def _trusted(cls, **values: Any) -> Mesh:
        """A mesh from fields that are known to be right, unchecked and uncopied."""
        mesh = object.__new__(cls)
        defaults = {"uv": None, "uv_faces": None, "colors": None, "face_data": {}, "materials": (), "load_report": ()}
        mesh._fill(**{**defaults, **values})
        return mesh

    def _fill(self, **values: Any) -> None:
        for array in [*values.values(), *values["face_data"].values()]:
            if isinstance(array, ndarray):
                array.flags.writeable = False
        if not isinstance(values["face_data"], MappingProxyType):
            values["face_data"] = MappingProxyType(values["face_data"])
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "face_data": dict(self.face_data)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Frozen again: arrays come writable out of a pickle or a copy."""
        self._fill(**state)

    @cached_property
    def topology(self) -> Topology:
        """Edges and half-edges, built on first use."""
        return build_topology(self.faces, len(self.vertices))

    def replace_vertices(self, vertices: Float64[ndarray, "nV 3"]) -> Mesh:
        """The same mesh with every vertex elsewhere.  Raises: ShapeError, NonFiniteError."""
        vertices = as_floats(vertices, "vertices", (3,))
        if len(vertices) != len(self.vertices):
            raise ShapeError(f"{len(vertices)} positions for {len(self.vertices)} vertices: give one for each.")
        for problem in non_finite_problems(vertices):
            raise problem
        mesh = Mesh._trusted(**{**self._values(), "vertices": vertices})
        if "topology" in self.__dict__:  # the connectivity is the same one
            mesh.__dict__["topology"] = self.topology
        return mesh

    def replace_materials(self, materials: tuple[Material, ...]) -> Mesh:
        """The same mesh with other materials, as many.  Raises: ShapeError."""
        if len(materials) != len(self.materials):
            raise ShapeError(f"{len(materials)} materials for {len(self.materials)}: give one for each.")
        return Mesh._trusted(**{**self._values(), "materials": tuple(materials)})

    def refined(
        self,
        vertices: Float64[ndarray, "nV_fine 3"],
        faces: Int64[ndarray, "4*nF 3"] | None = None,
        colors: Float64[ndarray, "nV_fine C"] | None = None,
    ) -> Mesh:
        """One midpoint refinement, with positions (and colours) of the old vertices and then of the edges' midpoints.

        faces: the topology's `refined_faces`, for a caller who has them; shared, and read-only from then on.  UVs go
        linearly along each corner edge, face data to the four children of their face.  Nothing is checked again:
        refinement keeps a manifold.
        """
        uv, uv_faces = self.uv, self.uv_faces
        if uv is not None and uv_faces is not None:
            chart = build_topology(uv_faces, len(uv))
            uv = np.concatenate([uv, uv[chart.edges].mean(axis=1)])
            uv_faces = refine_corners(uv_faces, chart.face_edges + chart.n_vertices)
        return Mesh._trusted(
            vertices=np.array(vertices, dtype=np.float64),
            faces=self.topology.refined_faces if faces is None else faces,
            uv=uv,
            uv_faces=uv_faces,
            colors=None if colors is None else np.array(colors, dtype=np.float64),
            face_data={name: np.concatenate([values] * 4) for name, values in self.face_data.items()},
            materials=self.materials,
            load_report=self.load_report,
        )

    def _values(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}


def check_is_mesh(mesh: Any, name: str = "mesh") -> None:
    """Raises TypeError."""
    if not isinstance(mesh, Mesh):
        raise TypeError(f"{name} is a {type(mesh).__name__}: load a file with neusub.load, or build a neusub.Mesh.")


def find_problems(vertices: ndarray, faces: ndarray) -> list[MeshError]:
    """Every kind of problem that `Mesh` would raise for, each with its first element, a count and a remedy."""
    try:
        return list(iterate_problems(as_floats(vertices, "vertices", (3,)), as_indices(faces, "faces")))
    except ShapeError as error:
        return [error]


def iterate_problems(vertices: Float64[ndarray, "nV 3"], faces: Int64[ndarray, "nF 3"]) -> Iterator[MeshError]:
    """The problems one by one; after an index that is out of range nothing else can be asked."""
    if len(faces) == 0:
        yield EmptyMeshError(f"the mesh has {len(vertices)} vertices and no faces. Give at least one triangle.")
    yield from non_finite_problems(vertices)
    if len(faces) == 0:
        return
    out_of_range = ((faces < 0) | (faces >= len(vertices))).any(axis=1)
    if out_of_range.any():
        f = int(np.argmax(out_of_range))
        yield IndexRangeError(
            f"face {f} is {_row(faces[f])}, but there are {len(vertices)} vertices (0 to {len(vertices) - 1})"
            f"{_more(out_of_range.sum(), 'face')}. Correct the indices; they count from 0."
        )
        return
    yield from _face_problems(faces)
    yield from _edge_problems(faces, len(vertices))
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    if not used.all():
        yield UnreferencedVertexError(
            f"vertex {int(np.argmin(used))} belongs to no face{_more((~used).sum(), 'vertex')}. "
            "Run 'neusub repair', or remove it."
        )


def non_finite_problems(vertices: Float64[ndarray, "nV 3"]) -> Iterator[MeshError]:
    bad = ~(np.abs(vertices) <= FARTHEST).all(axis=1)
    if bad.any():
        v = int(np.argmax(bad))
        yield NonFiniteError(
            f"vertex {v} is {_row(vertices[v])}{_more(bad.sum(), 'vertex')}. Give every vertex a finite position, with "
            f"coordinates of absolute value at most {FARTHEST}."
        )


def _face_problems(faces: Int64[ndarray, "nF 3"]) -> Iterator[MeshError]:
    repeated = (faces == faces[:, [1, 2, 0]]).any(axis=1)
    if repeated.any():
        f = int(np.argmax(repeated))
        yield RepeatedVertexError(
            f"face {f} is {_row(faces[f])}, with a vertex twice{_more(repeated.sum(), 'face')}. "
            "Run 'neusub repair', or remove the face."
        )
    order, is_copy = duplicate_faces(faces)
    if is_copy.any():
        at = int(np.argmax(is_copy))
        first, second = sorted(order[[at, at + 1]])
        yield DuplicateFaceError(
            f"faces {first} and {second} have the same vertices {_row(np.sort(faces[first]))}"
            f"{_more(is_copy.sum(), 'face')}. Run 'neusub repair', or remove one of them."
        )


def duplicate_faces(faces: Int64[ndarray, "nF 3"]) -> tuple[Int64[ndarray, " nF"], ndarray]:
    """The faces sorted by their vertex sets, and whether the next in that order has the same set (nF - 1,)."""
    corners = np.sort(faces, axis=1)
    order = np.lexsort((corners[:, 2], corners[:, 1], corners[:, 0]))
    ordered = corners[order]
    return order, (ordered[1:] == ordered[:-1]).all(axis=1)


@dataclass(frozen=True)
class EdgeGroups:
    """Half-edges sorted by the undirected edge they run along."""

    halfedges: Int64[ndarray, " nH"]  # half-edge 3 f + i, sorted by edge, then by index
    starts: Int64[ndarray, " nE"]  # where each edge's half-edges begin
    counts: Int64[ndarray, " nE"]
    tail: Int64[ndarray, " nH"]  # of half-edge h, not of the sorted ones
    head: Int64[ndarray, " nH"]


def face_edge_groups(faces: Int64[ndarray, "nF 3"], n_vertices: int) -> EdgeGroups:
    """The half-edges along each edge; unlike `build_topology` it needs no manifold."""
    tail, head = faces.reshape(-1), faces[:, [1, 2, 0]].reshape(-1)
    key = np.minimum(tail, head) * n_vertices + np.maximum(tail, head)
    order = np.argsort(key, kind="stable")
    key = key[order]
    starts = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
    return EdgeGroups(order, starts, np.diff(np.append(starts, len(key))), tail, head)


def _edge_problems(faces: Int64[ndarray, "nF 3"], n_vertices: int) -> Iterator[MeshError]:
    groups = face_edge_groups(faces, n_vertices)
    crowded = np.flatnonzero(groups.counts > 2)
    if len(crowded):
        at = crowded[0]
        around = groups.halfedges[groups.starts[at] : groups.starts[at] + groups.counts[at]]
        u, v = sorted((int(groups.tail[around[0]]), int(groups.head[around[0]])))
        yield NonManifoldEdgeError(
            f"edge ({u}, {v}) belongs to {len(around)} faces: {_listed(around // 3)}"
            f"{_more(len(crowded), 'such edge')}. Run 'neusub repair --split-edges', or remove the extra face."
        )
    pairs = groups.starts[groups.counts == 2]
    one, other = groups.halfedges[pairs], groups.halfedges[pairs + 1]
    same = groups.tail[one] == groups.tail[other]
    if same.any():
        h, g = int(one[np.argmax(same)]), int(other[np.argmax(same)])
        yield OrientationError(
            f"faces {h // 3} and {g // 3} both run along edge ({groups.tail[h]}, {groups.head[h]}) the same way"
            f"{_more(same.sum(), 'such edge')}. Run 'neusub repair', or reverse one of them "
            "(a one-sided surface, like a Moebius strip, must be cut first)."
        )
    n_fans, fan = vertex_fans(groups)
    at_vertex = np.zeros(n_fans, dtype=np.int64)
    at_vertex[fan] = groups.tail
    fans = np.bincount(at_vertex, minlength=n_vertices)
    if (fans > 1).any():
        v = int(np.argmax(fans > 1))
        yield NonManifoldVertexError(
            f"vertex {v} joins {fans[v]} separate fans of faces, with faces {_listed(_fan_faces(groups, fan, v))}"
            f"{_more((fans > 1).sum(), 'such vertex')}. "
            "Run 'neusub repair --split-vertices', or give each fan its own vertex."
        )


def _fan_faces(groups: EdgeGroups, fan: ndarray, v: int) -> ndarray:
    """One face of each fan at vertex v."""
    corners = np.flatnonzero(groups.tail == v)
    return corners[np.unique(fan[corners], return_index=True)[1]] // 3


def vertex_fans(groups: EdgeGroups, across: ndarray | None = None) -> tuple[int, Int64[ndarray, " nH"]]:
    """Number of fans, and the fan of each corner (corner i of face f is 3 f + i): corners joined across edges.

    across (nE,): the edges that join their faces; all of them by default, crowded ones too, as those are another
    problem than a vertex with several fans.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    is_joined = np.ones(len(groups.halfedges), dtype=bool)
    is_joined[groups.starts] = False
    if across is not None:
        is_joined &= np.repeat(across, groups.counts)
    at = np.flatnonzero(is_joined)
    h, g = groups.halfedges[at - 1], groups.halfedges[at]
    h_next, g_next = (k + 1 - 3 * (k % 3 == 2) for k in (h, g))
    same = groups.tail[h] == groups.tail[g]
    rows = np.concatenate([h, h_next])
    columns = np.concatenate([np.where(same, g, g_next), np.where(same, g_next, g)])
    graph = coo_array((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(len(groups.tail),) * 2)
    n_fans, fan = connected_components(graph.tocsr(), directed=False)
    return int(n_fans), fan.astype(np.int64)


def as_floats(values: Any, name: str, width: tuple[int, ...]) -> Float64[ndarray, "n C"]:
    """A float64 copy of shape (n, one of `width`).  Raises: ShapeError."""
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ShapeError(f"{name} is no array of numbers: {error}. Give real numbers.") from None
    if array.ndim != 2 or array.shape[1] not in width:
        wanted = " or ".join(f"(n, {w})" for w in width)
        raise ShapeError(f"{name} has shape {array.shape}. Give an array of shape {wanted}.")
    return array


def as_indices(values: Any, name: str) -> Int64[ndarray, "n 3"]:
    """An int64 copy of shape (n, 3).  Raises: ShapeError."""
    array = np.asarray(values)
    if array.size == 0:
        array = array.reshape(0, 3).astype(np.int64)
    if array.dtype.kind not in "iu" or array.ndim != 2 or array.shape[1] != 3:
        raise ShapeError(
            f"{name} has shape {array.shape} and type {array.dtype}. Give integers of shape (n, 3), a triangle a row."
        )
    return np.array(array, dtype=np.int64, order="C")


def checked_uv(uv: Any, uv_faces: Any, n_faces: int) -> tuple[ndarray | None, ndarray | None]:
    if (uv is None) != (uv_faces is None):
        raise ShapeError("uv and uv_faces come together: give both, or neither.")
    if uv is None:
        return None, None
    uv, uv_faces = as_floats(uv, "uv", (2,)), as_indices(uv_faces, "uv_faces")
    if len(uv_faces) != n_faces:
        raise ShapeError(f"uv_faces has {len(uv_faces)} rows for {n_faces} faces: give one for each.")
    bad = ~np.isfinite(uv).all(axis=1)
    if bad.any():
        raise NonFiniteError(f"uv {int(np.argmax(bad))} is {_row(uv[np.argmax(bad)])}. Give finite coordinates.")
    bad = ((uv_faces < 0) | (uv_faces >= len(uv))).any(axis=1)
    if bad.any():
        f = int(np.argmax(bad))
        raise IndexRangeError(f"uv_faces {f} is {_row(uv_faces[f])}, but there are {len(uv)} rows of uv.")
    return uv, uv_faces


def checked_colors(colors: Any, n_vertices: int) -> Float64[ndarray, "nV C"] | None:
    if colors is None:
        return None
    is_integer = np.asarray(colors).dtype.kind in "iu"
    array = as_floats(colors, "colors", (3, 4))
    if len(array) != n_vertices:
        raise ShapeError(f"colors has {len(array)} rows for {n_vertices} vertices: give one for each.")
    if not np.isfinite(array).all():
        raise NonFiniteError("colors has a value that is not finite. Give values in [0, 1].")
    array = array / 255.0 if is_integer else array
    bad = ((array < 0) | (array > 1)).any(axis=1)
    if bad.any():
        v = int(np.argmax(bad))
        raise IndexRangeError(f"the color of vertex {v} is {_row(np.asarray(colors)[v])}{_more(bad.sum(), 'vertex')}. "
                              "Give values in [0, 1], or integers from 0 to 255.")
    return array


def checked_face_data(face_data: Mapping[str, Any] | None, n_faces: int, n_materials: int) -> dict[str, ndarray]:
    checked = {name: np.array(values) for name, values in (face_data or {}).items()}
    for name, values in checked.items():
        if values.ndim == 0 or len(values) != n_faces:
            raise ShapeError(f"face_data[{name!r}] has shape {values.shape} for {n_faces} faces: give a row for each.")
    material = checked.get("material")
    if n_materials and material is not None and (material.min() < -1 or material.max() >= n_materials):
        raise IndexRangeError(f"face_data['material'] goes to {material.max()}, but there are {n_materials} materials.")
    return checked


def _row(values: ndarray) -> str:
    return "(" + ", ".join(f"{x:g}" if isinstance(x, float) else str(x) for x in values.tolist()) + ")"


def _listed(values: ndarray, most: int = 6) -> str:
    return ", ".join(str(int(x)) for x in values[:most]) + (", ..." if len(values) > most else "")


def _more(count: int, noun: str) -> str:
    if count <= 1:
        return ""
    plural = noun[:-2] + "ices" if noun.endswith("vertex") else noun + "s"
    return f" (and {count - 1} more {noun if count == 2 else plural})"
