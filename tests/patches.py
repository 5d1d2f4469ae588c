"""Small meshes as arrays, by name and as parameters of tests, and the rows of schemes on them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import pyvista as pv

from neusub import schemes
from neusub.topology import Topology, build_topology

SCHEMES = ["midpoint", "loop", "butterfly"]
ROUNDING = 1e-12  # float64 sums of a few terms of size one


def bipyramid(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Closed; two apexes of valence n, n vertices of valence 4."""
    angle = 2 * np.pi / n * np.arange(n)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    vertices = np.concatenate([ring, [[0, 0, 1], [0, 0, -1]]])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    faces = np.concatenate([np.stack([i, j, i * 0 + n], axis=1), np.stack([j, i, i * 0 + n + 1], axis=1)])
    return vertices, faces


def fan(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Flat n-gon; vertex 0 in the middle has valence n."""
    vertices, faces = bipyramid(n)
    vertices = np.concatenate([[[0, 0, 0]], vertices[:n]])
    return vertices, (faces[:n] + 1) % (n + 1)


def half_fan(k: int) -> tuple[np.ndarray, np.ndarray]:
    """Flat half-disk; vertex 0 lies on the straight boundary and has k faces."""
    angle = np.pi / k * np.arange(k + 1)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    i = np.arange(1, k + 1)
    return np.concatenate([[[0, 0, 0]], ring]), np.stack([i * 0, i, i + 1], axis=1)


def lattice(columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Equilateral triangles in a parallelogram; vertex (i, j) has index j * columns + i."""
    j, i = (a.reshape(-1) for a in np.mgrid[:rows, :columns])
    vertices = np.stack([i + j / 2, j * np.sqrt(3) / 2, 0.0 * i], axis=1)
    a = (j * columns + i)[(i < columns - 1) & (j < rows - 1)]
    lower = np.stack([a, a + 1, a + columns], axis=1)
    upper = np.stack([a + 1, a + columns + 1, a + columns], axis=1)
    return vertices, np.concatenate([lower, upper])


def cube() -> tuple[np.ndarray, np.ndarray]:
    solid = pv.Cube().triangulate().clean()
    return np.asarray(solid.points, dtype=np.float64), np.asarray(solid.regular_faces, dtype=np.int64)


def icosahedron() -> tuple[np.ndarray, np.ndarray]:
    solid = pv.Icosahedron()
    return np.asarray(solid.points, dtype=np.float64), np.asarray(solid.regular_faces, dtype=np.int64)


def refined(vertices: np.ndarray, faces: np.ndarray, levels: int = 1) -> tuple[np.ndarray, np.ndarray]:
    operator = schemes.subdivision_operator(build_topology(faces, len(vertices)), "midpoint", levels)
    return operator.apply(vertices)[-1], operator.faces[-1]


def noisy(vertices: np.ndarray, amount: float = 0.05) -> np.ndarray:
    return vertices + amount * np.random.default_rng(0).normal(size=vertices.shape)


CLOSED = {"cube": cube(), "icosahedron": icosahedron()} | {f"bipyramid{n}": bipyramid(n) for n in range(3, 9)}
CLOSED |= {f"fine bipyramid{n}": refined(*bipyramid(n), 2) for n in (3, 5, 7, 8)}
OPEN = {"lattice": lattice(5, 4), "triangle": fan(3), "strip": lattice(6, 2)}
OPEN |= {f"fan{n}": refined(*fan(n)) for n in (3, 4, 5, 7)} | {f"half fan{k}": refined(*half_fan(k)) for k in (1, 4, 6)}
SHAPES = CLOSED | OPEN

each_closed = pytest.mark.parametrize("vertices, faces", CLOSED.values(), ids=CLOSED.keys())
each_shape = pytest.mark.parametrize("vertices, faces", SHAPES.values(), ids=SHAPES.keys())
each_scheme = pytest.mark.parametrize("scheme", SCHEMES)


def edge_index(topology: Topology, a: int, b: int) -> int:
    return int(np.flatnonzero((topology.edges == sorted((a, b))).all(axis=1))[0])


def edge_row(vertices: np.ndarray, faces: np.ndarray, scheme: str, a: int, b: int, **options: Any) -> dict[int, float]:
    topology = build_topology(faces, len(vertices))
    matrix = schemes.subdivision_matrix(topology, scheme, **options).toarray()
    return nonzero(matrix[len(vertices) + edge_index(topology, a, b)])


def nonzero(row: np.ndarray) -> dict[int, float]:
    return {int(i): float(row[i]) for i in np.flatnonzero(np.abs(row) > 1e-14)}


def some_creases(topology: Topology) -> np.ndarray:
    return np.random.default_rng(1).random(len(topology.edges)) < 0.2
