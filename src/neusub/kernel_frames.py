"""Half-flaps and their frames, compiled: what is seen in them, what is said out of them, and the gradients of both.

Kernels on arrays that they trust, for `kernels.py` and `compiled.py`; `frames.py` and `bounds.py` say what the numbers
mean, and the letters are theirs.  Vectors are tuples of three; rows of arrays hold them one after the other.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from neusub import compilation

__all__ = ["MEASURES", "TURNING", "look", "look_back", "measure", "speak", "speak_back", "sum_stars"]

COMPILED = {**compilation.COMPILED, **compilation.CONTRACTED}
INNER = {**compilation.INNER, **compilation.CONTRACTED}

ONE, TWO, THREE = np.uint64(1), np.uint64(2), np.uint64(3)  # unsigned indices need no look whether they count back
MEASURES, TURNING = 4, 7  # numbers of each group that `measure` takes, and more of them for how the surface turns


# --- vectors -----------------------------------------------------------------------------------------------------


@njit(**INNER)
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(**INNER)
def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(**INNER)
def plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@njit(**INNER)
def minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(**INNER)
def times(s, a):
    return s * a[0], s * a[1], s * a[2]


@njit(**INNER)
def dots(a, x, y, z):
    return dot(a, x), dot(a, y), dot(a, z)


@njit(**INNER)
def combined(a, x, y, z):
    """The sum of x, y, z by the numbers of a."""
    return (a[0] * x[0] + a[1] * y[0] + a[2] * z[0], a[0] * x[1] + a[1] * y[1] + a[2] * z[1],
            a[0] * x[2] + a[1] * y[2] + a[2] * z[2])


@njit(**INNER)
def get(values, i, column):
    return values[i, column], values[i, column + 1], values[i, column + 2]


@njit(**INNER)
def put(values, i, column, a):
    values[i, column], values[i, column + 1], values[i, column + 2] = a


# --- geometry ----------------------------------------------------------------------------------------------------


@njit(**INNER)
def edges_of(shape, h):
    """v1 - v0, v2 - v0, v3 - v0; a missing vertex is the other one's reflection through the edge's midpoint."""
    positions, corners, missing = shape.positions, shape.corners, shape.missing
    origin = get(positions, corners[h, 0], 0)
    e1 = minus(get(positions, corners[h, 1], 0), origin)
    e2 = minus(get(positions, corners[h, 2], 0), origin)
    e3 = minus(get(positions, corners[h, 3], 0), origin)
    if missing.shape[1] > 0:
        if missing[0, h]:
            e2 = minus(e1, e3)
        elif missing[1, h]:
            e3 = minus(e1, e2)
    return e1, e2, e3


@njit(**INNER)
def mean_length(e1, e2, e3, constants):
    """Of a half-flap's five edges; 1 where all its vertices coincide."""
    a, b = minus(e2, e1), minus(e3, e1)
    total = np.sqrt(dot(e1, e1)) + np.sqrt(dot(e2, e2)) + np.sqrt(dot(e3, e3)) + np.sqrt(dot(a, a)) + np.sqrt(dot(b, b))
    return constants.fifth * total if total > 0 else constants.one


@njit(**INNER)
def inverse_length(a, limit, constants):
    """One over the length; 0 for a vector whose squared length is not above the limit."""
    squared = dot(a, a)
    return constants.one / np.sqrt(squared) if squared > limit else constants.one - constants.one


@njit(**INNER)
def frame_of(e1, e2, e3, constants):
    """The axes x and z, the two unit normals, and one over the lengths of what all four are the directions of."""
    rounding, tiny = constants.rounding, constants.tiny
    squared = dot(e1, e1)
    left, right = cross(e1, e2), cross(e3, e1)
    to_x = inverse_length(e1, tiny, constants)
    to_left = inverse_length(left, rounding * squared * dot(e2, e2) + tiny, constants)
    to_right = inverse_length(right, rounding * squared * dot(e3, e3) + tiny, constants)
    left, right = times(to_left, left), times(to_right, right)
    both = plus(left, right)
    to_z = inverse_length(both, rounding + tiny, constants)
    z = times(to_z, both) if to_z > 0 else (left if to_left > 0 else right)
    return times(to_x, e1), z, left, right, to_x, to_left, to_right, to_z


@njit(**INNER)
def look(shape, start, rows, constants, seen, axes, sizes, defined):
    """The frames of half-flaps start .. start + rows - 1, their edges (in units of their size) and their corners'
    vectors there, and their sizes.

    Axes of zeros for one that has no frame, and then it is not `defined`.
    """
    k, one = shape.vectors.shape[1], constants.one
    vectors, flat = shape.vectors.reshape(-1), seen.reshape(-1)
    for r in range(rows):
        e1, e2, e3 = edges_of(shape, start + r)
        x, z, _, _, to_x, to_left, to_right, _ = frame_of(e1, e2, e3, constants)
        defined[r] = to_x > 0 and (to_left > 0 or to_right > 0)
        if not defined[r]:
            x = z = minus(x, x)
        y = cross(z, x)
        unit = one
        if constants.is_relative:
            sizes[r] = mean_length(e1, e2, e3, constants)
            unit = one / sizes[r]
        put(axes, r, 0, x)
        put(axes, r, 3, y)
        put(axes, r, 6, z)
        put(seen, r, 0, times(unit, dots(e1, x, y, z)))
        put(seen, r, 3, times(unit, dots(e2, x, y, z)))
        put(seen, r, 6, times(unit, dots(e3, x, y, z)))
        to = np.uint64(r * seen.shape[1] + 9)
        for corner in range(4):
            at = np.uint64(shape.corners[start + r, corner] * k)
            for _ in range(k // 3):
                w = vectors[at], vectors[at + ONE], vectors[at + TWO]
                flat[to], flat[to + ONE], flat[to + TWO] = dots(w, x, y, z)
                at, to = at + THREE, to + THREE


@njit(**INNER)
def through_unit(gradient, direction, to_unit):
    """The gradient of a vector from that of its direction."""
    return times(to_unit, minus(gradient, times(dot(direction, gradient), direction)))


@njit(**INNER)
def look_back(shape, start, rows, constants, axes, sizes, defined, of_seen, of_axes, of_corners):
    """From the gradients of what `look` gives, those of the corners' positions and vectors, a row a half-flap."""
    k = shape.vectors.shape[1]
    width = 3 + k
    vectors, seen, read = shape.vectors.reshape(-1), of_seen.reshape(-1), of_corners.reshape(-1)
    for r in range(rows):
        h = start + r
        if not defined[r]:
            for j in range(4 * width):
                of_corners[h, j] = constants.one - constants.one
            continue
        e1, e2, e3 = edges_of(shape, h)
        x, z, left, right, to_x, to_left, to_right, to_z = frame_of(e1, e2, e3, constants)
        y = get(axes, r, 3)
        unit = constants.one / sizes[r] if constants.is_relative else constants.one
        s1, s2 = times(unit, get(of_seen, r, 0)), times(unit, get(of_seen, r, 3))
        s3 = times(unit, get(of_seen, r, 6))
        gx = plus(plus(get(of_axes, r, 0), times(s1[0], e1)), plus(times(s2[0], e2), times(s3[0], e3)))
        gy = plus(plus(get(of_axes, r, 3), times(s1[1], e1)), plus(times(s2[1], e2), times(s3[1], e3)))
        gz = plus(plus(get(of_axes, r, 6), times(s1[2], e1)), plus(times(s2[2], e2), times(s3[2], e3)))
        of, to = np.uint64(r * of_seen.shape[1] + 9), np.uint64(h * 4 * width)
        for corner in range(4):
            at, to = np.uint64(shape.corners[h, corner] * k), to + THREE
            for _ in range(k // 3):
                w = vectors[at], vectors[at + ONE], vectors[at + TWO]
                s = seen[of], seen[of + ONE], seen[of + TWO]
                gx, gy, gz = plus(gx, times(s[0], w)), plus(gy, times(s[1], w)), plus(gz, times(s[2], w))
                read[to], read[to + ONE], read[to + TWO] = combined(s, x, y, z)
                at, of, to = at + THREE, of + THREE, to + THREE
        gx, gz = plus(gx, cross(gy, z)), plus(gz, cross(x, gy))  # y = z cross x
        g1 = plus(combined(s1, x, y, z), through_unit(gx, x, to_x))
        g2, g3 = combined(s2, x, y, z), combined(s3, x, y, z)
        if to_z > 0:
            gz = through_unit(gz, z, to_z)
        if to_left > 0:
            g = through_unit(gz, left, to_left)  # left = e1 cross e2
            g1, g2 = plus(g1, cross(e2, g)), plus(g2, cross(g, e1))
        if to_right > 0 and (to_z > 0 or to_left == 0):
            g = through_unit(gz, right, to_right)  # right = e3 cross e1
            g1, g3 = plus(g1, cross(g, e3)), plus(g3, cross(e1, g))
        if shape.missing.shape[1] > 0:
            if shape.missing[0, h]:  # e2 = e1 - e3
                g1, g3, g2 = plus(g1, g2), minus(g3, g2), minus(g2, g2)
            elif shape.missing[1, h]:  # e3 = e1 - e2
                g1, g2, g3 = plus(g1, g3), minus(g2, g3), minus(g3, g3)
        put(of_corners, h, 0, times(-constants.one, plus(g1, plus(g2, g3))))
        put(of_corners, h, width, g1)
        put(of_corners, h, 2 * width, g2)
        put(of_corners, h, 3 * width, g3)


# --- groups of half-flaps -----------------------------------------------------------------------------------------


@njit(**INNER)
def speak(offsets, i, end, constants, block, means, hidden, counts):
    """Of the groups i .. end - 1, the means of a block's vectors, out of their frames, and of its hidden layer; over
    the half-flaps that have a frame, and how many these are, at least 1."""
    axes, local, values = block.axes, block.local, block.after_2
    start = offsets[i]
    for g in range(i, end):
        for j in range(means.shape[1]):
            means[g, j] = 0
        for j in range(hidden.shape[1]):
            hidden[g, j] = 0
        counts[g, 0] = 0
        for r in range(offsets[g] - start, offsets[g + 1] - start):
            if block.defined[r]:
                counts[g, 0] += 1
            x, y, z = get(axes, r, 0), get(axes, r, 3), get(axes, r, 6)
            for j in range(0, means.shape[1], 3):
                a = combined(get(local, r, j), x, y, z)
                if j == 0 and constants.is_relative:
                    a = times(block.sizes[r], a)
                put(means, g, j, plus(get(means, g, j), a))
            for j in range(hidden.shape[1]):
                hidden[g, j] += values[r, j]
        count = counts[g, 0] = max(counts[g, 0], constants.one)
        for j in range(means.shape[1]):
            means[g, j] /= count
        for j in range(hidden.shape[1]):
            hidden[g, j] /= count


@njit(**INNER)
def speak_back(offsets, i, end, constants, block, of_sums, of_local, of_axes):
    """From the gradients of the groups' sums, those of a block's vectors in their frames, and of the axes."""
    axes, local = block.axes, block.local
    start = offsets[i]
    for g in range(i, end):
        for r in range(offsets[g] - start, offsets[g + 1] - start):
            x, y, z = get(axes, r, 0), get(axes, r, 3), get(axes, r, 6)
            gx = gy = gz = minus(x, x)
            for j in range(0, of_local.shape[1], 3):
                of_sum, a = get(of_sums, g, j), get(local, r, j)
                if j == 0 and constants.is_relative:
                    of_sum = times(block.sizes[r], of_sum)
                put(of_local, r, j, dots(of_sum, x, y, z))
                gx, gy, gz = plus(gx, times(a[0], of_sum)), plus(gy, times(a[1], of_sum)), plus(gz, times(a[2], of_sum))
            put(of_axes, r, 0, gx)
            put(of_axes, r, 3, gy)
            put(of_axes, r, 6, gz)


@njit(**INNER)
def turn(side_2, side_3, up_2, up_3, tiny):
    """The square of s in `frames.turn_sums`, from v2 and v3 along the axes y and z."""
    up_2, up_3 = up_2 * up_2, up_3 * up_3
    return min(up_2 / max(side_2 * side_2 + up_2, tiny), up_3 / max(side_3 * side_3 + up_3, tiny))


@njit(**INNER)
def measure(shape, i, end, constants, axes, sizes, measures):
    """Of each group its largest height, smallest squares of an edge and of an altitude, mean size, and, if there are
    rows for them, `frames.turn_sums`: a row of `measures` each."""
    offsets, tiny, turning = shape.offsets, constants.tiny, len(measures) > MEASURES
    start = offsets[i]
    for g in range(i, end):
        highest = total = a1 = a2 = a3 = a4 = constants.one - constants.one
        shortest = altitude = constants.one / highest
        ahead = highest, highest, highest
        for h in range(offsets[g], offsets[g + 1]):
            e1, e2, e3 = edges_of(shape, h)
            r = h - start
            x, y, z = get(axes, r, 0), get(axes, r, 3), get(axes, r, 6)
            a, b = minus(e2, e1), minus(e3, e1)
            c1, c2, c3, c4, c5 = dot(e1, e1), dot(e2, e2), dot(e3, e3), dot(a, a), dot(b, b)
            shortest = min(shortest, min(c1, min(min(c2, c3), min(c4, c5))))
            total += sizes[r] if constants.is_relative else mean_length(e1, e2, e3, constants)
            left, right = cross(e1, e2), cross(e3, e1)
            altitude = min(altitude, min(dot(left, left) / max(max(c1, max(c2, c4)), tiny),
                                         dot(right, right) / max(max(c1, max(c3, c5)), tiny)))
            up_2, up_3 = dot(e2, z), dot(e3, z)
            highest = max(highest, max(abs(up_2), abs(up_3)))
            if not turning:
                continue
            squared = turn(dot(e2, y), dot(e3, y), up_2, up_3, tiny)
            s = np.sqrt(squared)
            a1, a2, a3, a4 = a1 + s, a2 + squared, a3 + squared * s, a4 + squared * squared
            ahead = plus(ahead, times(s, x))
        measures[0, g], measures[1, g], measures[2, g] = highest, shortest, altitude
        measures[3, g] = total / (offsets[g + 1] - offsets[g])
        if turning:
            measures[4, g], measures[5, g], measures[6, g], measures[7, g] = a1, a2, a3, a4
            measures[8, g], measures[9, g], measures[10, g] = ahead


@njit(**COMPILED)
def sum_stars(shape, constants, first, last, sums):
    """`frames.star_sums` of the groups first .. last - 1; framed if there are columns for it."""
    missing, tiny, framed = shape.missing, constants.tiny, sums.shape[1] > 4
    for g in range(first, last):
        size = s1 = s2 = s3 = s4 = constants.one - constants.one
        total = up = size, size, size
        for h in range(shape.offsets[g], shape.offsets[g + 1]):
            e1, e2, e3 = edges_of(shape, h)
            total, size = plus(total, e1), size + (np.sqrt(dot(e1, e1)) if constants.is_relative else constants.one)
            if missing.shape[1] > 0 and (missing[0, h] or missing[1, h]):
                e = e2 if missing[0, h] else e3
                total, size = plus(total, e), size + (np.sqrt(dot(e, e)) if constants.is_relative else constants.one)
            if not framed:
                continue
            x, z, _, _, to_x, to_left, to_right, _ = frame_of(e1, e2, e3, constants)
            if to_x > 0 and (to_left > 0 or to_right > 0):
                up = plus(up, z)
            y = cross(z, x)
            squared = turn(dot(e2, y), dot(e3, y), dot(e2, z), dot(e3, z), tiny)
            s = np.sqrt(squared)
            s1, s2, s3, s4 = s1 + s, s2 + squared, s3 + squared * s, s4 + squared * squared
        put(sums, g, 0, total)
        sums[g, 3] = size
        if framed:
            put(sums, g, 4, up)
            sums[g, 7], sums[g, 8], sums[g, 9], sums[g, 10] = s1, s2, s3, s4
