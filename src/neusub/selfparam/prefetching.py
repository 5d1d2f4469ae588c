"""What collapses are about to read, fetched into the cache while there is something else to do.

The next edge may lie anywhere on the mesh, and its ring, their quadrics and places in the queue on dozens of lines of
memory, which of a large mesh are in no cache: a collapse took 2.15 times as long at a million vertices as at 10,000,
and takes 1.75 times as long where they are asked for early.  It changes nothing else.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from neusub.compilation import INNER
from neusub.selfparam.queue import FIRST, edge_at
from neusub.selfparam.surface import TWIN, WIDTH, edge_of, head, tail, twin_of

__all__ = ["fetch_next", "fetch_places", "fetch_ring"]

NEXT, LATER = 5, 21  # entries of the queue: those below the first one, and those below these
LINE = 16  # int32


@intrinsic
def fetch(_, array, index):
    """Ask for the line of memory that has an element, counted in the flat array; outside of it nothing happens."""

    def call(context, builder, signature, arguments):
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        place = builder.bitcast(builder.gep(data, [arguments[1]]), cgutils.voidptr_t)
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t, number, number, number])
        hint = builder.module.declare_intrinsic("llvm.prefetch", [cgutils.voidptr_t], kind)
        builder.call(hint, [place, number(0), number(3), number(1)])  # to read, into all caches, data
        return context.get_dummy_value()

    return types.void(array, types.int64), call


@njit(**INNER)
def fetch_faces(surface, f):
    """A face, and those in the lines around it, which often are its neighbours."""
    for line in range(-LINE, LINE + 1, LINE):
        fetch(surface.faces, WIDTH * f + line)  # type: ignore[call-arg]


@njit(**INNER)
def fetch_vertex(work, v):
    fetch(work.surface.positions, 3 * v)  # type: ignore[call-arg]
    fetch(work.surface.positions, 3 * v + 2)  # type: ignore[call-arg]
    fetch(work.quadrics, 10 * v)  # type: ignore[call-arg]
    fetch(work.quadrics, 10 * v + 8)  # type: ignore[call-arg]


@njit(**INNER)
def fetch_next(work):
    """Of the edges that are likely to be next, faces and ends; of those after them the faces."""
    surface, queue = work.surface, work.queue
    if not queue.is_heap[0] or queue.size[0] < LATER:
        return
    for place in range(NEXT, LATER):
        fetch(surface.faces, WIDTH * (edge_at(queue, place) // 3))  # type: ignore[call-arg]
    for place in range(1, NEXT):  # whose faces came when they were among the others
        h = edge_at(queue, place)
        f, twin = h // 3, twin_of(surface, h)
        fetch_faces(surface, f)
        fetch_faces(surface, twin // 3)
        for i in range(3):
            fetch(surface.faces, WIDTH * (np.int64(surface.faces[f, TWIN + i]) // 3))  # type: ignore[call-arg]
        fetch(queue.places, h)  # type: ignore[call-arg]
        fetch_vertex(work, tail(surface, h))
        fetch_vertex(work, head(surface, h))


@njit(**INNER)
def fetch_ring(work, m, gap):
    """Of the vertices of the ring what their edges' costs depend on, and where these edges' places stand."""
    surface, ring = work.surface, work.ring
    for t in range(m):
        v = np.int64(ring.vertices[t])
        fetch_vertex(work, v)
        fetch(work.refused, v)  # type: ignore[call-arg]
        fetch(surface.holds, v)  # type: ignore[call-arg]
        fetch(surface.starts, v)  # type: ignore[call-arg]
        if t != gap:
            fetch(work.queue.places, edge_of(surface, np.int64(ring.halfedges[t])))  # type: ignore[call-arg]


@njit(**INNER)
def fetch_places(work, m, gap):
    """The entries of the ring's edges, and those above and below, with which they may change places."""
    surface, ring, queue = work.surface, work.ring, work.queue
    for t in range(m):
        place = np.int64(queue.places[edge_of(surface, np.int64(ring.halfedges[t]))]) if t != gap else -1
        if place >= 0:
            fetch(queue.entries, 2 * (FIRST + place))  # type: ignore[call-arg]
            fetch(queue.entries, 2 * (FIRST + (place - 1) // 4))  # type: ignore[call-arg]
            fetch(queue.entries, 2 * (FIRST + 4 * place + 1))  # type: ignore[call-arg]
