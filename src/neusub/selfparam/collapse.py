"""Successive self-parameterization (Liu et al. 2020, section 4.1): edge collapses that keep a map, read top-down.

    run             collapse the next edge until a target is reached or nothing can be collapsed
    try_collapse    ring, criteria, flatten before, place, flatten after, criteria; then record the chart and merge
    offer           put an edge into the queue with the cost that the strategy gives it

All of it is one compiled kernel on raw arrays; `decimation.py` checks, normalises and prepares.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy import ndarray

from neusub.compilation import COMPILED, INNER, ONCE
from neusub.selfparam.criteria import (
    BOUNDARY,
    LEGAL,
    LINK,
    PLANE_AFTER,
    PLANE_BEFORE,
    VALENCE,
    check_plane,
    check_space,
    is_tiny,
)
from neusub.selfparam.flatten import Solver, flatten_after, flatten_before
from neusub.selfparam.mapping import Charts, has_room, record
from neusub.selfparam.placement import QUADRIC, REMOVAL, evaluate, place_edge, subtract_mean
from neusub.selfparam.prefetching import fetch_next, fetch_places, fetch_ring
from neusub.selfparam.queue import Queue, cheapest, put, take_out
from neusub.selfparam.surface import (
    BORDER,
    FIXED,
    FREE,
    ON_SEAM,
    Ring,
    Surface,
    after,
    before,
    collapse_edge,
    copy_row,
    edge_of,
    gather_ring,
    has_repetition,
    head,
    is_seam,
    tail,
    twin_of,
)

__all__ = ["DONE", "FULL", "PAUSED", "STUCK", "Work", "run"]

DONE, STUCK, FULL, PAUSED = range(4)  # why `run` came back; FULL: the charts need more room
NO_ROOM = -1  # beside the reasons of `criteria.py`
NO_LENGTH = 1e-24  # squared length of an edge whose ends count as one point; the box's longest side is 1


class Work(NamedTuple):
    """Everything a decimation works on."""

    surface: Surface
    charts: Charts
    queue: Queue
    ring: Ring
    solver: Solver
    quadrics: ndarray  # (nV, 10)
    refused: ndarray  # (nV,) bool: whether some edge of the vertex may be out of the queue
    gradients: ndarray  # (nV, attributes, 5): `appearance.py`; no attributes for most strategies
    quadric: ndarray  # (10,) scratch: of the edge at hand
    position: ndarray  # (3,) scratch: where its merged vertex goes
    criteria: ndarray  # (4,): `Criteria.packed`
    area: ndarray  # (1,): of the fine surface
    counts: ndarray  # (reasons,) int64: how often each reason came up
    sizes: ndarray  # (3,) int64: vertices, faces, collapses since the queue was last filled
    random: ndarray  # (1,) uint64
    options: ndarray  # (3,) int64: strategy's code, choices, whether the flattening is conformal


@njit(**COMPILED)
def run(work, user, min_vertices, min_faces, pause):
    """Collapse until there are no more than so many vertices, or faces; or `pause` edges were tried."""
    queue, sizes = work.queue, work.sizes
    for _ in range(pause):
        if sizes[0] <= min_vertices or sizes[1] <= min_faces:
            return DONE
        if queue.size[0] == 0:
            if sizes[2] == 0:
                return STUCK
            offer_all(work, user)  # what was refused may be legal now
            continue
        edge = cheapest(queue, work.options[1], work.random)
        fetch_next(work)
        reason = try_collapse(work, user, edge)
        if reason == NO_ROOM:
            return FULL
        work.counts[reason] += 1
        if reason != LEGAL:
            refuse(work, edge)
    return PAUSED


@njit(**COMPILED)
def first_null_edge(surface):
    """The first half-edge of no length; the number of half-edges where there is none, as on most meshes, which need
    not compile `collapse_null_edges` then."""
    for h in range(3 * len(surface.faces)):
        if is_null(surface, h):
            return h
    return 3 * len(surface.faces)


@njit(**COMPILED)
def collapse_null_edges(work, user, first, min_vertices, min_faces):
    """Collapse the edges of length zero, from half-edge `first`, as often as that makes others legal; where it stopped
    for want of room, or the end."""
    surface, went_on = work.surface, True
    while went_on:
        went_on = False
        for h in range(first, 3 * len(surface.faces)):
            if work.sizes[0] <= min_vertices or work.sizes[1] <= min_faces:
                break
            if surface.faces[h // 3, 0] < 0 or edge_of(surface, h) != h or not is_null(surface, h):
                continue
            reason = try_collapse(work, user, h)
            if reason == NO_ROOM:
                return h
            work.counts[reason] += 1
            went_on = went_on or reason == LEGAL
        first = 0
    return 3 * len(surface.faces)


@njit(**COMPILED)
def offer_all(work, user):
    """Fill the queue with every edge there is."""
    surface = work.surface
    work.sizes[2] = 0
    for v in range(len(work.refused)):
        work.refused[v] = False
    for h in range(3 * len(surface.faces)):
        if surface.faces[h // 3, 0] >= 0 and edge_of(surface, h) == h:
            offer(work, user, h)
            work.counts[BOUNDARY] += which_end(surface, h) == -2


@njit(**INNER)
def is_null(surface, h):
    squared = 0.0
    for axis in range(3):
        squared += (surface.positions[tail(surface, h), axis] - surface.positions[head(surface, h), axis]) ** 2
    return squared <= NO_LENGTH


# --- one edge ----------------------------------------------------------------------------------------------------


@njit(**INNER)
def which_end(surface, h):
    """Whose position the merged vertex must take: 0 tail, 1 head, -1 neither; -2 where the edge must stay."""
    hold_j, hold_k = hold_of(surface, h, tail(surface, h)), hold_of(surface, h, head(surface, h))
    if hold_j > FREE and hold_k > FREE:
        return -2
    return 0 if hold_j > FREE else 1 if hold_k > FREE else -1


@njit(**INNER)
def hold_of(surface, h, v):
    """What holds an end of h against a collapse of h: along a boundary or a seam its vertices are free."""
    hold = np.int64(surface.holds[v])
    if hold >= BORDER:
        if twin_of(surface, h) >= 0:
            return FIXED
        hold -= BORDER
    if hold == ON_SEAM and is_seam(surface, h):
        return FREE
    return hold


@njit(**INNER)
def place(work, user, h, end):
    """The cost of an edge; fills work.position."""
    surface, quadric, position = work.surface, work.quadric, work.position
    j, k = tail(surface, h), head(surface, h)
    for term in range(10):
        quadric[term] = work.quadrics[j, term] + work.quadrics[k, term]
    for attribute in range(work.gradients.shape[1]):
        subtract_mean(quadric, work.gradients, j, k, attribute)
    code = work.options[0]
    cost = place_edge(code, user, surface.positions[j], surface.positions[k], quadric, position)
    if end >= 0:
        for axis in range(3):
            position[axis] = surface.positions[j if end == 0 else k, axis]
        if code in (QUADRIC, REMOVAL):
            cost = evaluate(quadric, position[0], position[1], position[2])
    return cost


@njit(**INNER)
def offer(work, user, edge):
    end = which_end(work.surface, edge)
    cost = place(work, user, edge, end) if end > -2 else np.inf
    if cost < 1e300:
        put(work.queue, edge, cost)
    else:
        refuse(work, edge)


@njit(**INNER)
def refuse(work, edge):
    """Take an edge out of the queue until the surface changes around one of its ends."""
    take_out(work.queue, edge)
    work.refused[tail(work.surface, edge)] = work.refused[head(work.surface, edge)] = True


@njit(**INNER)
def kept_end(work, h, m, end):
    """Local index of the old vertex at which the merged one lies; -1 where it lies at neither."""
    if end < 0 and work.options[0] == REMOVAL:
        surface, at_j = work.surface, True
        for axis in range(3):
            at_j &= work.position[axis] == surface.positions[tail(surface, h), axis]
        end = 0 if at_j else 1
    return m + end if end >= 0 else -1


@njit(**ONCE)
def try_collapse(work, user, h):
    """Collapse the edge of h if that is legal; the reason (LEGAL: it was)."""
    surface, ring = work.surface, work.ring
    end = which_end(surface, h)
    if end == -2:
        return BOUNDARY
    m, split, gap = gather_ring(surface, h, ring)
    if m == 0:
        return VALENCE
    fetch_ring(work, m, gap)
    if m < 2 or (m < 3 and gap < 0) or has_repetition(surface, ring, m):
        return LINK
    if not has_room(work.charts, m):
        return NO_ROOM
    merged = is_null(surface, h)
    place(work, user, h, end)
    copy_points(work, h, m)
    kept = m if merged else kept_end(work, h, m, end)
    has_f1 = twin_of(surface, h) >= 0
    if not has_f1 and not merged and kept < 0 and (gap == 0 or gap == m - 1):
        kept = m if gap == 0 else m + 1  # an end with one face only is a corner: in the plane it stays
    tiny = is_tiny(ring, m, work.area[0] / work.sizes[1], work.criteria)
    if not merged and not tiny:
        reason = check_space(ring, m, split, gap, has_f1, work.criteria)
        if reason != LEGAL:
            return reason
    fetch_places(work, m, gap)
    conformal = work.options[2] > 0
    reason = flatten(work, m, split, gap, has_f1, merged, kept, tiny, conformal)
    if tiny and conformal and reason in (PLANE_BEFORE, PLANE_AFTER):
        conformal = not conformal  # False itself would have `flatten` compiled once more, for that alone
        reason = flatten(work, m, split, gap, has_f1, merged, kept, tiny, conformal)
    if reason != LEGAL:
        return reason
    merge(work, user, h, m, split, gap)
    return LEGAL


@njit(**INNER)
def flatten(work, m, split, gap, has_f1, merged, kept, tiny, conformal):
    """Put the ring before and after into the plane; LEGAL, or which test fails there."""
    ring = work.ring
    flatten_before(work.solver, ring, m, split, gap, has_f1, merged, kept, conformal)
    flatten_after(ring, m, gap, not has_f1 and not merged, kept, conformal)
    return check_plane(ring, m, split, gap, has_f1, merged, tiny, work.criteria)


@njit(**INNER)
def copy_points(work, h, m):
    surface, points = work.surface, work.ring.points
    j, k = tail(surface, h), head(surface, h)
    for axis in range(3):
        for t in range(m):
            points[t, axis] = surface.positions[work.ring.vertices[t], axis]
        points[m, axis], points[m + 1, axis] = surface.positions[j, axis], surface.positions[k, axis]
        points[m + 2, axis] = work.position[axis]


@njit(**ONCE)
def merge(work, user, h, m, split, gap):
    """Record the chart, merge the edge and give the edges of the merged vertex their new costs."""
    surface, ring, queue = work.surface, work.ring, work.queue
    record(work.charts, surface, ring, h, m, split, gap)
    twin, j, k = twin_of(surface, h), tail(surface, h), head(surface, h)
    for g in (h, after(h), before(h)):
        take_out(queue, edge_of(surface, g))
    if twin >= 0:
        take_out(queue, edge_of(surface, after(twin)))
        take_out(queue, edge_of(surface, before(twin)))
    collapse_edge(surface, h, ring, m, split, gap)
    copy_row(surface.positions, j, ring.points, m + 2)
    for term in range(10):
        work.quadrics[j, term] += work.quadrics[k, term]
    for attribute in range(work.gradients.shape[1]):
        for term in range(5):
            work.gradients[j, attribute, term] += work.gradients[k, attribute, term]
    a, b = surface.holds[j], surface.holds[k]
    surface.holds[j] = max(a % BORDER, b % BORDER) + max(a, b) // BORDER * BORDER
    work.sizes[0] -= 1
    work.sizes[1] -= 2 if twin >= 0 else 1
    work.sizes[2] += 1
    for t in range(m):
        g = before(np.int64(ring.halfedges[(t - 1) % m])) if t == gap else np.int64(ring.halfedges[t])
        offer(work, user, edge_of(surface, g))
    for t in range(m):
        offer_refused(work, user, np.int64(ring.vertices[t]))


@njit(**INNER)
def offer_refused(work, user, v):
    """Put the edges of a vertex back that were refused: with another ring they may be legal."""
    if not work.refused[v]:
        return
    work.refused[v] = False
    surface = work.surface
    first = np.int64(surface.starts[v])
    g = first
    while g >= 0:
        edge = edge_of(surface, g)
        if work.queue.places[edge] < 0:
            offer(work, user, edge)
        g = twin_of(surface, before(g))
        if g == first:
            break
