"""The map that a decimation leaves behind, and its two directions.

Each face that ever was has a *version*: the input's faces are versions 0 .. nF - 1.  A collapse consumes the versions
of its ring and makes new ones; it keeps one chart, the places of both rings in the plane.  A point of a coarse face
goes up through the charts that made its version until no collapse made it; a point of a fine face goes down through
the charts that consumed it.  Points are independent of each other, so no search over all collapses is needed.

Chart c of a ring of m vertices (figure in `surface.py`) holds
    uv          m + 3 rows from slots[c] + c:  ring, j, k, merged vertex
    before      m + 2 versions from slots[c]:  of ring edge t's face (-1 at the gap), f0, f1 (-1 along a boundary)
    corner      m + 2: at which corner of the stored face its apex is (j, or k beyond `split`)
The face of ring edge t has version first[c] + t afterwards, with the same corner.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy import ndarray

from neusub.selfparam.surface import COMPILED, copy_row

__all__ = ["Charts", "go_down", "go_up", "grown", "make_charts", "record"]


class Charts(NamedTuple):
    """All charts of a decimation, one after the other; `used` says how much of the arrays is filled."""

    slots: ndarray  # (charts + 1,) int64
    split: ndarray  # (charts,) int32
    first: ndarray  # (charts,) int32
    uv: ndarray  # (sum of m + 3, 2) float64
    before: ndarray  # (sum of m + 2,) int32
    corner: ndarray  # (sum of m + 2,) uint8
    made_by: ndarray  # (versions,) int32: the chart that made a version; -1 for the input's
    consumed_by: ndarray  # (versions,) int32: the chart that consumed it; -1 for the coarse mesh's
    consumed_at: ndarray  # (versions,) int32: at which of that chart's m + 2 places
    used: ndarray  # (2,) int64: charts, versions


def make_charts(n_faces: int, collapses: int, slots: int) -> Charts:
    """Room for so many charts with so many slots in all."""
    versions = n_faces + slots
    charts = Charts(
        np.zeros(collapses + 1, np.int64), np.zeros(collapses, np.int32), np.zeros(collapses, np.int32),
        np.zeros((slots + collapses, 2)), np.zeros(slots, np.int32), np.zeros(slots, np.uint8),
        np.full(versions, -1, np.int32), np.full(versions, -1, np.int32), np.zeros(versions, np.int32),
        np.array([0, n_faces]),
    )
    return charts


def grown(charts: Charts, n_faces: int, collapses: int, slots: int) -> Charts:
    """A copy with other room; what is filled stays."""
    new = make_charts(n_faces, collapses, slots)
    for old_array, array in zip(charts, new):
        n = min(len(old_array), len(array))
        array[:n] = old_array[:n]
    return new


@njit(**COMPILED)
def has_room(charts, m):
    c = charts.used[0]
    return charts.slots[c] + m + 2 <= len(charts.before) and charts.used[1] + m <= len(charts.made_by)


@njit(**COMPILED)
def record(charts, surface, ring, h, m, split, gap):
    """Keep the chart of the collapse of h, which is about to happen, and give its faces their new versions."""
    c, version = charts.used
    at = charts.slots[c]
    charts.split[c], charts.first[c], charts.slots[c + 1] = split, version, at + m + 2
    for v in range(m + 3):
        copy_row(charts.uv, at + c + v, ring.uv, v)
    twin = surface.twins[h]
    for t in range(m + 2):
        g = ring.halfedges[t] if t < m else (h if t == m else twin)
        if g < 0:
            charts.before[at + t] = -1
            continue
        old = surface.versions[g // 3]
        charts.before[at + t], charts.corner[at + t] = old, g % 3
        charts.consumed_by[old], charts.consumed_at[old] = c, t
        if t < m:
            surface.versions[g // 3] = version + t
            charts.made_by[version + t] = c
    charts.used[0], charts.used[1] = c + 1, version + m


# --- points through the charts -----------------------------------------------------------------------------------


@njit(**COMPILED)
def face_corners(t, m, split, is_after):
    """Local indices of the corners of the face at place t, its apex first."""
    if t < m:
        return (m + 2 if is_after else m if t < split else m + 1), t, (t + 1) % m
    return (m, m + 1, 0) if t == m else (m + 1, m, split)


@njit(**COMPILED)
def place_in_plane(uv, corners, corner, point):
    """Place of a point given by barycentric coordinates of the stored face."""
    a, b, c = corners
    x, y, z = point[corner], point[(corner + 1) % 3], point[(corner + 2) % 3]
    return x * uv[a, 0] + y * uv[b, 0] + z * uv[c, 0], x * uv[a, 1] + y * uv[b, 1] + z * uv[c, 1]


@njit(**COMPILED)
def areas(uv, corners, x, y):
    """Barycentric coordinates of a place, times twice the area; and twice the area."""
    a, b, c = corners
    ax, ay, bx, by, cx, cy = uv[a, 0] - x, uv[a, 1] - y, uv[b, 0] - x, uv[b, 1] - y, uv[c, 0] - x, uv[c, 1] - y
    wa, wb, wc = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
    return wa, wb, wc, wa + wb + wc


@njit(**COMPILED)
def locate(charts, c, x, y, guess, is_after, point):
    """Find the face of chart c at a place, fill the point's barycentric coordinates; the face's place t."""
    at = charts.slots[c]
    m, split = charts.slots[c + 1] - at - 2, charts.split[c]
    uv = charts.uv[at + c : at + c + m + 3]
    count = m if is_after else m + 2
    best, best_t = -np.inf, -1
    for step in range(count):
        t = guess + step
        if t >= count:
            t -= count
        if charts.before[at + t] < 0:
            continue
        corners = face_corners(t, m, split, is_after)
        wa, wb, wc, total = areas(uv, corners, x, y)
        if not total > 0.0:
            continue
        inside = min(wa, wb, wc) / total
        if inside > best:
            best, best_t = inside, t
            if inside >= 0.0:
                break
    if best_t < 0:  # a ring without area: the point stays where it is
        return guess
    wa, wb, wc, total = areas(uv, face_corners(best_t, m, split, is_after), x, y)
    wa, wb, wc = max(wa, 0.0), max(wb, 0.0), max(wc, 0.0)  # rounding puts a point just outside of all faces
    total = wa + wb + wc
    corner = charts.corner[at + best_t]
    point[corner], point[(corner + 1) % 3], point[(corner + 2) % 3] = wa / total, wb / total, wc / total
    return best_t


@njit(**COMPILED)
def go_up(charts, versions, points, first, last):
    """Take points from coarse faces to the input's, in place: versions (n,), barycentric coordinates (n, 3)."""
    for row in range(first, last):
        version, point = versions[row], points[row]
        c = charts.made_by[version]
        while c >= 0:
            at = charts.slots[c]
            m, split = charts.slots[c + 1] - at - 2, charts.split[c]
            t = version - charts.first[c]
            uv = charts.uv[at + c : at + c + m + 3]
            x, y = place_in_plane(uv, face_corners(t, m, split, True), charts.corner[at + t], point)
            version = charts.before[at + locate(charts, c, x, y, t, False, point)]
            c = charts.made_by[version]
        versions[row] = version


@njit(**COMPILED)
def go_down(charts, versions, points, first, last):
    """Take points from the input's faces to coarse ones, in place."""
    for row in range(first, last):
        version, point = versions[row], points[row]
        c = charts.consumed_by[version]
        while c >= 0:
            at = charts.slots[c]
            m, split = charts.slots[c + 1] - at - 2, charts.split[c]
            t = charts.consumed_at[version]
            uv = charts.uv[at + c : at + c + m + 3]
            x, y = place_in_plane(uv, face_corners(t, m, split, False), charts.corner[at + t], point)
            guess = t if t < m else (0 if t == m else split)
            version = charts.first[c] + locate(charts, c, x, y, guess, True, point)
            c = charts.consumed_by[version]
        versions[row] = version
