"""Flattening the ring of an edge, before and after the collapse; and the ring of a vertex, by z^a.

Before: a free-boundary conformal map of the ring's faces.  Each triangle's conformal energy is that of Levy et al.
2002 (least-squares conformal maps), |sum W u|^2 / (2 A) over complex u, a Hermitian form; the map is its smallest
eigenvector beside the constants, as in Mullen et al. 2008, by inverse iteration.  The faces of the collapsed ring
enter the same energy: the paper flattens the ring before alone, and then has to fit the ring after into an outline
that was made for another surface.  Taken together, distortion and flips fell (bunny, 500 faces: 0.07 % to 0.05 % of
the level-2 triangles flipped; horse: 0.05 % to 0.01 %; measured when this came in).  Along a boundary edge (j, k) the
boundary neighbours a and b of j and k are held at 0 and 1, and j, k and the merged vertex on the line between them.

After: the outline stays, so its area does; the conformal place of the one free vertex is then the cotangent-weighted
mean of the ring.

Local indices: ring 0 .. m - 1, then j = m, k = m + 1, the merged vertex m + 2 (`surface.py` has the figure).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy import ndarray

from neusub.compilation import COMPILED, INNER, ONCE
from neusub.selfparam.surface import ZERO, copy_row

__all__ = ["THINNEST", "Solver", "flatten_after", "flatten_before", "flatten_ring", "make_solver"]

ITERATIONS = 3
THINNEST = 1e-4  # quality in the plane: a spike's small angles give z^a a large a, and radii that differ by 1e20
LARGEST_RING = 2**13  # vertices of a ring: its systems take three gigabytes; decimation refuses larger ones
SHIFT = 1e-10  # of the largest diagonal entry: makes the energy definite where the ring is flat


class Solver(NamedTuple):
    """Scratch of the flattening."""

    energy: ndarray  # (n, n) complex128: the Hermitian form, then its factor
    u: ndarray  # (n,) complex128
    real: ndarray  # (2 n, 2 n) float64: the same form over (x, y), for boundary edges
    right: ndarray  # (2 n,)
    free: ndarray  # (2 n,) int64: unknowns that are not held


def make_solver(capacity: int) -> Solver:
    n = capacity + 3
    return Solver(np.zeros((n, n), np.complex128), np.zeros(n, np.complex128), np.zeros((2 * n, 2 * n)),
                  np.zeros(2 * n), np.zeros(2 * n, np.int64))


# --- the conformal energy ----------------------------------------------------------------------------------------


@njit(**INNER)
def add_triangle(energy, points, a, b, c, at_a, at_b, at_c):
    """Add the energy of the triangle with corners points[a, b, c] for the unknowns at_a, at_b, at_c."""
    x1, y1, z1 = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    x2, y2, z2 = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    squared = x1 * x1 + y1 * y1 + z1 * z1
    nx, ny, nz = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2
    twice_area = np.sqrt(nx * nx + ny * ny + nz * nz)
    length = np.sqrt(squared)
    if length == 0.0:
        return
    along = (x1 * x2 + y1 * y2 + z1 * z2) / length
    wa, wb, wc = complex(along - length, twice_area / length), complex(-along, -twice_area / length), complex(length)
    weight = 1.0 / max(twice_area, 1e-10 * (squared + x2 * x2 + y2 * y2 + z2 * z2))
    energy[at_a, at_a] += weight * (wa.real * wa.real + wa.imag * wa.imag)
    energy[at_b, at_b] += weight * (wb.real * wb.real + wb.imag * wb.imag)
    energy[at_c, at_c] += weight * squared
    add_pair(energy, at_a, at_b, weight * wa.conjugate() * wb)
    add_pair(energy, at_b, at_c, weight * wb.conjugate() * wc)
    add_pair(energy, at_c, at_a, weight * wc.conjugate() * wa)


@njit(**INNER)
def add_pair(energy, p, q, value):
    energy[p, q] += value
    energy[q, p] += value.conjugate()


@njit(**INNER)
def assemble(energy, points, m, split, gap, has_f1, merged, kept):
    """Energy of the ring before the collapse and after it; the number of unknowns.

    merged: j and k are one point.  kept: the merged vertex is this one of them; otherwise it is the last unknown.
    """
    j, k = m, m if merged else m + 1
    i = kept if kept >= 0 else m + 2
    n = max(i, k) + 1
    energy[:n, :n] = 0.0
    for t in range(m):
        if t != gap:
            s, apex = (t + 1) % m, j if t < split else k
            add_triangle(energy, points, apex, t, s, apex, t, s)
            if not merged:
                add_triangle(energy, points, m + 2, t, s, i, t, s)
    if not merged:
        add_triangle(energy, points, j, k, ZERO, j, k, ZERO)
        if has_f1:
            add_triangle(energy, points, k, j, split, k, j, split)
    return n


# --- before: free boundary ---------------------------------------------------------------------------------------


@njit(**INNER)
def project(points, u, n, m):
    """First guess: seen along the mean normal of the ring."""
    nx = ny = nz = 0.0
    for t in range(m):
        s = (t + 1) % m
        nx += points[t, 1] * points[s, 2] - points[t, 2] * points[s, 1]
        ny += points[t, 2] * points[s, 0] - points[t, 0] * points[s, 2]
        nz += points[t, 0] * points[s, 1] - points[t, 1] * points[s, 0]
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if length == 0.0:
        nz = length = 1.0
    nx, ny, nz = nx / length, ny / length, nz / length
    if abs(nx) < 0.6:  # x = normal cross the axis it is least along, roughly
        ax, ay, az = 0.0, nz, -ny
    else:
        ax, ay, az = -nz, 0.0, nx
    length = np.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    bx, by, bz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    for v in range(n):
        x, y, z = points[v, 0], points[v, 1], points[v, 2]
        u[v] = complex(ax * x + ay * y + az * z, bx * x + by * y + bz * z)


@njit(**INNER)
def factorise(energy, n):
    """Hermitian L D L* in place: D on the diagonal, L below it."""
    largest = 0.0
    for p in range(n):
        largest = max(largest, energy[p, p].real)
    if largest == 0.0:  # all points are one: any places will do
        largest = 1.0 / SHIFT
    for p in range(n):
        pivot = energy[p, p].real + SHIFT * largest
        energy[p, p] = pivot
        for q in range(p + 1, n):
            value = energy[q, p]
            if value == 0.0:
                continue
            factor = value / pivot
            for r in range(p + 1, q + 1):
                energy[q, r] -= factor * energy[r, p].conjugate()
        for q in range(p + 1, n):
            energy[q, p] /= pivot


@njit(**INNER)
def solve(energy, u, n):
    for p in range(n):
        for q in range(p):
            u[p] -= energy[p, q] * u[q]
    for p in range(n - 1, -1, -1):
        value = u[p] / energy[p, p].real
        for q in range(p + 1, n):
            value -= energy[q, p].conjugate() * u[q]
        u[p] = value


@njit(**INNER)
def centre(u, n, m):
    """Subtract the mean of the ring's places, and bring their mean square to 1."""
    mean = 0j
    for t in range(m):
        mean += u[t]
    mean /= m
    size = 0.0
    for v in range(n):
        u[v] -= mean
    for t in range(m):
        size += u[t].real * u[t].real + u[t].imag * u[t].imag
    if size > 0.0:
        scale = np.sqrt(m / size)
        for v in range(n):
            u[v] *= scale


@njit(**INNER)
def flatten_free(solver, points, uv, m, split, gap, has_f1, merged, kept):
    n = assemble(solver.energy, points, m, split, gap, has_f1, merged, kept)
    u = solver.u
    project(points, u, n, m)
    factorise(solver.energy, n)
    centre(u, n, m)
    for _ in range(ITERATIONS):
        for v in range(m, n):
            u[v] = 0.0  # the norm is over the boundary of the region
        solve(solver.energy, u, n)
        centre(u, n, m)
    for v in range(n):
        uv[v, 0], uv[v, 1] = u[v].real, u[v].imag
    if merged:
        copy_row(uv, m + 1, uv, m)


@njit(**INNER)
def flatten_along_boundary(solver, points, uv, m, split, gap, has_f1, merged, kept):
    """Ring of a boundary edge j -> k: a = r[gap] at 0, b = r[gap + 1] at 1, j and k on the line between them.

    Where the merged vertex stays at j (or k), that is one end of the line, and a (or b) is free: a corner of the
    boundary stays one in the plane.
    """
    n = assemble(solver.energy, points, m, split, gap, has_f1, merged, kept)
    energy, real, right, free = solver.energy, solver.real, solver.right, solver.free
    a, b = gap, (gap + 1) % m
    first, last = m if kept == m else a, m + 1 if kept == m + 1 else b  # the ends of what is straightened
    count = ZERO
    for v in range(n):
        if v != first and v != last:
            free[count] = v
            count += 1
            if v < m:  # the others stay on the line
                free[count] = n + v
                count += 1
    for p in range(count):  # over (x, y) the form is [[R, -S], [S, R]], R + i S being the complex one
        vp, imaginary_p = free[p] % n, free[p] >= n
        for q in range(count):
            value = energy[vp, free[q] % n]
            if imaginary_p == (free[q] >= n):
                real[p, q] = value.real
            else:
                real[p, q] = value.imag if imaginary_p else -value.imag
        right[p] = -energy[vp, last].imag if imaginary_p else -energy[vp, last].real
    solve_real(real, right, count)
    uv[:n] = 0.0
    uv[last, 0] = 1.0
    for p in range(count):
        uv[free[p] % n, free[p] // n] = right[p]


@njit(**INNER)
def solve_real(matrix, right, n):
    """Symmetric positive definite system by L D L^T, in place."""
    largest = 0.0
    for p in range(n):
        largest = max(largest, matrix[p, p])
    for p in range(n):
        pivot = matrix[p, p] + SHIFT * largest
        for q in range(p + 1, n):
            factor = matrix[q, p] / pivot
            if factor == 0.0:
                continue
            for r in range(p + 1, n):
                matrix[q, r] -= factor * matrix[p, r]
            right[q] -= factor * right[p]
        matrix[p, p] = pivot
    for p in range(n - 1, -1, -1):
        value = right[p]
        for q in range(p + 1, n):
            value -= matrix[p, q] * right[q]
        right[p] = value / matrix[p, p]


@njit(**INNER)
def flatten_tutte(uv, m, split, has_f1, along_boundary, gap):
    """Uniform weights: the ring on a circle, j and k at the means of their neighbours (`fig:withWithoutConformal`).

    Along a boundary edge the ring lies on a half circle over the line a, j, k, b.
    """
    if along_boundary:
        for t in range(m):
            angle = np.pi * (1 - ((t - gap - 1) % m) / max(m - 1, 1))
            uv[t, 0], uv[t, 1] = 0.5 - 0.5 * np.cos(angle), 0.5 * np.sin(angle)
        uv[gap, 1] = uv[(gap + 1) % m, 1] = 0.0  # exactly: sin(pi) is not
        uv[m, 0], uv[m, 1] = 1 / 3, 0.0
        uv[m + 1, 0], uv[m + 1, 1] = 2 / 3, 0.0
        return
    for t in range(m):
        uv[t, 0], uv[t, 1] = np.cos(2 * np.pi * t / m), np.sin(2 * np.pi * t / m)
    for axis in range(2):
        sum_j = sum_k = 0.0
        for t in range(split + 1):
            sum_j += uv[t, axis]
        for t in range(split, m + 1):
            sum_k += uv[t % m, axis]
        degree_j, degree_k = split + 2.0, m - split + 2.0  # two equations: degree x = sum + the other one
        determinant = degree_j * degree_k - 1
        uv[m, axis] = (sum_j * degree_k + sum_k) / determinant
        uv[m + 1, axis] = (sum_k * degree_j + sum_j) / determinant


@njit(**ONCE)
def flatten_before(solver, ring, m, split, gap, has_f1, merged, kept, conformal):
    """Places of the ring, j and k in the plane, from their positions in `ring.points`."""
    along_boundary = not has_f1 and not merged
    if not conformal and not merged and (gap < 0 or along_boundary):
        flatten_tutte(ring.uv, m, split, has_f1, along_boundary, gap)
    elif along_boundary:
        flatten_along_boundary(solver, ring.points, ring.uv, m, split, gap, has_f1, merged, kept)
    else:
        flatten_free(solver, ring.points, ring.uv, m, split, gap, has_f1, merged, kept)


# --- after: the boundary of the region held ----------------------------------------------------------------------


@njit(**INNER)
def cotangents(points, weights, m, gap):
    """Cotangent weights of the edges from the merged vertex to the ring."""
    i = m + 2
    weights[:m] = 0.0
    for t in range(m):
        if t == gap:
            continue
        s = (t + 1) % m
        ax, ay, az = points[t, 0] - points[i, 0], points[t, 1] - points[i, 1], points[t, 2] - points[i, 2]
        bx, by, bz = points[s, 0] - points[i, 0], points[s, 1] - points[i, 1], points[s, 2] - points[i, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        squared = ax * ax + ay * ay + az * az + bx * bx + by * by + bz * bz
        twice_area = max(np.sqrt(nx * nx + ny * ny + nz * nz), 1e-10 * squared)
        dot = ax * bx + ay * by + az * bz
        weights[t] += (bx * bx + by * by + bz * bz - dot) / twice_area  # cotangent at s
        weights[s] += (ax * ax + ay * ay + az * az - dot) / twice_area


@njit(**INNER)
def flatten_after(ring, m, gap, along_boundary, kept, conformal):
    """Place of the merged vertex: at that of `kept` (a local index), or where the conformal energy is least."""
    uv, i = ring.uv, m + 2
    if kept >= 0:
        copy_row(uv, i, uv, kept)
        return
    if conformal:
        cotangents(ring.points, ring.weights, m, gap)
    else:
        ring.weights[:m] = 1.0
    total = x = y = 0.0
    for t in range(m):
        total += ring.weights[t]
        x += ring.weights[t] * uv[t, 0]
        y += ring.weights[t] * uv[t, 1]
    uv[i, 0] = x / total
    uv[i, 1] = 0.0 if along_boundary else y / total


# --- the ring of a vertex ----------------------------------------------------------------------------------------


@njit(**COMPILED)
def flatten_ring(points, is_open, uv):
    """The ring by the power map z^a (in place): angles add up to 2 pi, on a boundary to pi; radii become r^a."""
    d = len(points) - 1
    turn = farthest = 0.0
    for t in range(d):
        x1, y1, z1 = spoke(points, t)
        x2, y2, z2 = spoke(points, (t + 1) % d)
        nx, ny, nz = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2
        uv[t, 0], uv[t, 1] = np.sqrt(x1 * x1 + y1 * y1 + z1 * z1), turn
        farthest = max(farthest, uv[t, 0])
        if t < d - 1 or not is_open:
            turn += np.arctan2(np.sqrt(nx * nx + ny * ny + nz * nz), x1 * x2 + y1 * y2 + z1 * z2)
    power = (np.pi if is_open else 2 * np.pi) / turn
    for t in range(d):
        radius, angle = (uv[t, 0] / farthest) ** power, uv[t, 1] * power
        uv[t, 0], uv[t, 1] = radius * np.cos(angle), radius * np.sin(angle)
    uv[d, 0] = uv[d, 1] = 0.0
    if is_open:
        uv[d - 1, 1] = 0.0  # sin(pi), but for rounding: the boundary stays a line


@njit(**INNER)
def spoke(points, t):
    d = len(points) - 1
    return points[t, 0] - points[d, 0], points[t, 1] - points[d, 1], points[t, 2] - points[d, 2]
