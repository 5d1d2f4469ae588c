"""Which collapses are legal (paper, appendix "Criteria for Collapsible Edges"); each test has a named reason."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np
from numba import njit

from neusub.compilation import INNER
from neusub.errors import DecimationError
from neusub.selfparam.surface import ZERO

__all__ = ["REASONS", "Criteria", "refusals"]

# Codes of the kernels are indices into this tuple; 0 is a legal collapse.
REASONS = (
    "legal",
    "boundary",  # an inner edge between two vertices that must stay: on the boundary, on a seam, fixed
    "link condition",
    "valence",  # more ring vertices than the scratch arrays hold
    "normal flip",
    "plane flip before",  # a face of the flattened ring turns over, or the ring goes around a vertex more than once
    "plane flip after",
    "quality in space",
    "quality in the plane",
)
LEGAL, BOUNDARY, LINK, VALENCE, NORMAL, PLANE_BEFORE, PLANE_AFTER, QUALITY_SPACE, QUALITY_PLANE = range(len(REASONS))
EQUILATERAL = 4 / 3**0.5  # squared edge over area
SLIVER = 1e-8  # least area in the plane, over the squared edges: of less, points come back with few digits
SAME = 1e-12  # a quality that changes by less is that of a face that stays as it was


@dataclass(frozen=True)
class Criteria:
    """The tests' parameters, with the paper's defaults; None turns a test off.

    min_normal_dot: a face's unit normals before and after must have a larger dot product (delta = 0.2), or larger than
    that of the sharpest fold of the ring before: what is folded already, like the inside of an eyelid, must be able to
    vanish (not in the paper).
    min_quality: Q = 4 sqrt(3) A / (sum of the squared edges) of each face that changes must exceed this, or the worst
    of the ring before, whichever is less; in space and in the plane.
    tiny: a ring that reaches no further than this times the mean edge of the mesh as it is then is exempt from the
    tests of normals and quality, and comes to lie in a circle where the conformal map would turn faces over (not in
    the paper).  Its faces are about to vanish: eyeballs behind lids that nearly close, for one, would stay whole.
    """

    min_normal_dot: float | None = 0.2
    min_quality: float | None = 0.2
    plane_flips: bool = True  # test that no face turns over in the plane, and that the ring goes around once
    tiny: float | None = 0.6

    def __post_init__(self) -> None:
        for name in ("min_normal_dot", "min_quality"):
            value = getattr(self, name)
            if value is not None and not -1 <= value < 1:
                raise DecimationError(f"{name} = {value}: take a number in [-1, 1), or None for no test.")
        if self.tiny is not None and not 0 <= self.tiny <= 1:
            raise DecimationError(f"tiny = {self.tiny}: take a number in [0, 1], or None.")

    def packed(self) -> np.ndarray:
        """For the kernels: a test that is off is one that always passes."""
        off = (-2.0, -1.0)
        normal, quality, plane, tiny = astuple(self)
        return np.array([off[0] if normal is None else normal, off[1] if quality is None else quality, float(plane),
                         (tiny or 0.0) ** 2])


def refusals(counts: dict[str, int]) -> str:
    """The reasons that came up, in words, for a message."""
    return ", ".join(f"{reason} {count}" for reason, count in counts.items() if count and reason != "legal") or "none"


@njit(**INNER)
def quality(squared_edges, twice_area):
    return 2 * np.sqrt(3.0) * twice_area / squared_edges if squared_edges > 0 else 0.0


@njit(**INNER)
def normal_of(points, a, b, c):
    """Cross product of two edges, and the sum of the squared three."""
    x1, y1, z1 = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    x2, y2, z2 = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    x3, y3, z3 = x2 - x1, y2 - y1, z2 - z1
    squared = x1 * x1 + y1 * y1 + z1 * z1 + x2 * x2 + y2 * y2 + z2 * z2 + x3 * x3 + y3 * y3 + z3 * z3
    return y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2, squared


@njit(**INNER)
def sharpest_fold(ring, m, split, gap, has_f1):
    """Least dot product of the unit normals of two neighbouring faces of the ring."""
    points, least = ring.points, 1.0
    x0, y0, z0, _ = normal_of(points, m, m + 1, ZERO)
    x1, y1, z1 = x0, y0, z0
    if has_f1:
        x1, y1, z1, _ = normal_of(points, m + 1, m, split)
        least = dot_of_units(x0, y0, z0, x1, y1, z1)
    px, py, pz = x0, y0, z0  # f0 comes before ring edge 0 and after the last one; f1 at the split
    for t in range(m):
        if t == split and has_f1:
            least = min(least, dot_of_units(px, py, pz, x1, y1, z1))
            px, py, pz = x1, y1, z1
        x = y = z = 0.0
        if t != gap:
            x, y, z, _ = normal_of(points, m if t < split else m + 1, t, (t + 1) % m)
            least = min(least, dot_of_units(px, py, pz, x, y, z))
        px, py, pz = x, y, z
    return min(least, dot_of_units(px, py, pz, x0, y0, z0))


@njit(**INNER)
def dot_of_units(ax, ay, az, bx, by, bz):
    """1 where a vector is null, as at a gap: no fold."""
    squared = (ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz)
    return (ax * bx + ay * by + az * bz) / np.sqrt(squared) if squared > 0.0 else 1.0


@njit(**INNER)
def check_space(ring, m, split, gap, has_f1, criteria):
    """Normals and quality in space; the merged position is points[m + 2]."""
    points = ring.points
    worst_before, worst_after, turn = 2.0, 2.0, 1.0
    for t in range(m):
        if t == gap:
            continue
        s = (t + 1) % m
        x, y, z, squared = normal_of(points, m if t < split else m + 1, t, s)
        nx, ny, nz, new_squared = normal_of(points, m + 2, t, s)
        before = quality(squared, np.sqrt(x * x + y * y + z * z))
        worst_before = min(worst_before, before)
        after = quality(new_squared, np.sqrt(nx * nx + ny * ny + nz * nz))
        if abs(after - before) > SAME:
            worst_after = min(worst_after, after)
        if before > 1e-12:  # a face without area has no normal that could flip
            turn = min(turn, dot_of_units(x, y, z, nx, ny, nz))
    if turn <= criteria[0] and turn <= sharpest_fold(ring, m, split, gap, has_f1):
        return NORMAL
    x, y, z, squared = normal_of(points, m, m + 1, ZERO)
    worst_before = min(worst_before, quality(squared, np.sqrt(x * x + y * y + z * z)))
    if has_f1:
        x, y, z, squared = normal_of(points, m + 1, m, split)
        worst_before = min(worst_before, quality(squared, np.sqrt(x * x + y * y + z * z)))
    return QUALITY_SPACE if worst_after <= min(criteria[1], worst_before) else LEGAL


@njit(**INNER)
def is_tiny(ring, m, mean_area, criteria):
    """Whether no vertex of the ring is far from the merged one, for faces of this mean area."""
    points, farthest = ring.points, 0.0
    for t in range(m):
        squared = 0.0
        for axis in range(3):
            squared += (points[t, axis] - points[m + 2, axis]) ** 2
        farthest = max(farthest, squared)
    return farthest < criteria[3] * EQUILATERAL * mean_area


@njit(**INNER)
def plane_face(uv, a, b, c):
    """Twice the signed area, and the sum of the squared edges."""
    x1, y1 = uv[b, 0] - uv[a, 0], uv[b, 1] - uv[a, 1]
    x2, y2 = uv[c, 0] - uv[a, 0], uv[c, 1] - uv[a, 1]
    x3, y3 = x2 - x1, y2 - y1
    return x1 * y2 - y1 * x2, x1 * x1 + y1 * y1 + x2 * x2 + y2 * y2 + x3 * x3 + y3 * y3


@njit(**INNER)
def has_area(points, a, b, c):
    x, y, z, squared = normal_of(points, a, b, c)
    return quality(squared, np.sqrt(x * x + y * y + z * z)) > 1e-12


@njit(**INNER)
def crosses_upward(uv, v, p, q):
    """Whether the edge p -> q crosses the horizontal line through v upward.

    Where all faces around v have positive area, the number of these crossings is how often they go around it: the
    sum of their angles, divided by 2 pi.
    """
    return uv[p, 1] < uv[v, 1] <= uv[q, 1]


@njit(**INNER)
def check_plane(ring, m, split, gap, has_f1, merged, tiny, criteria):
    """Areas, angle sums and, where the ring is not tiny, quality in the plane, before and after."""
    uv, points = ring.uv, ring.points
    worst_before, worst_after = 2.0, 2.0
    around_j = around_k = around_i = 0
    tests_flips = criteria[2] > 0
    for t in range(m):
        if t == gap:
            continue
        s, apex = (t + 1) % m, m if t < split else m + 1
        area, squared = plane_face(uv, apex, t, s)
        new_area, new_squared = plane_face(uv, m + 2, t, s)
        is_turned, will_be_turned = not area > SLIVER * squared, not new_area > SLIVER * new_squared
        if tests_flips and (is_turned or will_be_turned) and (not merged or has_area(points, apex, t, s)):
            return PLANE_BEFORE if is_turned else PLANE_AFTER
        before, after = quality(squared, area), quality(new_squared, new_area)
        worst_before = min(worst_before, before)
        if abs(after - before) > SAME:
            worst_after = min(worst_after, after)
        if t < split:
            around_j += crosses_upward(uv, m, t, s)
        else:
            around_k += crosses_upward(uv, m + 1, t, s)
        around_i += comes_back(uv, m + 2, (gap + 1) % m, t, s)
    if not merged:
        area, squared = plane_face(uv, m, m + 1, ZERO)
        worst_before = min(worst_before, quality(squared, area))
        if tests_flips and not area > SLIVER * squared:
            return PLANE_BEFORE
        if has_f1:
            area, squared = plane_face(uv, m + 1, m, split)
            worst_before = min(worst_before, quality(squared, area))
            if tests_flips and not area > SLIVER * squared:
                return PLANE_BEFORE
            around_j += crosses_upward(uv, m, m + 1, ZERO) + crosses_upward(uv, m, split, m + 1)
            around_k += crosses_upward(uv, m + 1, m, split) + crosses_upward(uv, m + 1, ZERO, m)
        elif tests_flips and not uv[m, 0] < uv[m + 1, 0]:  # j before k along a boundary
            return PLANE_BEFORE
        if tests_flips and not (goes_round(around_j, 0 <= gap < split or not has_f1)
                                and goes_round(around_k, gap >= split)):
            return PLANE_BEFORE
        if not tiny and worst_after <= min(criteria[1], worst_before):
            return QUALITY_PLANE
    # The fan must come back to its first ray once, on a boundary never: then its outline is simple, and the faces
    # before, which have the same one, do not lie upon each other either.
    return LEGAL if around_i == (0 if gap >= 0 else 1) or not tests_flips else PLANE_AFTER


@njit(**INNER)
def comes_back(uv, v, first, p, q):
    """Whether the edge p -> q crosses the ray from v through `first`, counter-clockwise."""
    x, y = uv[first, 0] - uv[v, 0], uv[first, 1] - uv[v, 1]
    left_of_p = x * (uv[p, 1] - uv[v, 1]) - y * (uv[p, 0] - uv[v, 0])
    left_of_q = x * (uv[q, 1] - uv[v, 1]) - y * (uv[q, 0] - uv[v, 0])
    return left_of_p < 0 <= left_of_q


@njit(**INNER)
def goes_round(times, is_boundary):
    """Whether faces go around their common vertex once; on a boundary, not more than once."""
    return times <= 1 if is_boundary else times == 1
