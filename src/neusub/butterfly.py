r"""Stencils of the modified butterfly scheme (Zorin, Schroeder and Sweldens 1996), edge by edge.

       8 - a - 7       Regular edge v0 v1 (w = 0): 1/2 at v0, v1; 1/8 at a, b; -1/16 at 5 .. 8.
        \ / \ /        An end is regular if it is smooth of valence 6, or on a curve with three faces on this side.
        v0 - v1        With an extraordinary end its own stencil counts alone; with two, the mean of both.
        / \ / \        The stencil of a corner is the edge's midpoint.
       6 - b - 5
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Int64
from numpy import ndarray

from neusub.rings import Around, Block, grouped, sharp_count
from neusub.topology import Topology

__all__ = ["butterfly_edges"]


def butterfly_edges(topology: Topology, sharp: Bool[ndarray, " nE"]) -> Iterable[Block]:
    count = sharp_count(topology, sharp)
    kind = np.minimum(np.maximum(count, 1), 3)[topology.edges]  # 1 smooth, 2 curve, 3 corner
    kind[sharp] = 0
    around = Around(topology, sharp)
    start, position, size = (np.zeros(kind.shape, dtype=np.int64) for _ in range(3))
    on_curve = kind == 2
    start[on_curve], position[on_curve] = around.fan_start(topology.edge_halfedges[on_curve])
    size[on_curve] = around.fan_size(start[on_curve])
    regular = (kind == 1) & (topology.valence[topology.edges] == 6) | on_curve & (size == 3)
    both = regular.all(axis=1)

    yield from _four_point(topology, sharp, count)
    yield _eight_point(topology, np.flatnonzero(both & (kind == 1).all(axis=1)))
    for end in 0, 1:
        rows = np.flatnonzero(both & (kind[:, end] == 2) & (kind[:, 1 - end] == 1))
        yield _beside_curve(topology, around, rows, end, start, position)
    yield from _between_curves(topology, around, np.flatnonzero(both & on_curve.all(axis=1)), start, position)
    for end in 0, 1:
        rows = np.flatnonzero(~regular[:, end] & ~sharp)
        share = np.where(regular[rows, 1 - end], 1.0, 0.5)
        part = kind[rows, end]
        yield from _extraordinary(topology, around, rows[part == 1], end, share[part == 1])
        on = part == 2
        yield from _extraordinary_on_curve(topology, around, rows[on], end, share[on], start, position, size)
        yield rows[part == 3], topology.edges[rows[part == 3]], share[part == 3, None] * np.array([0.5, 0.5])


def _four_point(topology: Topology, sharp: Bool[ndarray, " nE"], count: Int64[ndarray, " nV"]) -> Iterable[Block]:
    """Sharp edges: (-1, 9, 9, -1)/16 along the curve, (3, 6, -1)/8 where it ends at the first, 1/2 if at both."""
    rows = np.flatnonzero(sharp)
    edges = topology.edges[rows]
    # A vertex on a curve has two neighbours along it: their sum less the one is the other.
    total = np.bincount(edges.reshape(-1), edges[:, ::-1].reshape(-1), minlength=topology.n_vertices).astype(np.int64)
    beyond = total[edges] - edges[:, ::-1]
    goes_on = count[edges] == 2
    columns = np.concatenate([edges, beyond], axis=1)
    for picked, use, weights in (
        (goes_on.all(axis=1), [0, 1, 2, 3], [9 / 16, 9 / 16, -1 / 16, -1 / 16]),
        (goes_on[:, 0] & ~goes_on[:, 1], [1, 0, 2], [3 / 8, 6 / 8, -1 / 8]),
        (goes_on[:, 1] & ~goes_on[:, 0], [0, 1, 3], [3 / 8, 6 / 8, -1 / 8]),
        (~goes_on.any(axis=1), [0, 1], [1 / 2, 1 / 2]),
    ):
        yield rows[picked], columns[picked][:, use], np.array(weights)


def _eight_point(topology: Topology, rows: Int64[ndarray, " n"]) -> Block:
    columns = np.empty((len(rows), 8), dtype=np.int32)
    columns[:, :2] = topology.edges[rows]
    columns[:, 2:4] = topology.edge_opposite[rows]
    beyond = topology.faces[:, [2, 0, 1]].reshape(-1)[topology.twins].reshape(-1, 3)  # vertex across each half-edge
    after, before = beyond[:, [1, 2, 0]].reshape(-1), beyond[:, [2, 0, 1]].reshape(-1)
    for end in 0, 1:
        h = topology.edge_halfedges[rows, end]
        columns[:, 4 + end] = after[h]
        columns[:, 6 + end] = before[h]
    return rows, columns, np.array([8, 8, 2, 2, -1, -1, -1, -1]) / 16


def _beside_curve(topology, around, rows, end, start, position) -> Block:
    """Regular edges from a curve (`end`) to the inside; the fan is s0 s1 s2 s3 from the side where the edge is s1."""
    fan = around.fan(start[rows, end], 3)
    second = position[rows, end] == 2
    fan[second] = fan[second, ::-1]
    ring = around.ring(topology.edge_halfedges[rows, 1 - end], 6)  # of s1, from the vertex on the curve on
    ring[second, 1:] = ring[second, :0:-1]
    # Counter-clockwise around s1 from v0 the next is s0, then what lies across s0 s1; the one before v0 is s2.
    columns = np.column_stack([topology.edges[rows, end], fan, ring[:, 2], ring[:, 4]])
    return rows, columns, np.array([6, 1, 10, 3, -1, -1, -2]) / 16


def _between_curves(topology, around, rows, start, position) -> Iterable[Block]:
    """Regular edges with both ends on curves: across an ear, or from one side of a strip to the other (midpoint)."""
    ear = position[rows, 0] != position[rows, 1]
    yield rows[~ear], topology.edges[rows[~ear]], np.array([1, 1]) / 2
    rows = rows[ear]
    first = position[rows, 0] == 1
    fans = [around.fan(start[rows, end], 3) for end in (0, 1)]
    third = np.where(first, fans[0][:, 2], fans[0][:, 1])  # the face that is not the ear
    far = [np.where(first, fans[0][:, 3], fans[0][:, 0]), np.where(first, fans[1][:, 0], fans[1][:, 3])]
    yield rows, np.column_stack([topology.edges[rows], third, *far]), np.array([4, 4, 2, -1, -1]) / 8


def _extraordinary(topology, around, rows, end, share) -> Iterable[Block]:
    """Stencils around smooth vertices, from the neighbour at the edge's other end on."""
    vertex, h = topology.edges[rows, end], topology.edge_halfedges[rows, end]
    for n, i in grouped(topology.valence[vertex], np.arange(len(rows))):
        if n == 3:
            ring = np.array([5, -1, -1]) / 12
        elif n == 4:
            ring = np.array([3, 0, -1, 0]) / 8
        else:
            angle = 2 * np.pi / n * np.arange(n)
            ring = (1 / 4 + np.cos(angle) + np.cos(2 * angle) / 2) / n
        columns = np.column_stack([vertex[i], around.ring(h[i], n)])
        yield rows[i], columns, share[i, None] * np.concatenate([[3 / 4], ring])


def _extraordinary_on_curve(topology, around, rows, end, share, start, position, size) -> Iterable[Block]:
    """Stencils of vertices on a curve with k faces on this side, for the edge at position i of the fan."""
    start, position, size = start[rows, end], position[rows, end], size[rows, end]
    for k, group in grouped(size, np.arange(len(rows))):
        t, i, j = np.pi / k, position[group, None], np.arange(k + 1)
        ring = (np.sin(i * t) * np.sin(j * t) + np.sin(2 * i * t) * np.sin(2 * j * t) / 2) / k
        ends = np.cos(i * t) - np.sin(2 * t) * np.sin(2 * i * t) / (k * (np.cos(t) - np.cos(2 * t)))
        ring[:, [0, k]] = ends / 4 * [1, -1]
        center = 1 - ring.sum(axis=1, keepdims=True)
        columns = np.column_stack([topology.edges[rows[group], end], around.fan(start[group], k)])
        yield rows[group], columns, share[group, None] * np.concatenate([center, ring], axis=1)
