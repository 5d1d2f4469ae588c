"""The edges that may collapse, with their costs: a heap, or an unordered list to draw from at random.

Both hold the same arrays; edges are named by their lower half-edge.  On a large mesh the time goes into waiting for
memory: cost and edge lie side by side, and an entry has four children, which lie in one line of the cache.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy import ndarray

from neusub.compilation import COMPILED, INNER

__all__ = ["FIRST", "Queue", "cheapest", "draw", "edge_at", "make_queue", "put", "take_out"]

FIRST = 3  # row of the first entry, so that children begin at multiples of four
LINE = 64  # bytes


class Queue(NamedTuple):
    entries: ndarray  # (FIRST + capacity, 2) float64: size[0] of them, cost and edge
    places: ndarray  # (half-edges,) int32: where an edge stands; -1 where it does not
    size: ndarray  # (1,) int64
    is_heap: ndarray  # (1,) bool


def make_queue(n_halfedges: int, n_edges: int, is_heap: bool) -> Queue:
    size = 2 * (FIRST + n_edges)
    room = np.zeros(size + LINE // 8)
    start = -room.ctypes.data % LINE // 8
    return Queue(room[start : start + size].reshape(-1, 2), np.full(n_halfedges, -1, np.int32), np.zeros(1, np.int64),
                 np.array([is_heap]))


@njit(**INNER)
def cost_at(queue, place):
    return queue.entries[FIRST + place, 0]


@njit(**INNER)
def edge_at(queue, place):
    return np.int64(queue.entries[FIRST + place, 1])


@njit(**INNER)
def set_place(queue, place, edge, cost):
    queue.entries[FIRST + place, 0], queue.entries[FIRST + place, 1] = cost, edge
    queue.places[edge] = place


@njit(**INNER)
def sift_up(queue, place, edge, cost):
    """Write the edge at `place` or above, where its cost belongs."""
    while place > 0:
        parent = (place - 1) // 4
        if cost_at(queue, parent) <= cost:
            break
        set_place(queue, place, edge_at(queue, parent), cost_at(queue, parent))
        place = parent
    set_place(queue, place, edge, cost)


@njit(**INNER)
def sift_down(queue, place, edge, cost):
    """Write the edge at `place` or below."""
    n = queue.size[0]
    while True:
        child = first = 4 * place + 1
        if first >= n:
            break
        for other in range(first + 1, min(first + 4, n)):
            if cost_at(queue, other) < cost_at(queue, child):
                child = other
        if cost_at(queue, child) >= cost:
            break
        set_place(queue, place, edge_at(queue, child), cost_at(queue, child))
        place = child
    set_place(queue, place, edge, cost)


@njit(**INNER)
def move(queue, place, edge, cost):
    """Write the edge where its cost belongs, seen from a place whose old entry is gone."""
    if not queue.is_heap[0]:
        set_place(queue, place, edge, cost)
    elif place > 0 and cost < cost_at(queue, (place - 1) // 4):
        sift_up(queue, place, edge, cost)
    else:
        sift_down(queue, place, edge, cost)


@njit(**COMPILED)
def put(queue, edge, cost):
    """Add an edge, or give it another cost."""
    place = np.int64(queue.places[edge])
    if place < 0:
        place = queue.size[0]
        queue.size[0] += 1
    move(queue, place, edge, cost)


@njit(**INNER)
def take_out(queue, edge):
    """Remove an edge; nothing happens where it is not in the queue."""
    place = np.int64(queue.places[edge])
    if place < 0:
        return
    queue.places[edge] = -1
    last = queue.size[0] - 1
    queue.size[0] = last
    if place < last:
        move(queue, place, edge_at(queue, last), cost_at(queue, last))


@njit(**INNER)
def draw(state):
    """The next 64 random bits (xorshift64*, Vigna 2016)."""
    x = state[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    state[0] = x
    return x * np.uint64(0x2545F4914F6CDD1D)


@njit(**INNER)
def cheapest(queue, choices, state):
    """The cheapest edge of a heap; the cheapest of `choices` random ones of a list."""
    if queue.is_heap[0]:
        return edge_at(queue, 0)
    n = np.uint64(queue.size[0])
    best, best_cost = 0, np.inf
    for _ in range(choices):
        place = np.int64(((draw(state) >> np.uint64(32)) * n) >> np.uint64(32))
        if cost_at(queue, place) < best_cost:
            best, best_cost = place, cost_at(queue, place)
    return edge_at(queue, best)
