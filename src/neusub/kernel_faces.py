"""Faces and their edges, compiled: planes that displacements keep to, and which faces are turned over.

Kernels on arrays that they trust, for `crisp.py` and `bounds.py`, which say what the numbers mean and do the same with
tensors.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from neusub.compilation import COMPILED, INNER
from neusub.kernel_frames import dot, dots, get, minus, put, times

__all__ = ["add_planes", "find_crisp", "keep_in_planes", "turned_over"]


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
def crisp_at(of_edge, e, squared):
    """How much an edge is flat or sharp; squared: of the s that is half flat."""
    return max(of_edge[e, 1], squared / (of_edge[e, 0] * of_edge[e, 0] + squared))


@njit(**INNER)
def weight_of(of_edge, a, b, c, squared_away, squared_beside, firm):
    """How crisp a face with these edges is."""
    near = max(of_edge[a, 1], of_edge[b, 1], of_edge[c, 1])
    away = min(crisp_at(of_edge, a, squared_away), crisp_at(of_edge, b, squared_away),
               crisp_at(of_edge, c, squared_away))
    beside = min(crisp_at(of_edge, a, squared_beside), crisp_at(of_edge, b, squared_beside),
                 crisp_at(of_edge, c, squared_beside))
    return min(max(away, near * beside), firm)


@njit(**COMPILED)
def find_crisp(numbers, faces, face_edges, halfedges, positions, of_edge, normals, weights):
    """`crisp.crisp_faces`.  numbers: the smallest normal number, the square of a height that may be rounding, where
    sharpness begins and one over how far it goes, the largest weight, the squares of what is half flat for vertices and
    for edges, twice each.  of_edge (nE, 2) is scratch: how far it turns and how sharp it is."""
    tiny, rounding, begins, scale, firm, v1, v2, e1, e2 = numbers
    one, zero = tiny / tiny, tiny - tiny
    for f in range(len(faces)):
        a, b = sides_of(faces, positions, f)
        normal = normal_of(a, b)
        squared = dot(normal, normal)
        has_area = squared > rounding * max(dot(a, a), dot(b, b)) + tiny
        put(normals, f, 0, times(one / np.sqrt(squared) if has_area else zero, normal))
    for e in range(len(halfedges)):
        there, back = halfedges[e, 0], halfedges[e, 1]
        is_inside = there >= 0 and back >= 0
        s = turn_at(normals, there // 3, back // 3) if is_inside else zero
        of_edge[e, 0], of_edge[e, 1] = s, min(max((s - begins) * scale, zero), one)
    for f in range(len(faces)):
        a, b, c = face_edges[f, 0], face_edges[f, 1], face_edges[f, 2]
        weights[f, 0] = weight_of(of_edge, a, b, c, v1, v2, firm)
        weights[f, 1] = weight_of(of_edge, a, b, c, e1, e2, firm)


@njit(**INNER)
def with_plane(x, y, z, normal, weight):
    """The inverse, by rows, of a matrix M becomes that of M + w / (1 - w) n n^T (Sherman and Morrison 1950).  Nothing
    is lost by single precision here, for no entry is ever above 1."""
    along = dots(normal, x, y, z)
    share = weight / (1 - weight + weight * dot(along, normal))
    return (minus(x, times(share * along[0], along)), minus(y, times(share * along[1], along)),
            minus(z, times(share * along[2], along)))


@njit(**INNER)
def put_rows(matrices, row, x, y, z):
    matrix = matrices[row]
    put(matrix, 0, 0, x)
    put(matrix, 1, 0, y)
    put(matrix, 2, 0, z)


@njit(**COMPILED)
def add_planes(faces, halfedges, normals, weights, of_vertices, of_edges):
    """`crisp.planes_of`: face f of the level comes from face f modulo len(normals) of the input."""
    one, zero = normals.dtype.type(1), normals.dtype.type(0)
    unit_x, unit_y, unit_z = (one, zero, zero), (zero, one, zero), (zero, zero, one)
    for v in range(len(of_vertices)):
        put_rows(of_vertices, v, unit_x, unit_y, unit_z)
    for f in range(len(faces)):
        origin = f % len(normals)
        for i in range(3):
            rows = of_vertices[faces[f, i]]
            x, y, z = with_plane(get(rows, 0, 0), get(rows, 1, 0), get(rows, 2, 0), get(normals, origin, 0),
                                 weights[origin, 0])
            put_rows(of_vertices, faces[f, i], x, y, z)
    for e in range(len(halfedges)):
        x, y, z = unit_x, unit_y, unit_z
        for side in range(2):
            if halfedges[e, side] >= 0:
                origin = halfedges[e, side] // 3 % len(normals)
                x, y, z = with_plane(x, y, z, get(normals, origin, 0), weights[origin, 1])
        put_rows(of_edges, e, x, y, z)


@njit(**COMPILED)
def keep_in_planes(matrices, move, results):
    """Each displacement times its matrix."""
    for i in range(len(move)):
        matrix = matrices[i]
        put(results, i, 0, dots(get(move, i, 0), get(matrix, 0, 0), get(matrix, 1, 0), get(matrix, 2, 0)))


@njit(**COMPILED)
def turned_over(faces, normals, positions, least, results):
    """Whether the cosine of each face's angle to its normal, that of its block's row, is below the least."""
    for f in range(len(faces)):
        a, b = sides_of(faces, positions, f)
        now, then = normal_of(a, b), get(normals, f % len(normals), 0)
        results[f] = dot(now, then) < least * np.sqrt(dot(now, now)) * np.sqrt(dot(then, then))
