"""What is around vertices and edges, and how far it lets displacements go, compiled.

Kernels on arrays that they trust, for `bounds.py`, which says what the numbers mean and does the same with tensors.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from neusub.compilation import COMPILED, INNER
from neusub.kernel_frames import dot, get, put, times

__all__ = ["hold_edges", "hold_vertices", "restrain"]


@njit(**INNER)
def free(left, turning, numbers):
    """1 minus `crisp.surely_sharp` of the turning times `crisp.held` of what is left."""
    _, _, begins, scale, squared = numbers
    one = squared / squared
    return one - min(max((turning - begins) * scale, one - one), one) * squared / (left * left + squared)


@njit(**COMPILED)
def hold_vertices(numbers, heights, sums, offsets, missing, around):
    """`bounds.around_vertices`, a row each.  sums: `frames.turn_sums`.  numbers: the smallest normal one, what of p1 is
    rounding, where sharpness begins and one over how far it goes, the square of `sharp`."""
    tiny, rounding, _, _, squared = numbers
    one = squared / squared
    zero, two, three = one - one, one + one, one + one + one
    for v in range(len(heights)):
        p1, p2, p3, p4 = sums[0, v], sums[1, v], sums[2, v], sums[3, v]  # to ratios as in `frames.turns`
        e2 = (p1 * p1 - p2) / two
        e3 = (e2 * p1 - p1 * p2 + p3) / three
        e4 = (e3 * p1 - e2 * p2 + p1 * p3 - p4) / (two * two)
        second = max(e2 / (p1 + tiny), zero)
        third = max(e3 / (e2 + rounding * p1 * p1 + tiny), zero)
        fourth = max(e4 / (e3 + rounding * p1 * p1 * p1 + tiny), zero)
        is_border, count = False, zero
        for h in range(offsets[v], offsets[v + 1]):
            count += one
            is_border |= missing.shape[1] > 0 and (missing[0, h] or missing[1, h])
        if is_border:
            on_edge = free(second, p1, numbers)
        else:
            ahead = sums[4, v], sums[5, v], sums[6, v]
            on_edge = free(max(third, np.sqrt(dot(ahead, ahead)) / (p1 + tiny) / two), two * second, numbers)
        at_corner, mean = free(fourth, three * third, numbers), p1 / count
        around[0, v], around[1, v], around[2, v] = heights[v], on_edge, at_corner
        around[3, v], around[4, v] = one - squared / (mean * mean + squared), min(on_edge, at_corner)


@njit(**COMPILED)
def hold_edges(corners, around, results):
    """`bounds.around_edges`, a row each."""
    for e in range(results.shape[1]):
        a, b = corners[2 * e, 0], corners[2 * e, 1]
        results[0, e] = max(around[0, a], around[0, b])
        ends = max(around[2, a], min(around[2, b], around[3, b])), max(around[2, b], min(around[2, a], around[3, a]))
        results[1, e] = min(min(around[1, a], around[1, b]), min(ends[0], ends[1]))


@njit(**COMPILED)
def restrain(numbers, move, factors, heights, sizes, edges, altitudes, results):
    """`bounds.restrained`.  numbers: `flat`, the three parts of the bound, the least limit."""
    flat, of_edge, of_height, of_altitude, nothing = numbers
    one = nothing / nothing
    for i in range(len(move)):
        factor = factors[i] * heights[i] / (heights[i] + flat * sizes[i])
        limit = min(min(of_edge * np.sqrt(edges[i]), of_height * heights[i]), of_altitude * np.sqrt(altitudes[i]))
        a = times(factor, get(move, i, 0))
        ratio = dot(a, a) / max(limit, nothing) ** 2
        put(results, i, 0, times(min(limit / nothing, one) / np.sqrt(np.sqrt(one + ratio * ratio)), a))
