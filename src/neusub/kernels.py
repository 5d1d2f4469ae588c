"""What half-flaps say, compiled: forwards and backwards, a block of groups at a time.

A block stays in the cache through all of its layers, where tensors of all half-flaps would go through the memory at
every operation.  Backwards, a block goes forwards once more instead of keeping its layers.

Kernels on arrays that they trust; `compiled.py` is their door, and has the tuples that they are given.  `network.py`
says what the numbers mean; the geometry is in `kernel_frames.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic
from numpy import ndarray

from neusub import compilation
from neusub.kernel_frames import look, look_back, measure, speak, speak_back

__all__ = ["backwards", "forwards", "sum_corners"]

COMPILED = {**compilation.COMPILED, **compilation.CONTRACTED}
ALLOCATES = {**compilation.ALLOCATES, **compilation.CONTRACTED}
INNER = {**compilation.INNER, **compilation.CONTRACTED}
INNER_ALLOCATES = {**INNER, "_nrt": True}


# --- layers ------------------------------------------------------------------------------------------------------


@intrinsic
def two_to(_, value):
    """2^n for a float whose last bits hold the integer n (see `Constants.magic`): they become its exponent."""
    integer, mantissa, one = (ir.IntType(64), 52, 0x3FF << 52) if value == types.float64 else \
        (ir.IntType(32), 23, 0x7F << 23)

    def bits(context, builder, signature, arguments):
        exponent = builder.shl(builder.bitcast(arguments[0], integer), integer(mantissa))
        return builder.bitcast(builder.add(exponent, integer(one)), context.get_value_type(signature.return_type))

    return value(value), bits


@njit(**INNER)
def activate(values, constants, gates, results):
    """relu or silu of flat arrays, and what of each value passes: 0 or 1, or its sigmoid 1 / (1 + 2^-(x log2 e)), of
    which the power's integer part is an exponent, the rest a series."""
    one, zero, magic, largest = constants.one, constants.one - constants.one, constants.magic, constants.largest
    if not constants.is_silu:
        for i in range(len(values)):
            gates[i] = one if values[i] > 0 else zero
            results[i] = values[i] * gates[i]
        return
    for i in range(len(values)):
        power = min(max(-values[i] * constants.log2_e, -largest), largest)
        shifted = power + magic
        rest = power - (shifted - magic)
        series = constants.powers[0]
        for c in constants.powers[1:]:
            series = series * rest + c
        gates[i] = one / (one + series * two_to(shifted))  # type: ignore[call-arg]
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
    """To the first layer, its bias and what comes from the features of the corners, if there are any."""
    corners, table = shape.corners, shape.table
    if len(table) == 0:
        add_row(bias, rows, results)
        return
    for r in range(rows):
        h = start + r
        a, b, c, d = 4 * corners[h, 0], 4 * corners[h, 1] + 1, 4 * corners[h, 2] + 2, 4 * corners[h, 3] + 3
        for j in range(results.shape[1]):
            results[r, j] += bias[j] + table[a, j] + table[b, j] + table[c, j] + table[d, j]


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


@njit(**INNER_ALLOCATES)
def new_block(capacity, layers):
    first, last = layers.first, layers.last
    width, dtype = first.shape[0], first.dtype
    return Block(np.empty((capacity, 9), dtype), np.empty(capacity, dtype), np.empty(capacity, np.bool_),
                 np.empty((capacity, first.shape[1]), dtype), np.empty((capacity, width), dtype),
                 np.empty((capacity, width), dtype), np.empty((capacity, width), dtype),
                 np.empty((capacity, width), dtype), np.empty((capacity, width), dtype),
                 np.empty((capacity, width), dtype), np.empty((capacity, last.shape[0]), dtype))


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
def forwards(shape, layers, transposed, constants, capacity, first, last, means, hidden, counts, measures):
    """Of the groups first .. last - 1: the means of what their half-flaps say, vectors in the axes of the positions and
    the hidden layer; the number of half-flaps with a frame; and, unless it is empty, what `measure` takes."""
    block = new_block(capacity, layers)
    i = first
    while i < last:
        end = groups_from(shape.offsets, i, last, capacity)
        start = shape.offsets[i]
        through_layers(shape, layers, transposed, constants, start, shape.offsets[end] - start, block)
        speak(shape.offsets, i, end, constants, block, means, hidden, counts)
        if len(measures) > 0:
            measure(shape, i, end, constants, block.axes, block.sizes, measures)
        i = end


@njit(**INNER)
def add_of_groups(offsets, i, end, of_groups, results):
    start = offsets[i]
    for g in range(i, end):
        for r in range(offsets[g] - start, offsets[g + 1] - start):
            for j in range(of_groups.shape[1]):
                results[r, j] += of_groups[g, j]


@njit(**ALLOCATES)
def backwards(shape, layers, transposed, constants, capacity, reads, first, last, of_sums, of_hidden, of_corners,
              of_before, of_layers):
    """The gradients of `forwards`, from those of the sums that its means are made of: of what each half-flap reads of
    its corners (if `reads`), of its first layer before the activation, and, added up, of the layers."""
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
    """Over the rows, the products of a's columns with b's, and the sums of a's: of a block by itself first, which keeps
    the rounding of long sums down."""
    product, total = np.empty_like(products), np.zeros_like(sums)
    np.dot(a[:rows].T, b[:rows], product)
    add(product, len(product), products)
    for r in range(rows):
        for j in range(len(total)):
            total[j] += a[r, j]
    for j in range(len(total)):
        sums[j] += total[j]


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
