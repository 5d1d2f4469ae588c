"""Strategies: which edge collapses first, and where its merged vertex goes.

A strategy is a function of one signature, `PLACE`:

    place(a, b, quadric, position) -> cost

    a, b (3,): the ends of the edge.  quadric (10,): of the merged vertex, xx xy xz yy yz zz x y z 1, so that the sum of
    squared distances of p to the planes is p.A.p + 2 b.p + c.  position (3,): to be filled.
    The edge of least cost collapses first; an infinite cost keeps the edge.

Compile your own with `numba.cfunc(neusub.selfparam.PLACE)`.  The built-in ones are chosen by a code inside the kernel,
so that only yours is compiled anew.  Lengths are in the normalised frame (longest side of the box 1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64
from numba import cfunc, njit, types
from numpy import ndarray
from scipy.sparse import csc_array

from neusub.compilation import COMPILED, INNER
from neusub.topology import Topology

__all__ = ["PLACE", "STRATEGIES", "TIES", "Strategy", "evaluate", "place_edge", "vertex_quadrics"]

_VECTOR = types.Array(types.float64, 1, "C")
PLACE = types.float64(_VECTOR, _VECTOR, _VECTOR, _VECTOR)
QUADRIC, EDGE_LENGTH, REMOVAL, USER = range(4)
BORDER = 10.0  # weight of the planes that hold a boundary
REGULAR = 1e-6  # of the quadric's size: pull towards the edge's middle where the planes leave the position open


@dataclass(frozen=True)
class Strategy:
    """What the kernel needs to know of a strategy."""

    code: int
    spread: float = 0.0  # weight of the distances to the vertices themselves, beside those to the planes
    choices: int = 0  # collapse the cheapest of so many random edges; 0: the cheapest of all
    breaks_ties: bool = False  # on a closed surface, a spread of TIES
    keeps_appearance: bool = False  # UVs, colours and normals count too (`appearance.py`)


# Where a surface is nearly flat all costs are nearly nothing; a little spread then keeps the triangles even.  It takes
# 9 % off the mean distance of bunny's remesh, 7 % off armadillo's, and a third or more off their Hausdorff distances.
# Not where there is a boundary, which it would bend inwards a little.
TIES = 0.0003
STRATEGIES = {
    "quadric": Strategy(QUADRIC, breaks_ties=True),
    "random": Strategy(QUADRIC, choices=100, spread=0.006),
    "edge-length": Strategy(EDGE_LENGTH),
    "uniform": Strategy(QUADRIC, spread=0.1),
    "appearance": Strategy(QUADRIC, breaks_ties=True, keeps_appearance=True),
    "removal": Strategy(REMOVAL, breaks_ties=True),  # the merged vertex is one of the two, in the plane too
}


@cfunc(PLACE, cache=True)
def no_user(a, b, quadric, position):  # stands where no strategy of a user's is given
    return np.inf


@njit(**COMPILED)
def evaluate(quadric, x, y, z):
    """Sum of squared distances to the planes."""
    q = quadric
    return (x * (q[0] * x + 2 * (q[1] * y + q[2] * z + q[6])) + y * (q[3] * y + 2 * (q[4] * z + q[7]))
            + z * (q[5] * z + 2 * q[8]) + q[9])


@njit(**COMPILED)
def minimise(quadric, mx, my, mz, position):
    """Fill the position of least cost; where the planes leave it open, the one closest to (mx, my, mz)."""
    q = quadric
    pull = REGULAR * (q[0] + q[3] + q[5]) + 1e-300
    xx, xy, xz, yy, yz, zz = q[0] + pull, q[1], q[2], q[3] + pull, q[4], q[5] + pull
    # relative to the middle, so that no digits are lost: A d = -(A m + b)
    x = -(q[0] * mx + q[1] * my + q[2] * mz + q[6])
    y = -(q[1] * mx + q[3] * my + q[4] * mz + q[7])
    z = -(q[2] * mx + q[4] * my + q[5] * mz + q[8])
    c0, c1, c2 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * c0 + xy * c1 + xz * c2
    if not determinant > 0.0:  # no plane at all: faces without area
        position[0], position[1], position[2] = mx, my, mz
        return
    position[0] = mx + (c0 * x + c1 * y + c2 * z) / determinant
    position[1] = my + (c1 * x + (xx * zz - xz * xz) * y + (xy * xz - xx * yz) * z) / determinant
    position[2] = mz + (c2 * x + (xy * xz - xx * yz) * y + (xx * yy - xy * xy) * z) / determinant


@njit(**INNER)
def place_edge(code, user, a, b, quadric, position):
    """Cost and position by the strategy of this code."""
    if code == EDGE_LENGTH:
        cost = 0.0
        for axis in range(3):
            cost += (a[axis] - b[axis]) ** 2
            position[axis] = (a[axis] + b[axis]) / 2
        return cost
    if code == REMOVAL:
        at_a, at_b = evaluate(quadric, a[0], a[1], a[2]), evaluate(quadric, b[0], b[1], b[2])
        for axis in range(3):
            position[axis] = a[axis] if at_a <= at_b else b[axis]
        return min(at_a, at_b)
    if code == USER:
        return user(a, b, quadric, position)
    minimise(quadric, (a[0] + b[0]) / 2, (a[1] + b[1]) / 2, (a[2] + b[2]) / 2, position)
    return evaluate(quadric, position[0], position[1], position[2])


@njit(**INNER)
def subtract_mean(quadric, gradients, j, k, attribute):
    """Take (m, n)(m, n)^T / W of an edge's two vertices off its quadric, in place (`appearance.py`)."""
    total = gradients[j, attribute, 4] + gradients[k, attribute, 4]
    if total <= 0.0:
        return
    mx = gradients[j, attribute, 0] + gradients[k, attribute, 0]
    my = gradients[j, attribute, 1] + gradients[k, attribute, 1]
    mz = gradients[j, attribute, 2] + gradients[k, attribute, 2]
    n = gradients[j, attribute, 3] + gradients[k, attribute, 3]
    quadric[0] -= mx * mx / total
    quadric[1] -= mx * my / total
    quadric[2] -= mx * mz / total
    quadric[3] -= my * my / total
    quadric[4] -= my * mz / total
    quadric[5] -= mz * mz / total
    quadric[6] -= mx * n / total
    quadric[7] -= my * n / total
    quadric[8] -= mz * n / total
    quadric[9] -= n * n / total


def vertex_quadrics(
    positions: Float64[ndarray, "nV 3"], topology: Topology, spread: float
) -> tuple[Float64[ndarray, "nV 10"], Float64[ndarray, " nV"]]:
    """The planes of each vertex's faces, weighted by their areas (Garland and Heckbert 1997); a third of these areas.

    Beside a boundary also the planes that stand on its edges, so that it keeps its shape.  With `spread` also the
    vertex itself: the costs then even out the area that a coarse vertex stands for, as k-means would.
    """
    quadrics, areas = np.zeros((len(positions), 10)), np.zeros(len(positions))
    add_planes(quadrics, areas, positions, topology.faces)
    if spread:
        weight = spread * areas
        for term in (0, 3, 5):  # weight |p - position|^2
            quadrics[:, term] += weight
        quadrics[:, 6:9] -= weight[:, None] * positions
        quadrics[:, 9] += weight * np.einsum("ij,ij->i", positions, positions)
    add_walls(quadrics, positions, topology.faces, topology.edge_halfedges[topology.is_boundary_edge].max(axis=1))
    return quadrics, areas


@njit(**COMPILED)
def add_planes(quadrics, areas, positions, faces):
    """Add the faces' planes, weighted by their areas, and thirds of these, to their vertices; in place."""
    for f in range(len(faces)):
        a, b, c = faces[f]
        ux, uy, uz = (positions[b, 0] - positions[a, 0], positions[b, 1] - positions[a, 1],
                      positions[b, 2] - positions[a, 2])
        vx, vy, vz = (positions[c, 0] - positions[a, 0], positions[c, 1] - positions[a, 1],
                      positions[c, 2] - positions[a, 2])
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        size = np.sqrt(x * x + y * y + z * z)
        if not size > 0.0:
            continue
        x, y, z, weight = x / size, y / size, z / size, size / 2
        d = -(x * positions[a, 0] + y * positions[a, 1] + z * positions[a, 2])
        for v in (a, b, c):
            quadric = quadrics[v]
            quadric[0] += weight * (x * x)
            quadric[1] += weight * (x * y)
            quadric[2] += weight * (x * z)
            quadric[3] += weight * (y * y)
            quadric[4] += weight * (y * z)
            quadric[5] += weight * (z * z)
            quadric[6] += weight * (x * d)
            quadric[7] += weight * (y * d)
            quadric[8] += weight * (z * d)
            quadric[9] += weight * (d * d)
            areas[v] += size / 6


def add_walls(quadrics: ndarray, positions: ndarray, faces: ndarray, halfedges: ndarray) -> None:
    """Add, in place, the planes that stand on half-edges' faces along these edges."""
    face, corner = halfedges // 3, halfedges % 3
    unit, _ = unit_normals(positions[faces[face]])
    ends = np.stack([faces[face, corner], faces[face, (corner + 1) % 3]], axis=1)
    wall = np.cross(positions[ends[:, 1]] - positions[ends[:, 0]], unit)
    length = np.linalg.norm(wall, axis=1, keepdims=True)
    wall = np.divide(wall, length, out=np.zeros_like(wall), where=length > 0)
    scatter(quadrics, ends, plane_quadrics(wall, positions[ends[:, 0]], BORDER * length[:, 0] ** 2))


def unit_normals(corners: Float64[ndarray, "nF 3 3"]) -> tuple[Float64[ndarray, "nF 3"], Float64[ndarray, " nF"]]:
    """Unit normals, zero where there is no area, and twice the areas."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1)
    return np.divide(normal, size[:, None], out=np.zeros_like(normal), where=size[:, None] > 0), size


def plane_quadrics(normal: ndarray, point: ndarray, weight: ndarray) -> Float64[ndarray, "n 10"]:
    """weight (n.p - n.point)^2"""
    return affine_quadrics(np.broadcast_to(normal, point.shape), -(normal * point).sum(axis=1), weight)


def affine_quadrics(gradient: ndarray, offset: ndarray, weight: ndarray) -> Float64[ndarray, "n 10"]:
    """weight (g.p + d)^2"""
    (x, y, z), d = gradient.T, offset
    return weight[:, None] * np.stack([x * x, x * y, x * z, y * y, y * z, z * z, x * d, y * d, z * d, d * d], axis=1)


def scatter(sums: ndarray, corners: Int64[ndarray, "n k"], values: ndarray) -> None:
    """Add each row of values to the rows of all of its vertices, in place."""
    n, k = corners.shape
    rows = csc_array((np.ones(n * k), corners.reshape(-1), np.arange(0, n * k + 1, k)), shape=(len(sums), n))
    sums += rows @ values
