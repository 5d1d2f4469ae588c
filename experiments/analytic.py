"""Training pairs on surfaces of closed form: flat patches, cylinders, cones, tori, ellipsoids, in thin triangles too.

One organic shape in well-shaped triangles teaches a network neither what is flat nor what a long strip of triangles
means.  Here coarse vertices lie on a surface at random parameters, and the vertex that an edge gets in the refinement
goes to the middle of the edge's parameters, so every target is exact.

`even_pairs` are closed surfaces over regular grids, as modelling tools make them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy import ndarray
from scipy.spatial import ConvexHull

from neusub.generation import Pair
from neusub.topology import topology_levels

__all__ = ["analytic_pairs", "even_pairs"]

Surface = Callable[[ndarray], ndarray]  # parameters (n, k) -> positions (n, 3)
COARSE_EDGE = 0.095  # mean edge of the elephants' coarse meshes in their unit box; the pairs vary around it


def strip(generator: np.random.Generator) -> tuple[ndarray, ndarray]:
    """An open patch over the unit square: rows and columns at uneven distances, every quad cut at random."""
    n, m = generator.integers(6, 18, size=2)
    lines = [np.cumsum(generator.uniform(0.4, 1.6, size)) for size in (n, m)]
    u, v = np.meshgrid(*[(line - line[0]) / (line[-1] - line[0]) for line in lines], indexing="ij")
    if generator.random() < 0.5:  # and move the inner vertices
        shift = 0.25 / np.array([n, m]) * generator.uniform(-1, 1, (n, m, 2))
        u[1:-1, 1:-1] += shift[1:-1, 1:-1, 0]
        v[1:-1, 1:-1] += shift[1:-1, 1:-1, 1]
    same = generator.random() < 0.5  # all quads one way, as modelling tools cut them
    other = (np.zeros if same else generator.random)((n - 1) * (m - 1)) > 0.5
    return np.stack([u.ravel(), v.ravel()], axis=1), cut_quads(n, m, other)


def cut_quads(n: int, m: int, other: ndarray, closed: tuple[bool, bool] = (False, False)) -> ndarray:
    """Faces of n rows of m vertices, numbered row by row; quads are cut from their first corner, or the other way.

    closed: whether the first row follows the last, and within a row the first vertex.
    """
    rows, columns = n - (not closed[0]), m - (not closed[1])
    i, j = (part.ravel() for part in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
    below, right = (i + 1) % n, (j + 1) % m
    a, b, c, d = i * m + j, below * m + j, below * m + right, i * m + right
    first = np.where(other[:, None], np.stack([a, b, d], 1), np.stack([a, b, c], 1))
    second = np.where(other[:, None], np.stack([b, c, d], 1), np.stack([a, c, d], 1))
    return np.concatenate([first, second])


def plane(generator: np.random.Generator) -> Surface:
    width = np.exp(generator.uniform(0, np.log(8)))
    return lambda p: np.stack([width * p[:, 0], p[:, 1], 0 * p[:, 0]], axis=1)


def cylinder(generator: np.random.Generator) -> Surface:
    turn, length = generator.uniform(0.7, 5.5), np.exp(generator.uniform(np.log(0.5), np.log(12)))
    return lambda p: np.stack([np.sin(turn * p[:, 0]), np.cos(turn * p[:, 0]), length * p[:, 1]], axis=1)


def cone(generator: np.random.Generator) -> Surface:
    """Cut off below its apex."""
    turn, length, taper = generator.uniform(0.7, 5.5), np.exp(generator.uniform(0, np.log(8))), generator.random()

    def at(p: ndarray) -> ndarray:
        radius = 1 - 0.9 * taper * p[:, 1]
        return np.stack([radius * np.sin(turn * p[:, 0]), radius * np.cos(turn * p[:, 0]), length * p[:, 1]], axis=1)

    return at


def torus(generator: np.random.Generator) -> Surface:
    """A piece of it, seen from outside or from inside."""
    tube, (around, along) = generator.uniform(0.1, 0.7), generator.uniform(1, 5, size=2)
    start = generator.uniform(0, 2 * np.pi)

    def at(p: ndarray) -> ndarray:
        u, v = around * p[:, 0], start + along * p[:, 1]
        r = 1 + tube * np.cos(v)
        return np.stack([r * np.cos(u), r * np.sin(u), tube * np.sin(v)], axis=1)

    return at


def open_pair(generator: np.random.Generator, name: str, surface: Surface, levels: int) -> Pair:
    parameters, faces = strip(generator)
    return make_pair(name, parameters, faces, surface, lambda p: p, levels, random_size(generator))


def ellipsoid_pair(generator: np.random.Generator, name: str, levels: int) -> Pair:
    """Random points of a sphere, stretched; an edge's middle lies on its great circle."""
    parameters = normalised(generator.standard_normal((int(generator.integers(100, 300)), 3)))
    for _ in range(3):  # even them out a little: coarse meshes are never Poisson noise
        push = parameters[:, None] - parameters
        parameters = normalised(parameters + 0.3 * (push / (1e-3 + (push**2).sum(-1, keepdims=True)) ** 1.5).mean(1))
    hull = ConvexHull(parameters)
    faces = hull.simplices.astype(np.int64)
    a, b, c = (parameters[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    faces[inward] = faces[inward][:, ::-1]
    axes = np.exp(generator.uniform(np.log(0.12), 0, 3))
    return make_pair(name, parameters, faces, lambda p: p * axes, normalised, levels,
                     random_size(generator))


def even_torus_pair(generator: np.random.Generator, name: str, levels: int) -> Pair:
    """Closed, around and along at even distances, half of them stretched; its parameters are points of two circles."""
    n, m = int(generator.integers(8, 25)), int(generator.integers(6, 15))
    around = on_circle(np.arange(n) / n)
    along = on_circle((np.arange(m) + generator.integers(2) * generator.random()) / m)
    parameters = np.concatenate([np.repeat(around, m, axis=0), np.tile(along, (n, 1))], axis=1)
    faces = cut_quads(n, m, ways_to_cut(generator, n * m), (True, True))
    tube, axes = generator.uniform(0.2, 0.6), np.exp(generator.integers(2) * generator.uniform(np.log(0.5), 0, 3))

    def at(p: ndarray) -> ndarray:
        r = 1 + tube * p[:, 2:3]
        return np.concatenate([r * p[:, :2], tube * p[:, 3:]], axis=1) * axes

    def project(p: ndarray) -> ndarray:
        return np.concatenate([normalised(p[:, :2]), normalised(p[:, 2:])], axis=1)

    return make_pair(name, parameters, faces, at, project, levels, random_size(generator))


def even_ellipsoid_pair(generator: np.random.Generator, name: str, levels: int) -> Pair:
    """Meridians and circles of latitude of a sphere at even distances, and fans at its poles; stretched."""
    n, m = int(generator.integers(4, 11)), int(generator.integers(8, 21))  # circles, meridians
    across, meridians = on_circle(np.arange(1, n + 1) / (2 * (n + 1))), on_circle(np.arange(m) / m)
    height, radius = (np.repeat(across[:, k], m) for k in (0, 1))
    points = np.column_stack([radius[:, None] * np.tile(meridians, (n, 1)), height])
    north, south, j = n * m, n * m + 1, np.arange(m)
    fans = [np.stack([np.full(m, north), j, (j + 1) % m], 1),
            np.stack([np.full(m, south), (n - 1) * m + (j + 1) % m, (n - 1) * m + j], 1)]
    faces = np.concatenate([cut_quads(n, m, ways_to_cut(generator, (n - 1) * m), (False, True)), *fans])
    axes = np.exp(generator.uniform(np.log(0.3), 0, 3))
    return make_pair(name, np.concatenate([points, [[0, 0, 1], [0, 0, -1]]]), faces, lambda p: p * axes, normalised,
                     levels, random_size(generator))


def ways_to_cut(generator: np.random.Generator, count: int) -> ndarray:
    """All quads one way, all the other, or each at random."""
    kind = generator.integers(3)
    return generator.random(count) > 0.5 if kind == 2 else np.full(count, kind == 1)


def on_circle(turns: ndarray) -> ndarray:
    return np.stack([np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)], axis=1)


def make_pair(name: str, parameters: ndarray, faces: ndarray, surface: Surface, project: Surface, levels: int,
              size: float) -> Pair:
    """Refine in the parameters; `project` brings the mean of two parameters back among them.

    size: mean coarse edge, in COARSE_EDGE.
    """
    topologies, _ = topology_levels(faces, len(parameters), levels)
    sizes = [len(parameters)]
    for topology in topologies:
        parameters = np.concatenate([parameters, project(parameters[topology.edges].mean(axis=1))])
        sizes.append(len(parameters))
    positions = surface(parameters)
    edges = positions[topologies[0].edges]
    scale = COARSE_EDGE * size / np.linalg.norm(edges[:, 0] - edges[:, 1], axis=1).mean()
    return Pair(faces, (positions * scale).astype(np.float32), tuple(sizes), name=name)


def random_size(generator: np.random.Generator) -> float:
    return float(np.exp(generator.uniform(np.log(0.6), np.log(1.6))))


def normalised(vectors: ndarray) -> ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def analytic_pairs(count: int, seed: int, levels: int = 2) -> list[Pair]:
    """Pairs of each kind in turn."""
    open_kinds = {"plane": plane, "cylinder": cylinder, "cone": cone, "torus": torus}
    pairs = []
    for k in range(count):
        generator = np.random.default_rng([seed, k])
        kind = [*open_kinds, "ellipsoid"][k % 5]
        if kind == "ellipsoid":
            pairs.append(ellipsoid_pair(generator, f"ellipsoid[{k}]", levels))
        else:
            pairs.append(open_pair(generator, f"{kind}[{k}]", open_kinds[kind](generator), levels))
    return pairs


def even_pairs(count: int, seed: int, levels: int = 2) -> list[Pair]:
    """Tori and ellipsoids of even grids in turn."""
    kinds = {"even torus": even_torus_pair, "even ellipsoid": even_ellipsoid_pair}
    pairs = []
    for k in range(count):
        kind = list(kinds)[k % 2]
        pairs.append(kinds[kind](np.random.default_rng([seed, k]), f"{kind}[{k}]", levels))
    return pairs
