"""Zero-area faces: those with an edge of no length collapse, the others hand it over to the face beside them.

Of three corners in a line the middle one stays where it is: the face beyond the longest edge is split there instead, as
it would be if its edge had that vertex.  So no vertex moves by more than a billionth of an edge.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64
from numpy import ndarray

from neusub.raw import RawMesh
from neusub.topology import Topology, build_topology

__all__ = ["double_areas", "edge_lengths", "is_flat", "mend_flat_faces"]

FLAT = 1e-12  # twice a triangle's area over its longest edge squared, at or below which the area counts as zero
NO_LENGTH = 1e-9  # of a flat face's longest edge: an edge up to this collapses
ROUNDS = 1000


def edge_lengths(corners: Float64[ndarray, "nF 3 3"]) -> Float64[ndarray, "nF 3"]:
    """Of the edges from corner k to k + 1."""
    return np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)


def double_areas(corners: Float64[ndarray, "nF 3 3"]) -> Float64[ndarray, " nF"]:
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)


def is_flat(corners: Float64[ndarray, "nF 3 3"]) -> ndarray:
    if len(corners) == 0:
        return np.zeros(0, dtype=bool)
    with np.errstate(all="ignore"):
        return double_areas(corners) <= FLAT * (edge_lengths(corners) ** 2).max(axis=1)


def mend_flat_faces(work: RawMesh, changes: list[str]) -> None:
    """In place, of a manifold mesh that stays one; in rounds of changes that do not touch each other."""
    counts = dict.fromkeys(("collapsed {} edges of zero-area faces", "flipped {} edges of zero-area faces",
                            "removed {} zero-area faces at the border"), 0)
    for _ in range(ROUNDS):
        done = (_collapse_round(work), *_flip_round(work))
        counts = {line: count + new for (line, count), new in zip(counts.items(), done)}
        if not any(done):
            break
    changes += [line.format(count) for line, count in counts.items() if count]
    left = is_flat(work.vertices[work.faces]).sum()
    if left:
        changes.append(f"kept {left} zero-area faces, which no collapse and no flip mends")


class _Rings:
    """The faces around each vertex, and the vertices that a round has used up."""

    def __init__(self, work: RawMesh):
        self.topology = build_topology(work.faces, len(work.vertices))
        corners = work.faces.reshape(-1)
        self.order = np.argsort(corners, kind="stable")
        self.start = np.searchsorted(corners[self.order], np.arange(self.topology.n_vertices + 1))
        self.touched: set[int] = set()

    def __getitem__(self, v: int) -> ndarray:
        return self.topology.faces[self.order[self.start[v] : self.start[v + 1]] // 3]

    def around(self, *vertices: int) -> set[int]:
        return {int(v) for vertex in vertices for v in self[vertex].reshape(-1)}


def _flat_faces(work: RawMesh, have_short_edges: bool) -> tuple[Int64[ndarray, " n"], Float64[ndarray, "n 3"]]:
    """Flat faces with an edge of no length, or without one; and the lengths of their edges."""
    flat = np.flatnonzero(is_flat(work.vertices[work.faces]))
    lengths = edge_lengths(work.vertices[work.faces[flat]])
    chosen = (lengths.min(axis=1, initial=np.inf) <= NO_LENGTH * lengths.max(axis=1, initial=0)) == have_short_edges
    return flat[chosen], lengths[chosen]


def _collapse_round(work: RawMesh) -> int:
    """Collapse edges of no length; how many."""
    flat, lengths = _flat_faces(work, have_short_edges=True)
    if not len(flat):
        return 0
    rings, target, done = _Rings(work), np.arange(len(work.vertices)), 0
    topology = rings.topology
    for f, side in zip(flat, lengths.argmin(axis=1)):
        e = int(topology.face_edges[f, side])
        gone, kept = (int(v) for v in topology.edges[e])
        if topology.is_boundary_vertex[gone]:  # a border stays where it is
            gone, kept = kept, gone
        around = rings.around(gone, kept)
        if rings.touched & around or not _may_collapse(topology, e, rings):
            continue
        rings.touched |= around
        target[gone] = kept
        done += 1
    work.faces = target[work.faces]
    work.take_faces(~(work.faces == work.faces[:, [1, 2, 0]]).any(axis=1))
    return done


def _may_collapse(topology: Topology, edge: int, rings: _Rings) -> bool:
    """The link condition: the links of the ends meet in the link of the edge, and a face is left on each side."""
    j, k = (int(v) for v in topology.edges[edge])
    on_border = topology.is_boundary_vertex[[j, k]].all()
    if on_border and not topology.is_boundary_edge[edge]:
        return False
    opposite = {int(v) for v in topology.edge_opposite[edge] if v >= 0}
    if (rings.around(j) & rings.around(k)) - {j, k} != opposite:
        return False
    links = [{frozenset(int(v) for v in face if v != end) for face in rings[end]} for end in (j, k)]
    if links[0] & links[1]:  # the two faces over one edge would fall together
        return False
    return len(rings[j]) + len(rings[k]) - 2 * len(opposite) >= 1


def _flip_round(work: RawMesh) -> tuple[int, int]:
    """Flip the longest edges of flat faces, or remove the face where that is at the border; how many of each."""
    flat, lengths = _flat_faces(work, have_short_edges=False)
    if not len(flat):
        return 0, 0
    rings, removed, flipped = _Rings(work), [], 0
    topology, unchanged = rings.topology, set(flat.tolist())
    work.faces = work.faces.copy()  # whose arrays these were keeps them
    work.uv_faces = None if work.uv_faces is None else work.uv_faces.copy()
    work.face_data = {name: values.copy() for name, values in work.face_data.items()}
    for f, side in zip(flat, lengths.argmax(axis=1)):
        p, q, middle = (int(v) for v in np.roll(work.faces[f], -side))
        e = int(topology.face_edges[f, side])
        if rings.touched & {p, q, middle}:
            continue
        if topology.is_boundary_edge[e]:
            others = topology.face_edges[f, [(side + 1) % 3, (side + 2) % 3]]
            if not topology.is_boundary_vertex[middle] or topology.is_boundary_edge[others].any():
                removed.append(f)
                rings.touched |= {p, q, middle}
            continue
        g = int(next(h // 3 for h in topology.edge_halfedges[e] if h // 3 != f))
        at = int(np.flatnonzero(work.faces[g] == q)[0])  # it has q, p and the far corner, in this order
        far = int(work.faces[g, (at + 2) % 3])
        if g in unchanged or far in rings.touched or far in rings.around(middle):
            continue
        rings.touched |= {p, q, middle, far}
        _hand_over(work, f, side, g, at)
        flipped += 1
    if removed and len(removed) < len(work.faces):
        keep = np.ones(len(work.faces), dtype=bool)
        keep[removed] = False
        work.take_faces(keep)
        return flipped, len(removed)
    return flipped, 0


def _hand_over(work: RawMesh, f: int, side: int, g: int, at: int) -> None:
    """The flat face f = (p, q, middle) and its neighbour g = (q, p, far) become the halves of g, split at the middle,
    with what lies on g."""
    p, q, middle = np.roll(work.faces[f], -side)
    far = work.faces[g, (at + 2) % 3]
    work.faces[[f, g]] = [(middle, p, far), (q, middle, far)]
    for values in work.face_data.values():
        values[f] = values[g]
    if work.uv is None or work.uv_faces is None:
        return
    uv_p, uv_q, uv_middle = np.roll(work.uv_faces[f], -side)
    there_q, there_p, uv_far = np.roll(work.uv_faces[g], -at)
    if (uv_p, uv_q) != (there_p, there_q):  # a seam: the middle gets its place on the other side
        place = work.vertices[[p, q, middle]]
        share = np.linalg.norm(place[2] - place[0]) / np.linalg.norm(place[1] - place[0])
        uv_middle = len(work.uv)
        work.uv = np.concatenate([work.uv, [(1 - share) * work.uv[there_p] + share * work.uv[there_q]]])
    work.uv_faces[[f, g]] = [(uv_middle, there_p, uv_far), (there_q, uv_middle, uv_far)]
