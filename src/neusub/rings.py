"""Walks around vertices, many at once: rings of interior vertices, fans on one side of a curve of sharp edges."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Int64
from numpy import ndarray

from neusub.topology import Topology

__all__ = ["Around", "Block", "grouped", "sharp_count"]

Block = tuple[ndarray, ndarray, ndarray]  # rows (n,), each at most once; columns (n, w); weights (w,) or (n, w)


def sharp_count(topology: Topology, sharp: Bool[ndarray, " nE"]) -> Int64[ndarray, " nV"]:
    return np.bincount(topology.edges[sharp].reshape(-1), minlength=topology.n_vertices)


class Around:
    """Half-edges out of a vertex, counter-clockwise; walks loop over the position, for many vertices at once."""

    def __init__(self, topology: Topology, sharp: Bool[ndarray, " nE"]):
        self.tail = topology.faces.reshape(-1)
        self.head = topology.faces[:, [1, 2, 0]].reshape(-1)
        self.twins = topology.twins
        self.sharp = sharp[topology.face_edges.reshape(-1)]

    def ring(self, h: Int64[ndarray, " n"], valence: int) -> Int64[ndarray, "n valence"]:
        """All neighbours of an interior vertex, from the head of h on."""
        columns = []
        for _ in range(valence):
            columns.append(self.head[h])
            h = self.twins[_previous(h)]
        return np.stack(columns, axis=1)

    def fan(self, start: Int64[ndarray, " n"], k: int) -> Int64[ndarray, "n k+1"]:
        """The k + 1 neighbours on one side of a curve; `start` runs along the curve."""
        last = _previous(start)
        columns = [self.head[start], self.tail[last]]
        for _ in range(k - 1):
            last = _previous(self.twins[last])
            columns.append(self.tail[last])
        return np.stack(columns, axis=1)

    def fan_start(self, h: Int64[ndarray, " n"]) -> tuple[Int64[ndarray, " n"], Int64[ndarray, " n"]]:
        """The sharp half-edge that begins the side of the curve where h is, and the position of h in that fan."""
        start, position = h.copy(), np.zeros(len(h), dtype=np.int64)
        active = np.flatnonzero(~self.sharp[start])
        while len(active):
            position[active] += 1
            start[active] = _next(self.twins[start[active]])
            active = active[~self.sharp[start[active]]]
        return start, position

    def fan_size(self, start: Int64[ndarray, " n"]) -> Int64[ndarray, " n"]:
        """Number of faces from `start` to the next sharp edge."""
        last, size = _previous(start), np.ones(len(start), dtype=np.int64)
        active = np.flatnonzero(~self.sharp[last])
        while len(active):
            size[active] += 1
            last[active] = _previous(self.twins[last[active]])
            active = active[~self.sharp[last[active]]]
        return size


def _next(h: Int64[ndarray, " n"]) -> Int64[ndarray, " n"]:
    return np.where(h % 3 == 2, h - 2, h + 1)


def _previous(h: Int64[ndarray, " n"]) -> Int64[ndarray, " n"]:
    return np.where(h % 3 == 0, h + 2, h - 1)


def grouped(key: Int64[ndarray, " n"], values: Int64[ndarray, " n"]) -> Iterable[tuple[int, Int64[ndarray, " m"]]]:
    """Values by key, in one sort."""
    order = np.argsort(key, kind="stable")
    keys, first = np.unique(key[order], return_index=True)
    return zip(keys.tolist(), np.split(values[order], first[1:]))
