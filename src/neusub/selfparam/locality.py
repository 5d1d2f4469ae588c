"""Large meshes are decimated in an order of faces and vertices that keeps neighbours close in memory.

A collapse touches the rings around one edge.  In files, and in refined meshes more so, these lie all over the arrays,
and most of the time goes into waiting for memory: a refined mesh of a million vertices takes a fifth less in this
order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int32, UInt64
from numpy import ndarray

from neusub.selfparam.surface import SEAMS, TWIN, VERSION, Surface, box_of

__all__ = ["LARGE", "Order", "file_order", "local_order", "reordered"]

LARGE = 100_000  # faces; smaller meshes fit the caches
CELLS = 1000.3  # along the longest side of the box
SHIFT = 0.6180339887  # of the cells: round coordinates, which are frequent, must not lie where two cells meet


class Order(NamedTuple):
    """The old index of each new one."""

    vertices: Int32[ndarray, " nV"]
    faces: Int32[ndarray, " nF"]


def file_order(n_vertices: int, n_faces: int) -> Order:
    return Order(np.arange(n_vertices, dtype=np.int32), np.arange(n_faces, dtype=np.int32))


def local_order(positions: Float64[ndarray, "nV 3"], faces: Int32[ndarray, "nF 3"]) -> Order:
    """Vertices along a Z-order curve (Morton 1966) through the cells of the box, faces by their first vertex on it."""
    low, high = box_of(positions)
    cells = (positions - low) / (high - low).max() * CELLS + SHIFT
    x, y, z = (spread_bits(column.astype(np.uint64)) for column in cells.T)
    vertices = np.argsort(x | y << np.uint64(1) | z << np.uint64(2), kind="stable").astype(np.int32)
    rank = np.empty_like(vertices)
    rank[vertices] = np.arange(len(rank), dtype=np.int32)
    first = np.minimum(np.minimum(*(rank[faces[:, k]] for k in (0, 1))), rank[faces[:, 2]])
    return Order(vertices, np.argsort(first, kind="stable").astype(np.int32))


def spread_bits(numbers: UInt64[ndarray, " n"]) -> UInt64[ndarray, " n"]:
    """Two zeros between the bits of numbers below 1024."""
    for shift, mask in ((16, 0x30000FF), (8, 0x300F00F), (4, 0x30C30C3), (2, 0x9249249)):
        numbers = (numbers | numbers << np.uint64(shift)) & np.uint64(mask)
    return numbers


def reordered(surface: Surface, order: Order) -> Surface:
    """The same mesh with its vertices and faces in this order; versions of faces stay."""
    new_vertex, new_face = (np.empty(len(old), np.int32) for old in order)
    new_vertex[order.vertices] = np.arange(len(new_vertex), dtype=np.int32)
    new_face[order.faces] = np.arange(len(new_face), dtype=np.int32)

    def renamed(halfedges: ndarray) -> ndarray:
        old_face = halfedges // 3
        return np.where(halfedges < 0, halfedges, 3 * (new_face[old_face] - old_face) + halfedges)

    faces = surface.faces[order.faces]
    faces[:, :VERSION], faces[:, TWIN:SEAMS] = new_vertex[faces[:, :VERSION]], renamed(faces[:, TWIN:SEAMS])
    return Surface(
        positions=surface.positions[order.vertices],
        faces=faces,
        starts=renamed(surface.starts[order.vertices]),
        holds=surface.holds[order.vertices],
        marks=surface.marks,
    )
