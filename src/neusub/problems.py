"""What keeps arrays from being an oriented manifold: each problem with its first element, a count and a remedy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
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

__all__ = ["EdgeGroups", "as_floats", "as_indices", "duplicate_faces", "face_edge_groups", "find_problems",
           "iterate_problems", "listed_row", "more_of", "non_finite_problems", "vertex_fans"]

FARTHEST = 1e75  # coordinate: squares of areas stay finite


def find_problems(vertices: ndarray, faces: ndarray, numbers: ndarray | None = None) -> list[MeshError]:
    """Every kind of problem that `Mesh` would raise for, each with its first element, a count and a remedy.

    numbers (nF,): what to call the faces; 0 .. nF - 1 by default.
    """
    try:
        return list(iterate_problems(as_floats(vertices, "vertices", (3,)), as_indices(faces, "faces"), numbers))
    except ShapeError as error:
        return [error]


def iterate_problems(
    vertices: Float64[ndarray, "nV 3"], faces: Int64[ndarray, "nF 3"], numbers: ndarray | None = None
) -> Iterator[MeshError]:
    """Those of `find_problems` one by one; after an index that is out of range nothing else can be asked."""
    numbers = np.arange(len(faces)) if numbers is None else numbers
    if len(faces) == 0:
        yield EmptyMeshError(f"the mesh has {len(vertices)} vertices and no faces. Give at least one triangle.")
    yield from non_finite_problems(vertices)
    if len(faces) == 0:
        return
    out_of_range = ((faces < 0) | (faces >= len(vertices))).any(axis=1)
    if out_of_range.any():
        f = int(np.argmax(out_of_range))
        yield IndexRangeError(
            f"face {numbers[f]} is {listed_row(faces[f])}, but there are {len(vertices)} vertices "
            f"(0 to {len(vertices) - 1}){more_of(out_of_range.sum(), 'face')}. Correct the indices; they count from 0."
        )
        return
    yield from _face_problems(faces, numbers)
    yield from _edge_problems(faces, len(vertices), numbers)
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    if not used.all():
        yield UnreferencedVertexError(
            f"vertex {int(np.argmin(used))} belongs to no face{more_of((~used).sum(), 'vertex')}. "
            "Run 'neusub repair', or remove it."
        )


def non_finite_problems(vertices: Float64[ndarray, "nV 3"]) -> Iterator[MeshError]:
    bad = ~(np.abs(vertices) <= FARTHEST).all(axis=1)
    if bad.any():
        v = int(np.argmax(bad))
        yield NonFiniteError(
            f"vertex {v} is {listed_row(vertices[v])}{more_of(bad.sum(), 'vertex')}. Give every vertex a finite "
            f"position, with coordinates of absolute value at most {FARTHEST}."
        )


def _face_problems(faces: Int64[ndarray, "nF 3"], numbers: ndarray) -> Iterator[MeshError]:
    repeated = (faces == faces[:, [1, 2, 0]]).any(axis=1)
    if repeated.any():
        f = int(np.argmax(repeated))
        yield RepeatedVertexError(
            f"face {numbers[f]} is {listed_row(faces[f])}, with a vertex twice{more_of(repeated.sum(), 'face')}. "
            "Run 'neusub repair', or remove the face."
        )
    order, is_copy = duplicate_faces(faces)
    if is_copy.any():
        at = int(np.argmax(is_copy))
        first, second = sorted(order[[at, at + 1]])
        yield DuplicateFaceError(
            f"faces {numbers[first]} and {numbers[second]} have the same vertices {listed_row(np.sort(faces[first]))}"
            f"{more_of(is_copy.sum(), 'face')}. Run 'neusub repair', or remove one of them."
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


def _edge_problems(faces: Int64[ndarray, "nF 3"], n_vertices: int, numbers: ndarray) -> Iterator[MeshError]:
    groups = face_edge_groups(faces, n_vertices)
    crowded = np.flatnonzero(groups.counts > 2)
    if len(crowded):
        at = crowded[0]
        around = groups.halfedges[groups.starts[at] : groups.starts[at] + groups.counts[at]]
        u, v = sorted((int(groups.tail[around[0]]), int(groups.head[around[0]])))
        yield NonManifoldEdgeError(
            f"edge ({u}, {v}) belongs to {len(around)} faces: {_listed(numbers[around // 3])}"
            f"{more_of(len(crowded), 'such edge')}. Run 'neusub repair --split-edges', or remove the extra face."
        )
    pairs = groups.starts[groups.counts == 2]
    one, other = groups.halfedges[pairs], groups.halfedges[pairs + 1]
    same = groups.tail[one] == groups.tail[other]
    if same.any():
        h, g = int(one[np.argmax(same)]), int(other[np.argmax(same)])
        yield OrientationError(
            f"faces {numbers[h // 3]} and {numbers[g // 3]} both run along edge ({groups.tail[h]}, {groups.head[h]}) "
            f"the same way{more_of(same.sum(), 'such edge')}. Run 'neusub repair', or reverse one of them "
            "(a one-sided surface, like a Moebius strip, must be cut first)."
        )
    n_fans, fan = vertex_fans(groups)
    at_vertex = np.zeros(n_fans, dtype=np.int64)
    at_vertex[fan] = groups.tail
    fans = np.bincount(at_vertex, minlength=n_vertices)
    if (fans > 1).any():
        v = int(np.argmax(fans > 1))
        of_each = numbers[_fan_faces(groups, fan, v)]
        yield NonManifoldVertexError(
            f"vertex {v} joins {fans[v]} separate fans of faces, with faces {_listed(of_each)}"
            f"{more_of((fans > 1).sum(), 'such vertex')}. "
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


def listed_row(values: ndarray) -> str:
    return "(" + ", ".join(f"{x:g}" if isinstance(x, float) else str(x) for x in values.tolist()) + ")"


def _listed(values: ndarray, most: int = 6) -> str:
    return ", ".join(str(int(x)) for x in values[:most]) + (", ..." if len(values) > most else "")


def more_of(count: int, noun: str) -> str:
    if count <= 1:
        return ""
    plural = noun[:-2] + "ices" if noun.endswith("vertex") else noun + "s"
    return f" (and {count - 1} more {noun if count == 2 else plural})"
