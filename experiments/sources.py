"""More fine shapes than the recipe lists: each one stretched and bent at random, and sharp solids that are made here.

A network that is trained on sixteen shapes learns their curvatures and proportions; the same shapes pulled by a random
affine map and bent along random waves bring others, and other triangles, for they are coarsened anew.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy import ndarray

import neusub

__all__ = ["bent", "solid", "stretched"]


def rotation(generator: np.random.Generator) -> ndarray:
    """Uniform over all rotations."""
    q, r = np.linalg.qr(generator.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def stretched(mesh: neusub.Mesh, generator: np.random.Generator) -> neusub.Mesh:
    """A random affine map that keeps orientation: axes in any direction, of lengths 0.65 to 1.5."""
    a, b = rotation(generator), rotation(generator)
    scale = np.exp(generator.uniform(np.log(0.65), np.log(1.5), 3))
    return neusub.Mesh(mesh.vertices @ (a * scale) @ b, mesh.faces)


def bent(mesh: neusub.Mesh, generator: np.random.Generator, waves: int = 4, slope: float = 0.22) -> neusub.Mesh:
    """Displaced along a few long sine waves, whose slopes together stay below 1, so that space nowhere folds."""
    size = np.ptp(mesh.vertices, axis=0).max()
    vertices = mesh.vertices.copy()
    for _ in range(waves):
        direction, phase = rotation(generator)[0], generator.uniform(0, 2 * np.pi)
        move = rotation(generator)[0]
        length = size * generator.uniform(0.25, 1.2)
        height = slope * length / (2 * np.pi) * generator.uniform(0.3, 1)
        vertices += height * np.sin(2 * np.pi / length * (mesh.vertices @ direction) + phase)[:, None] * move
    return neusub.Mesh(vertices, mesh.faces)


# --- solids ------------------------------------------------------------------------------------------------------


def dense(corners: ndarray, closed: bool, step: float) -> ndarray:
    """A polygon's points at most `step` apart, its corners among them."""
    ends = np.roll(corners, -1, axis=0) if closed else corners[1:]
    parts = []
    for a, b in zip(corners, ends):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / step)))
        parts.append(a + (b - a) * np.arange(count)[:, None] / count)
    return np.concatenate(parts if closed else [*parts, corners[-1:]])


def capped_grid(rings: ndarray, first: ndarray, last: ndarray) -> neusub.Mesh:
    """A tube of rings (k, n, 3), each end closed by a fan to a point; normals point out where rings turn left."""
    k, n = rings.shape[:2]
    i, j = np.meshgrid(np.arange(k - 1), np.arange(n), indexing="ij")
    a, b = (i * n + j).ravel(), (i * n + (j + 1) % n).ravel()
    c, d = a + n, b + n
    around, after = np.arange(n), (np.arange(n) + 1) % n
    faces = [np.stack([a, b, d], 1), np.stack([a, d, c], 1),
             np.stack([np.full(n, k * n), after, around], 1),
             np.stack([np.full(n, k * n + 1), (k - 1) * n + around, (k - 1) * n + after], 1)]
    return neusub.Mesh(np.concatenate([rings.reshape(-1, 3), first[None], last[None]]), np.concatenate(faces))


def lathe(generator: np.random.Generator, step: float = 0.025) -> neusub.Mesh:
    """A profile of straight and slanted steps, turned about the z axis: shafts, vases, chess pieces, all sharp."""
    count = int(generator.integers(3, 8))
    z = np.concatenate([[0], np.cumsum(generator.uniform(0.08, 0.4, count))])
    r = generator.uniform(0.12, 0.5, count + 1)
    keep = generator.random(count) < 0.5  # cylinders between plane shoulders, where not a cone
    corners = [[r[0], z[0]]]
    for k in range(1, count + 1):
        corners.append([corners[-1][0] if keep[k - 1] else r[k], z[k]])
        if keep[k - 1] and k < count:
            corners.append([r[k], z[k]])
    profile = dense(np.array([[0.0, z[0]], *corners, [0.0, z[-1]]]), False, step)[1:-1]
    angle = 2 * np.pi * np.arange(96) / 96
    rings = np.stack([profile[:, :1] * np.cos(angle), profile[:, :1] * np.sin(angle),
                      np.repeat(profile[:, 1:], 96, axis=1)], axis=2)
    return capped_grid(rings, np.array([0, 0, z[0]]), np.array([0, 0, z[-1]]))


def extrusion(generator: np.random.Generator, step: float = 0.03) -> neusub.Mesh:
    """A polygon that is star-shaped about its centre, drawn out along z, plainly or tapered: plates, gears, boxes."""
    count = int(generator.integers(3, 12))
    angle = 2 * np.pi * (np.arange(count) + generator.uniform(-0.3, 0.3, count)) / count
    radius = generator.uniform(0.35, 0.6, count) if generator.random() < 0.6 else np.full(count, 0.5)
    if generator.random() < 0.4:  # a gear's teeth
        count = 4 * int(generator.integers(4, 8))
        angle, radius = 2 * np.pi * np.arange(count) / count, np.tile([0.5, 0.5, 0.35, 0.35], count // 4)
    outline = dense(np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1), True, step)
    height, taper = generator.uniform(0.1, 0.9), generator.choice([1.0, generator.uniform(0.4, 1)])
    inwards = np.arange(1, int(0.5 / step))[::-1] * step / 0.5  # scales of the rings of a cap, outermost first
    up = np.linspace(0, 1, max(2, int(height / step)))
    levels = [*[(s, 0.0) for s in inwards[::-1]], *[(1 + (taper - 1) * t, t) for t in up],
              *[(s * taper, 1.0) for s in inwards]]
    rings = np.stack([np.column_stack([s * outline, np.full(len(outline), t * height)]) for s, t in levels])
    return capped_grid(rings, np.array([0, 0, 0.0]), np.array([0, 0, height]))


SOLIDS: tuple[Callable[[np.random.Generator], neusub.Mesh], ...] = (lathe, extrusion)


def solid(number: int, seed: int = 0) -> neusub.Mesh:
    """Solid NUMBER, stretched at random."""
    generator = np.random.default_rng([seed, number])
    return stretched(SOLIDS[number % len(SOLIDS)](generator), generator)
