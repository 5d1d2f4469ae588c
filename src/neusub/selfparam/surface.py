r"""The mesh that is being decimated: half-edges on raw arrays, the ring around an edge, and the collapse itself.

Half-edge h = 3 f + i runs from corner i of face f to the next one (as in `topology.py`).

           x1 --- c=r0         Ring of the half-edge h: j -> k: the vertices around both ends, counter-clockwise,
          /   \  /  \          from c.  Ring edge t runs from r[t] to r[t + 1] and has one face on its inner side,
        x2 --- j -h-> k ...    with its apex at j for t < split and at k for t >= split (r[split] is d).
          \   /  \  /          f0 = (j, k, c) and f1 = (k, j, d) vanish in the collapse; the other faces stay,
           ... - d             their apex becoming the merged vertex i (which keeps j's index).

An end on the boundary leaves one ring edge without a face: `gap`.  Along a boundary edge there is no f1 (and no d);
the gap is then at `split`, between the boundary neighbours of j and of k.

But for `box_of`, `frame_of` and `make_ring` all are compiled kernels on arrays that they trust; `collapse.py` checks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy import ndarray

from neusub.compilation import INNER

__all__ = [
    "BORDER", "FIXED", "FREE", "ONE", "ON_SEAM", "SEAMS", "TWIN", "VERSION", "WIDTH", "ZERO", "Ring", "Surface",
    "box_of", "collapse_edge", "frame_of", "gather_ring", "make_ring",
]  # fmt: skip

FREE, ON_SEAM, FIXED = range(3)
BORDER = 4  # is added to these

VERSION, TWIN, SEAMS, WIDTH = 3, 4, 7, 8  # columns of `Surface.faces`

FEW = 16  # vertices of a ring that are compared faster than marked

ZERO, ONE = np.int64(0), np.int64(1)  # for kernels, which are compiled once more for each plain number in a call


class Surface(NamedTuple):
    """The current mesh.  Faces and vertices that are gone stay in the arrays: faces[f, 0] < 0."""

    positions: ndarray  # (nV, 3) float64, in the normalised frame
    # (nF, WIDTH) int32, together, for memory is read by the line: a face's corners; its current version (`mapping.py`);
    # from TWIN on the half-edges the other way, -1 on the boundary; and bits of its three half-edges, whether they are
    # along a seam of the texture, as both of an edge are
    faces: ndarray
    starts: ndarray  # (nV,) int32: a half-edge that leaves the vertex; on the boundary the one without twin
    holds: ndarray  # (nV,) uint8: FREE; ON_SEAM, it moves along the seam only; FIXED, it never moves; and BORDER
    marks: ndarray  # (nV,) int32: scratch of `has_repetition`


class Ring(NamedTuple):
    """Scratch for one edge's ring of m vertices."""

    vertices: ndarray  # (capacity,) int32: r[0 .. m - 1]
    halfedges: ndarray  # (capacity,) int32: of ring edge t's face, the half-edge from the apex to r[t]; -1 at the gap
    points: ndarray  # (capacity + 3, 3): positions of r, j, k and the merged vertex
    uv: ndarray  # (capacity + 3, 2): their places in the plane
    weights: ndarray  # (capacity,): cotangent weights


def make_ring(capacity: int) -> Ring:
    return Ring(np.zeros(capacity, np.int32), np.zeros(capacity, np.int32), np.zeros((capacity + 3, 3)),
                np.zeros((capacity + 3, 2)), np.zeros(capacity))


def box_of(points: ndarray) -> tuple[ndarray, ndarray]:
    """The least and the greatest of each column, which one by one take a tenth of the time of both at once."""
    return np.array([column.min() for column in points.T]), np.array([column.max() for column in points.T])


def frame_of(vertices: ndarray) -> tuple[ndarray, float]:
    """Centre and scale of the normalised frame, (vertices - centre) / scale.

    The longest side of the box becomes 1/2 to 1, by a power of two: then nothing in a kernel is absolute, and a mesh
    that is twice as large gives the same result to the last bit.
    """
    low, high = box_of(vertices)
    return (low + high) / 2, float(np.exp2(np.ceil(np.log2((high - low).max() or 1.0))))


@njit(**INNER)
def copy_row(target, row, source, source_row):
    for column in range(target.shape[1]):
        target[row, column] = source[source_row, column]


@njit(**INNER)
def after(h):
    """The next half-edge around the face."""
    return h - 2 if h % 3 == 2 else h + 1


@njit(**INNER)
def before(h):
    return h + 2 if h % 3 == 0 else h - 1


@njit(**INNER)
def tail(surface, h):
    return np.int64(surface.faces[h // 3, h % 3])


@njit(**INNER)
def twin_of(surface, h):
    return np.int64(surface.faces[h // 3, TWIN + h % 3])


@njit(**INNER)
def head(surface, h):
    return tail(surface, after(h))


@njit(**INNER)
def edge_of(surface, h):
    """The half-edge that stands for the edge: the lower one of the two."""
    twin = twin_of(surface, h)
    return twin if 0 <= twin < h else h


@njit(**INNER)
def is_seam(surface, h):
    return (surface.faces[h // 3, SEAMS] >> h % 3) & 1 > 0


@njit(**INNER)
def set_seam(surface, h):
    if h >= 0:
        surface.faces[h // 3, SEAMS] |= 1 << h % 3


@njit(**INNER)
def gather_ring(surface, h, ring):
    """Fill the ring of h with vertices and half-edges; (m, split, gap), m = 0 where the capacity does not suffice."""
    capacity = len(ring.vertices)
    twin = twin_of(surface, h)
    f0, f1 = h // 3, twin // 3 if twin >= 0 else -1
    ring.vertices[0] = tail(surface, before(h))
    m, gap = 1, -1
    g = twin_of(surface, before(h))
    while m < capacity:  # counter-clockwise around j, from c to d
        if g < 0:
            gap = m - 1
            ring.halfedges[gap] = -1
            g = np.int64(surface.starts[tail(surface, h)])
            if g == h:  # j -> k is itself the boundary
                break
            ring.vertices[m] = head(surface, g)
            m += 1
            continue
        if g // 3 == f1:
            break
        ring.halfedges[m - 1] = g
        ring.vertices[m] = tail(surface, before(g))
        m += 1
        g = twin_of(surface, before(g))
    split = m - 1
    if twin >= 0:
        g = twin_of(surface, before(twin))
    else:
        g = np.int64(surface.starts[head(surface, h)])
        if m < capacity:
            ring.vertices[m] = head(surface, g)
        m += 1
    while m < capacity:  # around k, from d to c
        if g < 0:
            gap = m - 1
            ring.halfedges[gap] = -1
            g = np.int64(surface.starts[head(surface, h)])
            ring.vertices[m] = head(surface, g)
            m += 1
            continue
        if g // 3 == f0:
            return m - 1, split, gap  # c has come twice
        ring.halfedges[m - 1] = g
        ring.vertices[m] = tail(surface, before(g))
        m += 1
        g = twin_of(surface, before(g))
    return 0, 0, -1


@njit(**INNER)
def has_repetition(surface, ring, m):
    """Whether a vertex is in the ring twice: then the link condition Lk(j) & Lk(k) = Lk(jk) fails."""
    if m <= FEW:
        for t in range(m):
            for s in range(t):
                if ring.vertices[s] == ring.vertices[t]:
                    return True
        return False
    for t in range(m):
        surface.marks[ring.vertices[t]] = -1
    for t in range(m):
        v = ring.vertices[t]
        if surface.marks[v] >= 0:
            return True
        surface.marks[v] = t
    return False


@njit(**INNER)
def join(surface, a, b):
    """Make two half-edges twins; one of them may be absent."""
    if a >= 0:
        surface.faces[a // 3, TWIN + a % 3] = b
    if b >= 0:
        surface.faces[b // 3, TWIN + b % 3] = a


@njit(**INNER)
def remove_face(surface, h):
    """Take the face of h = j -> k out and close the slit: its other two edges become one."""
    into, out = twin_of(surface, after(h)), twin_of(surface, before(h))  # c -> k and j -> c, beyond the face
    join(surface, into, out)
    if is_seam(surface, after(h)) or is_seam(surface, before(h)):
        set_seam(surface, into)
        set_seam(surface, out)
    c = tail(surface, before(h))
    if surface.starts[c] == before(h):
        surface.starts[c] = into
    surface.faces[h // 3, 0] = -1


@njit(**INNER)
def collapse_edge(surface, h, ring, m, split, gap):
    """Merge k into j: connectivity only.  The ring must be that of h and the collapse legal."""
    j, twin = tail(surface, h), twin_of(surface, h)
    for t in range(split, m):
        g = ring.halfedges[t]
        if t != gap:
            surface.faces[g // 3, g % 3] = j
    remove_face(surface, h)
    if twin >= 0:
        remove_face(surface, twin)
    surface.starts[j] = ring.halfedges[(gap + 1) % m]
