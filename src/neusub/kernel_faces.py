"""Faces and their edges, compiled: where all around is flat or sharp, and which faces are turned over.

Kernels on arrays that they trust, for `bounds.py`, which says what the numbers mean and does the same with tensors.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from neusub.compilation import COMPILED, INNER
from neusub.kernel_frames import dot, get, minus, put, times

__all__ = ["find_crisp", "turned_over"]


@njit(**INNER)
def sides_of(faces, positions, f):
    """Two of a face's edges, from its first corner."""
    a = get(positions, faces[f, 0], 0)
    return minus(get(positions, faces[f, 1], 0), a), minus(get(positions, faces[f, 2], 0), a)


@njit(**INNER)
def normal_of(a, b):
    """As long as the face's double area.  No product and sum are rounded at once here: nothing where both are equal."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(**INNER)
def turn_at(normals, left, right):
    """Sine of half the angle between two faces; 0 where one has no area."""
    a, b = get(normals, left, 0), get(normals, right, 0)
    way = minus(a, b)
    return np.sqrt(dot(way, way)) / 2 * (dot(a, a) > 0 and dot(b, b) > 0)


@njit(**INNER)
def crisp(s, sure, squared):
    """How much an edge is either flat or sharp; squared: of the s that halves being flat."""
    return max(sure, squared / (s * s + squared))


@njit(**INNER)
def hold_of_edge(face_edges, halfedges, of_edge, e, e1, e2):
    """How much the middle of an edge inside is to stay."""
    squared, near = of_edge[e, 0] * of_edge[e, 0], of_edge[e, 1] - of_edge[e, 1]
    around_1 = around_2 = near + 1
    for side in range(2):
        f, i = halfedges[e, side] // 3, halfedges[e, side] % 3
        for k in (1, 2):
            other = face_edges[f, (i + k) % 3]
            near = max(near, of_edge[other, 1])
            around_1, around_2 = min(around_1, of_edge[other, 2]), min(around_2, of_edge[other, 3])
    return max(e1 / (squared + e1) * around_1, near * e2 / (squared + e2) * around_2)


@njit(**COMPILED)
def find_crisp(faces, face_edges, halfedges, edges, positions, numbers, normals, of_edge, of_vertices, of_edges):
    """`bounds.crisp_factors`.  numbers: the smallest normal number, the square of a height that may be rounding, where
    sharpness begins and one over how far it goes, the squares of what is flat at vertices and at edges, twice each.
    normals (nF, 3) and of_edge (nE, 4) are scratch, of_vertices (nV, 4), too, but for the results in its first column
    and in its last."""
    tiny, rounding, begins, scale, v1, v2, e1, e2 = numbers
    one, zero = tiny / tiny, tiny - tiny
    for f in range(len(faces)):
        a, b = sides_of(faces, positions, f)
        normal = normal_of(a, b)
        squared = dot(normal, normal)
        has_area = squared > rounding * max(dot(a, a), dot(b, b)) + tiny
        put(normals, f, 0, times(one / np.sqrt(squared) if has_area else zero, normal))
    for v in range(len(positions)):
        of_vertices[v, 0], of_vertices[v, 1], of_vertices[v, 2], of_vertices[v, 3] = one, one, zero, zero
    for e in range(len(edges)):
        there, back = halfedges[e, 0], halfedges[e, 1]
        is_inside = there >= 0 and back >= 0
        s = turn_at(normals, there // 3, back // 3) if is_inside else zero
        sure = min(max((s - begins) * scale, zero), one) if is_inside else one
        of_edge[e, 0], of_edge[e, 1], of_edge[e, 2], of_edge[e, 3] = s, sure, crisp(s, sure, e1), crisp(s, sure, e2)
        for end in range(2):
            v = edges[e, end]
            of_vertices[v, 0] = min(of_vertices[v, 0], crisp(s, sure, v1) if is_inside else zero)
            of_vertices[v, 1] = min(of_vertices[v, 1], crisp(s, sure, v2) if is_inside else zero)
            of_vertices[v, 2], of_vertices[v, 3] = max(of_vertices[v, 2], sure), of_vertices[v, 3] + sure
    for v in range(len(positions)):
        hold = max(of_vertices[v, 0], of_vertices[v, 1] * of_vertices[v, 2])
        of_vertices[v, 0] = one - hold
        of_vertices[v, 3] = one - hold * min(max(of_vertices[v, 3] - 2 * one, zero), one)
    for e in range(len(edges)):
        is_inside = halfedges[e, 0] >= 0 and halfedges[e, 1] >= 0
        of_edges[e] = one - hold_of_edge(face_edges, halfedges, of_edge, e, e1, e2) if is_inside else one


@njit(**COMPILED)
def turned_over(faces, normals, positions, least, results):
    """Whether the cosine of each face's angle to its normal, that of its block's row, is below the least."""
    for f in range(len(faces)):
        a, b = sides_of(faces, positions, f)
        now, then = normal_of(a, b), get(normals, f % len(normals), 0)
        results[f] = dot(now, then) < least * np.sqrt(dot(now, now)) * np.sqrt(dot(then, then))
