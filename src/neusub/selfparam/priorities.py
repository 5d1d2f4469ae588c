"""In which order MAPS removes vertices (Lee et al. 1998, section 2.3): small flat rings first."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64
from numpy import ndarray

from neusub.topology import Topology

__all__ = ["removal_order", "ring_measures"]


def removal_order(
    positions: Float64[ndarray, "nV 3"], topology: Topology, weight: float
) -> Int64[ndarray, " n"]:
    """The vertices that have faces, those of small and flat rings first: both measures divided by their maximum."""
    area, curvature = ring_measures(positions, topology)
    rank = weight * area / (area.max() or 1.0) + (1 - weight) * curvature / (curvature.max() or 1.0)
    used = np.unique(topology.faces)
    return used[np.argsort(rank[used], kind="stable")]


def ring_measures(
    positions: Float64[ndarray, "nV 3"], topology: Topology
) -> tuple[Float64[ndarray, " nV"], Float64[ndarray, " nV"]]:
    """Area of each vertex's faces, and an estimate of |k1| + |k2|.

    From the mean curvature H (cotangent Laplacian) and Gauss's K (angle defect): k = H +- sqrt(H^2 - K).  On a
    boundary instead the curvature of the boundary curve.
    """
    n, faces, corners = len(positions), topology.faces, positions[topology.faces]
    twice_area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    area = np.bincount(faces.reshape(-1), np.repeat(twice_area / 2, 3), n)
    angles, laplacian = np.zeros(n), np.zeros((n, 3))
    for k in range(3):
        at, b, c = faces[:, k], faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        dot = ((positions[b] - positions[at]) * (positions[c] - positions[at])).sum(axis=1)
        angles += np.bincount(at, np.arctan2(twice_area, dot), n)
        pull = divided(dot, 2 * twice_area)[:, None] * (positions[c] - positions[b])
        np.add.at(laplacian, b, pull)
        np.add.at(laplacian, c, -pull)
    mean = divided(1.5 * np.linalg.norm(laplacian, axis=1), area)
    gauss = divided(3 * (2 * np.pi - angles), area)
    curvature = 2 * np.maximum(mean, np.sqrt(np.maximum(mean**2 - gauss, 0)))
    border = topology.edges[topology.is_boundary_edge]
    along = positions[border[:, 1]] - positions[border[:, 0]]
    length = np.linalg.norm(along, axis=1)
    turn, reach = np.zeros((n, 3)), np.zeros(n)
    for end, sign in ((0, 1), (1, -1)):
        np.add.at(turn, border[:, end], sign * divided(along.T, length).T)
        np.add.at(reach, border[:, end], length / 2)
    on_border = divided(np.linalg.norm(turn, axis=1), reach)
    return area, np.where(topology.is_boundary_vertex, on_border, curvature)


def divided(a: ndarray, b: ndarray) -> ndarray:
    """a / b; 0 where b is."""
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0)
