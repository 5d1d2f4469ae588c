"""What half-flaps say, compiled: forwards and backwards, a block of groups at a time.

A block stays in the cache through all of its layers, where tensors of all half-flaps would go through the memory at
every operation.  Backwards, a block goes forwards once more instead of keeping its layers.

Kernels on arrays that they trust; `compiled.py` is their door, and has the tuples that they are given.  What the
numbers mean, `frames.py`, `bounds.py` and `network.py` say; the letters are theirs.  Vectors are tuples of three; rows
of arrays hold them one after the other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy import ndarray

from neusub import compilation

__all__ = ["MEASURES", "TURNING", "backwards", "forwards", "sum_corners"]

COMPILED = {**compilation.COMPILED, "fastmath": {"contract"}}
ALLOCATES = {**compilation.ALLOCATES, "fastmath": {"contract"}}
INNER = {**compilation.INNER, "fastmath": {"contract"}}
INNER_ALLOCATES = {**INNER, "_nrt": True}

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
    for r in range(rows):
        e1, e2, e3 = edges_of(shape, start + r)
        x, z, _, _, to_x, to_left, to_right, _ = frame_of(e1, e2, e3, constants)
        defined[r] = to_x > 0 and (to_left > 0 or to_right > 0)
        if not defined[r]:
            x = z = minus(x, x)
        y = cross(z, x)
        unit = one
        if constants.to_size > 0:
            a, b = minus(e2, e1), minus(e3, e1)
            total = (np.sqrt(dot(e1, e1)) + np.sqrt(dot(e2, e2)) + np.sqrt(dot(e3, e3)) + np.sqrt(dot(a, a))
                     + np.sqrt(dot(b, b)))
            size = constants.to_size * total if total > 0 else one
            unit = one / size
            sizes[r] = size
        put(axes, r, 0, x)
        put(axes, r, 3, y)
        put(axes, r, 6, z)
        put(seen, r, 0, times(unit, dots(e1, x, y, z)))
        put(seen, r, 3, times(unit, dots(e2, x, y, z)))
        put(seen, r, 6, times(unit, dots(e3, x, y, z)))
        for corner in range(4):
            for j in range(0, k, 3):
                w = get(shape.vectors, shape.corners[start + r, corner], j)
                put(seen, r, 9 + corner * k + j, dots(w, x, y, z))


@njit(**INNER)
def through_unit(gradient, direction, to_unit):
    """The gradient of a vector from that of its direction."""
    return times(to_unit, minus(gradient, times(dot(direction, gradient), direction)))


@njit(**INNER)
def look_back(shape, start, rows, constants, axes, sizes, defined, of_seen, of_axes, of_corners):
    """From the gradients of what `look` gives, those of the corners' positions and vectors, a row a half-flap."""
    k = shape.vectors.shape[1]
    width = 3 + k
    for r in range(rows):
        h = start + r
        if not defined[r]:
            for j in range(4 * width):
                of_corners[h, j] = constants.one - constants.one
            continue
        e1, e2, e3 = edges_of(shape, h)
        x, z, left, right, to_x, to_left, to_right, to_z = frame_of(e1, e2, e3, constants)
        y = get(axes, r, 3)
        unit = constants.one / sizes[r] if constants.to_size > 0 else constants.one
        s1, s2 = times(unit, get(of_seen, r, 0)), times(unit, get(of_seen, r, 3))
        s3 = times(unit, get(of_seen, r, 6))
        gx = plus(plus(get(of_axes, r, 0), times(s1[0], e1)), plus(times(s2[0], e2), times(s3[0], e3)))
        gy = plus(plus(get(of_axes, r, 3), times(s1[1], e1)), plus(times(s2[1], e2), times(s3[1], e3)))
        gz = plus(plus(get(of_axes, r, 6), times(s1[2], e1)), plus(times(s2[2], e2), times(s3[2], e3)))
        for corner in range(4):
            for j in range(0, k, 3):
                w, s = get(shape.vectors, shape.corners[h, corner], j), get(of_seen, r, 9 + corner * k + j)
                gx, gy, gz = plus(gx, times(s[0], w)), plus(gy, times(s[1], w)), plus(gz, times(s[2], w))
                put(of_corners, h, corner * width + 3 + j, combined(s, x, y, z))
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


# --- layers ------------------------------------------------------------------------------------------------------


@njit(**INNER)
def sigmoids(values, constants, scales, results):
    """1 / (1 + 2^-(x log2 e)): the power's integer part as bits of an exponent, the rest by its series."""
    one, magic, largest = constants.one, constants.magic, constants.largest
    c0, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10, c11, c12, c13 = constants.powers
    shifted, bits = results.view(constants.ones.dtype), scales.view(constants.ones.dtype)
    for i in range(len(values)):
        results[i] = min(max(-values[i] * constants.log2_e, -largest), largest) + magic
    for i in range(len(values)):
        bits[i] = (shifted[i] << constants.mantissa) + constants.ones[0]
    for i in range(len(values)):
        x = min(max(-values[i] * constants.log2_e, -largest), largest) - (results[i] - magic)
        p = ((((((c0 * x + c1) * x + c2) * x + c3) * x + c4) * x + c5) * x + c6) * x + c7
        p = (((((p * x + c8) * x + c9) * x + c10) * x + c11) * x + c12) * x + c13
        results[i] = one / (one + p * scales[i])


@njit(**INNER)
def activate(values, constants, gates, results):
    """relu or silu of flat arrays, and what of each value passes: 0 or 1, or its sigmoid."""
    if constants.is_silu:
        sigmoids(values, constants, results, gates)
    else:
        for i in range(len(values)):
            gates[i] = constants.one if values[i] > 0 else constants.one - constants.one
    for i in range(len(values)):
        results[i] = values[i] * gates[i]


@njit(**INNER)
def activate_back(gradients, values, gates, constants):
    """In place: from the gradients of the results, those of the values."""
    if constants.is_silu:
        for i in range(len(values)):
            gradients[i] *= gates[i] * (constants.one + values[i] * (constants.one - gates[i]))
    else:
        for i in range(len(values)):
            gradients[i] *= gates[i]


@njit(**INNER)
def add(values, rows, results):
    for r in range(rows):
        for j in range(results.shape[1]):
            results[r, j] += values[r, j]


@njit(**INNER)
def add_row(row, rows, results):
    for r in range(rows):
        for j in range(results.shape[1]):
            results[r, j] += row[j]


@njit(**INNER)
def leave_out(defined, rows, values):
    """Zeros in the rows of half-flaps without a frame."""
    for r in range(rows):
        if not defined[r]:
            for j in range(values.shape[1]):
                values[r, j] = 0


@njit(**INNER)
def add_features(shape, start, rows, bias, results):
    """To the first layer, what comes from the features of the corners, or nothing but its bias."""
    corners, table = shape.corners, shape.table
    if len(table) == 0:
        add_row(bias, rows, results)
        return
    for r in range(rows):
        h = start + r
        a, b, c, d = 4 * corners[h, 0], 4 * corners[h, 1] + 1, 4 * corners[h, 2] + 2, 4 * corners[h, 3] + 3
        for j in range(results.shape[1]):
            results[r, j] += table[a, j] + table[b, j] + table[c, j] + table[d, j]


class Block(NamedTuple):
    """What the layers of a block hold, a row a half-flap."""

    axes: ndarray
    sizes: ndarray
    defined: ndarray
    seen: ndarray
    before_1: ndarray  # the two hidden layers before their activation, what of them passes, and after it
    gates_1: ndarray
    after_1: ndarray
    before_2: ndarray
    gates_2: ndarray
    after_2: ndarray
    local: ndarray  # vectors in the frames
    scratch: ndarray


@njit(**INNER_ALLOCATES)
def new_block(capacity, layers):
    first, last = layers.first, layers.last
    width, dtype = first.shape[0], first.dtype
    return Block(np.empty((capacity, 9), dtype), np.empty(capacity, dtype), np.empty(capacity, np.bool_),
                 np.empty((capacity, first.shape[1]), dtype), np.empty((capacity, width), dtype),
                 np.empty((capacity, width), dtype), np.empty((capacity, width), dtype),
                 np.empty((capacity, width), dtype), np.empty((capacity, width), dtype),
                 np.empty((capacity, width), dtype), np.empty((capacity, last.shape[0]), dtype),
                 np.empty((capacity, width), dtype))


@njit(**INNER_ALLOCATES)
def through_layers(shape, layers, transposed, constants, start, rows, block):
    """A block's half-flaps start .. start + rows - 1 from what they see to what they say."""
    size = rows * layers.first.shape[0]
    look(shape, start, rows, constants, block.seen, block.axes, block.sizes, block.defined)
    np.dot(block.seen[:rows], transposed.first, block.before_1[:rows])
    add_features(shape, start, rows, layers.first_bias, block.before_1)
    activate(block.before_1.reshape(-1)[:size], constants, block.gates_1.reshape(-1)[:size],
             block.after_1.reshape(-1)[:size])
    np.dot(block.after_1[:rows], transposed.hidden, block.before_2[:rows])
    add_row(layers.hidden_bias, rows, block.before_2)
    activate(block.before_2.reshape(-1)[:size], constants, block.gates_2.reshape(-1)[:size],
             block.after_2.reshape(-1)[:size])
    leave_out(block.defined, rows, block.after_2)
    np.dot(block.after_2[:rows], transposed.last, block.local[:rows])
    add_row(layers.last_bias, rows, block.local)


@njit(**INNER)
def groups_from(offsets, i, last, capacity):
    """The end of the run of groups from i on that have at most that many half-flaps; at least one group."""
    end = i + 1
    while end < last and offsets[end + 1] - offsets[i] <= capacity:
        end += 1
    return end


# --- a module ----------------------------------------------------------------------------------------------------


@njit(**ALLOCATES)
def forwards(shape, layers, transposed, constants, capacity, first, last, sums, hidden, counts, measures):
    """Of the groups first .. last - 1: the sums of what their half-flaps say, vectors in the axes of the positions and
    the hidden layer; the number of half-flaps with a frame; and, unless it is empty, what `measure` takes."""
    block = new_block(capacity, layers)
    i = first
    while i < last:
        end = groups_from(shape.offsets, i, last, capacity)
        start = shape.offsets[i]
        through_layers(shape, layers, transposed, constants, start, shape.offsets[end] - start, block)
        speak(shape.offsets, i, end, constants, block, sums, hidden, counts)
        if len(measures) > 0:
            measure(shape, i, end, constants, block.axes, measures)
        i = end


@njit(**INNER)
def speak(offsets, i, end, constants, block, sums, hidden, counts):
    """Of the groups i .. end - 1, the sums of a block's vectors, out of their frames, and of its hidden layer."""
    axes, local, values = block.axes, block.local, block.after_2
    start = offsets[i]
    for g in range(i, end):
        for j in range(sums.shape[1]):
            sums[g, j] = 0
        for j in range(hidden.shape[1]):
            hidden[g, j] = 0
        counts[g, 0] = 0
        for r in range(offsets[g] - start, offsets[g + 1] - start):
            if block.defined[r]:
                counts[g, 0] += 1
            x, y, z = get(axes, r, 0), get(axes, r, 3), get(axes, r, 6)
            for j in range(0, sums.shape[1], 3):
                a = combined(get(local, r, j), x, y, z)
                if j == 0 and constants.to_size > 0:
                    a = times(block.sizes[r], a)
                put(sums, g, j, plus(get(sums, g, j), a))
            for j in range(hidden.shape[1]):
                hidden[g, j] += values[r, j]
        counts[g, 0] = max(counts[g, 0], constants.one)


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
                if j == 0 and constants.to_size > 0:
                    of_sum = times(block.sizes[r], of_sum)
                put(of_local, r, j, dots(of_sum, x, y, z))
                gx, gy, gz = plus(gx, times(a[0], of_sum)), plus(gy, times(a[1], of_sum)), plus(gz, times(a[2], of_sum))
            put(of_axes, r, 0, gx)
            put(of_axes, r, 3, gy)
            put(of_axes, r, 6, gz)


@njit(**INNER)
def add_of_groups(offsets, i, end, of_groups, results):
    start = offsets[i]
    for g in range(i, end):
        for r in range(offsets[g] - start, offsets[g + 1] - start):
            for j in range(of_groups.shape[1]):
                results[r, j] += of_groups[g, j]


@njit(**INNER)
def measure(shape, i, end, constants, axes, measures):
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
            lengths = np.sqrt(c1) + np.sqrt(c2) + np.sqrt(c3) + np.sqrt(c4) + np.sqrt(c5)
            total += lengths if lengths > 0 else 5 * constants.one
            left, right = cross(e1, e2), cross(e3, e1)
            altitude = min(altitude, min(dot(left, left) / max(max(c1, max(c2, c4)), tiny),
                                         dot(right, right) / max(max(c1, max(c3, c5)), tiny)))
            up_2, up_3 = dot(e2, z), dot(e3, z)
            highest = max(highest, max(abs(up_2), abs(up_3)))
            if not turning:
                continue
            side_2, side_3 = dot(e2, y), dot(e3, y)
            up_2, up_3 = up_2 * up_2, up_3 * up_3
            squared = min(up_2 / max(side_2 * side_2 + up_2, tiny), up_3 / max(side_3 * side_3 + up_3, tiny))
            s = np.sqrt(squared)
            a1, a2, a3, a4 = a1 + s, a2 + squared, a3 + squared * s, a4 + squared * squared
            ahead = plus(ahead, times(s, x))
        measures[0, g], measures[1, g], measures[2, g] = highest, shortest, altitude
        measures[3, g] = total / (5 * (offsets[g + 1] - offsets[g]))
        if turning:
            measures[4, g], measures[5, g], measures[6, g], measures[7, g] = a1, a2, a3, a4
            measures[8, g], measures[9, g], measures[10, g] = ahead


@njit(**ALLOCATES)
def backwards(shape, layers, transposed, constants, capacity, reads, first, last, of_sums, of_hidden, of_corners,
              of_before, of_layers):
    """The gradients of `forwards`: of what each half-flap reads of its corners (if `reads`), of its first layer before
    the activation, and, added up, of the layers; the first bias for a module without a table."""
    offsets = shape.offsets
    block = new_block(capacity, layers)
    of_local, of_axes, of_seen = np.empty_like(block.local), np.empty_like(block.axes), np.empty_like(block.seen)
    of_after = np.empty_like(block.after_2)
    i = first
    while i < last:
        end = groups_from(offsets, i, last, capacity)
        start = offsets[i]
        rows = offsets[end] - start
        size = rows * layers.first.shape[0]
        through_layers(shape, layers, transposed, constants, start, rows, block)
        speak_back(offsets, i, end, constants, block, of_sums, of_local, of_axes)
        np.dot(of_local[:rows], layers.last, of_after[:rows])
        add_of_groups(offsets, i, end, of_hidden, of_after)
        leave_out(block.defined, rows, of_after)
        add_outer(of_local, block.after_2, rows, of_layers.last, of_layers.last_bias)
        activate_back(of_after.reshape(-1)[:size], block.before_2.reshape(-1)[:size], block.gates_2.reshape(-1)[:size],
                      constants)
        add_outer(of_after, block.after_1, rows, of_layers.hidden, of_layers.hidden_bias)
        of_block = of_before[start : start + rows]
        np.dot(of_after[:rows], layers.hidden, of_block)
        activate_back(of_block.reshape(-1), block.before_1.reshape(-1)[:size], block.gates_1.reshape(-1)[:size],
                      constants)
        add_outer(of_block, block.seen, rows, of_layers.first, of_layers.first_bias)
        if reads:
            np.dot(of_block, layers.first, of_seen[:rows])
            look_back(shape, start, rows, constants, block.axes, block.sizes, block.defined, of_seen, of_axes,
                      of_corners)
        i = end


@njit(**INNER_ALLOCATES)
def add_outer(a, b, rows, products, sums):
    """Over the rows, the products of a's columns with b's, and the sums of a's."""
    product = np.empty_like(products)
    np.dot(a[:rows].T, b[:rows], product)
    add(product, len(product), products)
    add_rows(a, rows, sums)


@njit(**INNER)
def add_rows(values, rows, sums):
    """A block by itself first, which keeps the rounding of long sums down."""
    for j in range(len(sums)):
        total = sums[j] - sums[j]
        for r in range(rows):
            total += values[r, j]
        sums[j] += total


@njit(**COMPILED)
def sum_corners(of_corners, order, starts, stride, first, last, sums):
    """Of each run of `stride` rows that corners read, the sum over those corners, which `order` has by row from
    starts[row] on.  of_corners: (4 n, width), or (n, width) where a half-flap's corners all have the same."""
    width, per_row = sums.shape[1], 4 if len(of_corners) < len(order) else 1
    for i in range(first, last):
        for j in range(width):
            sums[i, j] = 0
        for k in range(starts[stride * i], starts[stride * (i + 1)]):
            row = order[k] // per_row
            for j in range(width):
                sums[i, j] += of_corners[row, j]
