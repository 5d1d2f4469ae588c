"""The distance of a point to a triangle, for kernels: coordinates as numbers, nothing allocated."""

from __future__ import annotations

from numba import njit

from neusub.compilation import COMPILED, INNER

__all__ = ["squared_distance"]


@njit(**COMPILED)
def squared_distance(ux, uy, uz, vx, vy, vz, x, y, z):
    """Of a point to the triangle of the origin, u and v."""
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    u, v = x * ux + y * uy + z * uz, x * vx + y * vy + z * vz
    determinant = uu * vv - uv * uv
    a, b = (vv * u - uv * v) / determinant, (uu * v - uv * u) / determinant
    if a >= 0.0 and b >= 0.0 and a + b <= 1.0:
        return squared_at(ux, uy, uz, vx, vy, vz, x, y, z, a, b)
    best = squared_at(ux, uy, uz, vx, vy, vz, x, y, z, portion(u, uu), 0.0)
    best = min(best, squared_at(ux, uy, uz, vx, vy, vz, x, y, z, 0.0, portion(v, vv)))
    b = portion(v - u - uv + uu, uu + vv - 2 * uv)
    return min(best, squared_at(ux, uy, uz, vx, vy, vz, x, y, z, 1 - b, b))


@njit(**INNER)
def portion(dot, squared):
    """Of an edge of this squared length; no further than its ends."""
    return min(max(dot / squared, 0.0), 1.0) if squared > 0.0 else 0.0


@njit(**INNER)
def squared_at(ux, uy, uz, vx, vy, vz, x, y, z, a, b):
    dx, dy, dz = x - a * ux - b * vx, y - a * uy - b * vy, z - a * uz - b * vz
    return dx * dx + dy * dy + dz * dz
