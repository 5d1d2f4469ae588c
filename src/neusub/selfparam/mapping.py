"""The map that a decimation leaves behind, and its two directions.

Each face that ever was has a *version*: the input's faces are versions 0 .. nF - 1.  A step (an edge collapse, a vertex
removal) consumes the versions of a region and makes new ones that cover the same region of a plane; it keeps one chart,
the places of all corners in that plane.  A point of a coarse face goes up through the charts that made its version
until none made it; a point of a fine face goes down through the charts that consumed it.  Points are independent of
each other, so no search over all charts is needed.

Chart c has three runs, from starts[c] to starts[c + 1]:
    uv       its local vertices in the plane
    before   its consumed faces: three local vertices, in the order of the stored face, and the made face to look in
             first for a point of this one; `old` has the face's version
    after    its made faces: the same, with the consumed face to look in first; version v has row v - nF
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy import ndarray

from neusub.compilation import COMPILED, INNER
from neusub.selfparam.surface import VERSION, ZERO, copy_row, twin_of

__all__ = [
    "BEFORE", "CAPACITY", "MADE", "UV", "Charts", "Step", "charts_of", "fault_of", "finished", "go_down", "go_up",
    "grown", "make_charts", "record",
]  # fmt: skip

CAPACITY = 2**16 - 3  # of a ring: local vertices are uint16, and there are three more than ring vertices
UV, BEFORE, MADE = range(3)  # columns of `starts`


class Charts(NamedTuple):
    """All charts of a decimation, one after the other; `used` says how much of the arrays is filled."""

    starts: ndarray  # (charts + 1, 3) int64: first row in uv and in before, first version made; starts[0, MADE] is nF
    uv: ndarray  # (local vertices, 2) float64
    before: ndarray  # (consumed, 4) uint16
    old: ndarray  # (consumed,) int32: versions
    after: ndarray  # (made, 4) uint16
    made_by: ndarray  # (versions,) int32: the chart that made a version; -1 for the input's
    consumed_by: ndarray  # (versions,) int32: the chart that consumed it; -1 for the coarse mesh's
    consumed_at: ndarray  # (versions,) int32: its row in `before`; `finished` fills both
    used: ndarray  # (2,) int64: charts, versions


def make_charts(n_faces: int, charts: int, slots: int) -> Charts:
    """Room for so many charts with so many consumed faces in all, as many made ones and one vertex a chart more."""
    versions = n_faces + slots
    new = Charts(
        np.zeros((charts + 1, 3), np.int64), np.zeros((slots + charts, 2)), np.zeros((slots, 4), np.uint16),
        np.zeros(slots, np.int32), np.zeros((slots, 4), np.uint16), np.full(versions, -1, np.int32),
        np.full(versions, -1, np.int32), np.zeros(versions, np.int32), np.array([0, n_faces]),
    )
    new.starts[0, MADE] = n_faces
    return new


def grown(charts: Charts, n_faces: int, n_charts: int, slots: int) -> Charts:
    """A copy with other room; what is filled stays."""
    new = make_charts(n_faces, n_charts, slots)
    for old_array, array in zip(charts, new):
        n = min(len(old_array), len(array))
        array[:n] = old_array[:n]
    return new


def finished(charts: Charts) -> Charts:
    """With what consumed each version, and without the room that is left.

    Consumers are written at the end, chart by chart: in the decimation they would be two places far away for each face.
    Views, as copying a large map would take a twentieth of its making.
    """
    note_consumers(charts)
    n_charts, n_versions = charts.used
    n_uv, n_before, _ = charts.starts[n_charts]
    n_after = n_versions - charts.starts[0, MADE]
    lengths = (n_charts + 1, n_uv, n_before, n_before, n_after, n_versions, n_versions, n_versions, 2)
    return Charts(*(array[:n] for array, n in zip(charts, lengths)))


@njit(**COMPILED)
def note_consumers(charts):
    for chart in range(charts.used[0]):
        for row in range(charts.starts[chart, BEFORE], charts.starts[chart + 1, BEFORE]):
            version = charts.old[row]
            charts.consumed_by[version], charts.consumed_at[version] = chart, row


def fault_of(charts: Charts, n_faces: int, versions: ndarray) -> str:
    """What is wrong with charts from a file, for a fine mesh of n_faces and coarse faces of these versions; "" if
    nothing: the compiled walks trust them."""
    model = make_charts(1, 1, 1)
    for name, array, like in zip(charts._fields, charts, model):
        if array.dtype != like.dtype or array.shape[1:] != like.shape[1:]:
            return f"charts.{name} is {array.dtype} {array.shape}, not {like.dtype} (n, {like.shape[1:]})"
    starts = charts.starts
    if len(starts) == 0 or starts[0].tolist() != [0, 0, n_faces] or (np.diff(starts, axis=0) < 0).any():
        return f"charts.starts does not begin at (0, 0, {n_faces}) and grow"
    n_charts, (n_uv, n_before, n_versions) = len(starts) - 1, starts[-1].tolist()
    lengths = (n_charts + 1, n_uv, n_before, n_before, n_versions - n_faces, n_versions, n_versions, n_versions, 2)
    for name, array, length in zip(charts._fields, charts, lengths):
        if len(array) != length:
            return f"charts.{name} has {len(array)} rows, not {length}"
    uv, before, made = np.diff(starts, axis=0).T
    consumer, maker = np.repeat(np.arange(n_charts), before), np.repeat(np.arange(n_charts), made)
    old = charts.old
    if (old < 0).any() or (old >= starts[consumer, MADE]).any() or len(np.unique(old)) < len(old):
        return "charts.old names versions that are not there yet, or one twice"
    consumed_by, consumed_at = np.full(n_versions, -1), np.zeros(n_versions, dtype=int)
    consumed_by[old], consumed_at[old] = consumer, np.arange(n_before)
    wanted = {"used": [n_charts, n_versions], "made_by": np.concatenate([np.full(n_faces, -1), maker]),
              "consumed_by": consumed_by, "consumed_at": consumed_at}
    for name, values in wanted.items():
        if not np.array_equal(getattr(charts, name), values):
            return f"charts.{name} does not follow from charts.starts and charts.old"
    for name, rows, chart, others in (("before", charts.before, consumer, made),
                                      ("after", charts.after, maker, before)):
        if (rows[:, :3] >= uv[chart, None]).any() or (rows[:, 3] >= np.maximum(others[chart], 1)).any():
            return f"charts.{name} names local vertices or faces that are not there"
    if not np.array_equal(np.sort(versions), np.flatnonzero(consumed_by < 0)):
        return "versions are not those that no chart consumed"
    return ""


class Step(NamedTuple):
    """One chart, for `charts_of`."""

    uv: ndarray  # (local vertices, 2)
    old: Sequence[int]  # versions consumed
    before: ndarray  # (consumed, 4), as in `Charts`
    after: ndarray  # (made, 4)


def charts_of(n_faces: int, steps: Sequence[Step]) -> Charts:
    """The charts of steps whose made faces take the versions from n_faces on, in their order."""
    lengths = np.array([(len(s.uv), len(s.before), len(s.after)) for s in steps], np.int64).reshape(-1, 3)
    charts = make_charts(n_faces, len(steps), int(lengths.sum(axis=0).max(initial=0)))
    charts.starts[1:] = charts.starts[0] + np.cumsum(lengths, axis=0)
    n_uv, n_before, n_versions = charts.starts[-1]
    charts.used[:] = len(steps), n_versions
    for filled, parts in ((charts.uv[:n_uv], [s.uv for s in steps]), (charts.old[:n_before], [s.old for s in steps]),
                          (charts.before[:n_before], [s.before for s in steps]),
                          (charts.after[: n_versions - n_faces], [s.after for s in steps])):
        filled[:] = np.concatenate([filled[:0], *parts])
    charts.made_by[n_faces:n_versions] = np.repeat(np.arange(len(steps)), lengths[:, MADE])
    return finished(charts)


# --- the chart of an edge collapse -------------------------------------------------------------------------------


@njit(**INNER)
def has_room(charts, m):
    """Whether the chart of a ring of m vertices fits."""
    uv, before, made = charts.starts[charts.used[0]]
    return uv + m + 3 <= len(charts.uv) and before + m + 2 <= len(charts.before) and made + m <= len(charts.made_by)


@njit(**INNER)
def set_corners(faces, row, corner, a, b, c, first):
    """Local vertices of a stored face that has a at `corner`, then b and c; and where to look first."""
    faces[row, corner] = a
    faces[row, 0 if corner == 2 else corner + 1] = b
    faces[row, 2 if corner == 0 else corner - 1] = c
    faces[row, 3] = first


@njit(**INNER)
def consume(charts, surface, row, h, a, b, c_local, first):
    """Write the face of half-edge h, which runs from a to b, into row `row` of `before`."""
    charts.old[row] = surface.faces[h // 3, VERSION]
    set_corners(charts.before, row, h % 3, a, b, c_local, first)


@njit(**INNER)
def record(charts, surface, ring, h, m, split, gap):
    """Keep the chart of the collapse of h, which is about to happen, and give its faces their new versions.

    Local vertices: ring 0 .. m - 1, j = m, k = m + 1, the merged vertex m + 2 (figure in `surface.py`).  Consumed are
    the faces of the ring edges, in their order, then f0 and f1; made are the faces of the ring edges again.
    """
    c, version = charts.used
    uv, row, _ = charts.starts[c]
    made = version - charts.starts[0, MADE]
    for v in range(m + 3):
        copy_row(charts.uv, uv + v, ring.uv, v)
    n = ZERO
    for t in range(m):
        if t == gap:
            continue
        g, s = np.int64(ring.halfedges[t]), t + 1 if t + 1 < m else 0
        consume(charts, surface, row + n, g, m if t < split else m + 1, t, s, n)
        set_corners(charts.after, made + n, g % 3, m + 2, t, s, n)
        charts.made_by[version + n] = c
        surface.faces[g // 3, VERSION] = version + n
        n += 1
    consume(charts, surface, row + n, h, m, m + 1, ZERO, ZERO)
    end, twin = row + n + 1, twin_of(surface, h)
    if twin >= 0:
        consume(charts, surface, end, twin, m + 1, m, split, split - 1 if 0 <= gap < split else split % n)
        end += 1
    charts.starts[c + 1, UV], charts.starts[c + 1, BEFORE], charts.starts[c + 1, MADE] = uv + m + 3, end, version + n
    charts.used[0], charts.used[1] = c + 1, version + n


# --- points through the charts -----------------------------------------------------------------------------------


@njit(**INNER)
def place_in_plane(uv, start, corners, row, point):
    """Place of a point given by barycentric coordinates of a face."""
    a, b, c = start + corners[row, 0], start + corners[row, 1], start + corners[row, 2]
    x, y, z = point
    return x * uv[a, 0] + y * uv[b, 0] + z * uv[c, 0], x * uv[a, 1] + y * uv[b, 1] + z * uv[c, 1]


@njit(**INNER)
def areas(uv, start, corners, row, x, y):
    """Barycentric coordinates of a place, times twice the area; and twice the area."""
    a, b, c = start + corners[row, 0], start + corners[row, 1], start + corners[row, 2]
    ax, ay, bx, by, cx, cy = uv[a, 0] - x, uv[a, 1] - y, uv[b, 0] - x, uv[b, 1] - y, uv[c, 0] - x, uv[c, 1] - y
    wa, wb, wc = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
    return wa, wb, wc, wa + wb + wc


@njit(**INNER)
def locate(uv, start, corners, first, end, guess, x, y, point):
    """Find the face at a place, one of the rows first .. end - 1; fill the point's barycentric coordinates; its row."""
    best, best_row = -np.inf, -1
    row = guess
    for _ in range(first, end):
        wa, wb, wc, total = areas(uv, start, corners, row, x, y)
        if total > 0.0:
            inside = min(wa, wb, wc) / total
            if inside > best:
                best, best_row = inside, row
                if inside >= 0.0:
                    break
        row += 1
        if row == end:
            row = first
    if best_row < 0:  # a region without area: the point stays where it is
        return guess
    wa, wb, wc, total = areas(uv, start, corners, best_row, x, y)
    wa, wb, wc = max(wa, 0.0), max(wb, 0.0), max(wc, 0.0)  # rounding puts a point just outside of all faces
    total = wa + wb + wc
    point[0], point[1], point[2] = wa / total, wb / total, wc / total
    return best_row


@njit(**COMPILED)
def go_up(charts, versions, points, first, last):
    """Take points from coarse faces to the input's, in place."""
    n_input = charts.starts[0, MADE]
    for at in range(first, last):
        version, point = np.int64(versions[at]), points[at]
        c = charts.made_by[version]
        while c >= 0:
            start, begin, end = charts.starts[c, UV], charts.starts[c, BEFORE], charts.starts[c + 1, BEFORE]
            row = version - n_input
            x, y = place_in_plane(charts.uv, start, charts.after, row, point)
            guess = begin + charts.after[row, 3]
            version = np.int64(charts.old[locate(charts.uv, start, charts.before, begin, end, guess, x, y, point)])
            c = charts.made_by[version]
        versions[at] = version


@njit(**COMPILED)
def go_down(charts, versions, points, first, last):
    """Take points from the input's faces to coarse ones, in place."""
    n_input = charts.starts[0, MADE]
    for at in range(first, last):
        version, point = np.int64(versions[at]), points[at]
        c = charts.consumed_by[version]
        while c >= 0:
            start = charts.starts[c, UV]
            begin, end = charts.starts[c, MADE] - n_input, charts.starts[c + 1, MADE] - n_input
            row = np.int64(charts.consumed_at[version])
            x, y = place_in_plane(charts.uv, start, charts.before, row, point)
            guess = begin + charts.before[row, 3]
            version = n_input + locate(charts.uv, start, charts.after, begin, end, guess, x, y, point)
            c = charts.consumed_by[version]
        versions[at] = version
