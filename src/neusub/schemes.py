"""Midpoint, Loop and modified butterfly subdivision as sparse operators, and Loop's limit surface.

One level of a scheme is a matrix of shape (nV + nE, nV): rows 0 .. nV - 1 give the old vertices, row nV + k the
midpoint of edge k, in the ordering of `topology`, so levels compose by multiplication.

Sharp edges are the boundary edges and the creases; a sharp edge follows a curve rule that uses only the two vertices
at its ends and the next ones along the curve.  The number of sharp edges at a vertex decides its rule:

    0, 1  smooth (1 is a dart, where a crease fades out): rules of an interior vertex; so is, in Loop, an edge to a dart
    2     on a curve: rules of a boundary vertex, seen from each side by itself
    3 ..  corner: stays in its place

Sources: Loop 1987 (thesis); Warren 1995 (weights); Hoppe et al. 1994, "Piecewise Smooth Surface Reconstruction"
(creases); Zorin, Schroeder and Sweldens 1996 (butterfly).  The butterfly's coefficients beside curves are those in use
after Zorin and Schroeder's course notes, SIGGRAPH 2000; tests show that they reproduce affine functions, they were not
compared with the notes themselves.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy import ndarray
from scipy.sparse import csc_array, csr_array

from neusub.butterfly import butterfly_edges
from neusub.creases import area_normals, crease_mask, marked_creases, refine_creases, unit_vectors
from neusub.memory import check_fits
from neusub.rings import Around, Block, grouped, sharp_count
from neusub.topology import Topology, refined_topology

__all__ = [
    "Operator",
    "loop_limit",
    "subdivide_classic",
    "subdivision_matrix",
    "subdivision_operator",
]


# ---- operators --------------------------------------------------------------------------------------------------


def subdivision_matrix(
    topology: Topology, scheme: str, *, weights: str = "loop", creases: ndarray | None = None
) -> csr_array:
    """One level of a scheme as a matrix (nV + nE, nV) whose rows sum to one.

    scheme: "midpoint", "loop" or "butterfly".  weights: for Loop only, "loop" (1987) or "warren" (1995).
    creases: bool (nE,), edge indices (n,) or vertex pairs (n, 2).  Midpoint has no use for them.
    Raises: ValueError for an unknown scheme or weights, or a crease that is not an edge.
    """
    sharp = topology.is_boundary_edge
    if creases is not None:
        sharp = sharp | crease_mask(topology, creases)
    n = topology.n_vertices
    if scheme == "loop":
        edge_rows = _from_blocks(_loop_edges(topology, sharp), n, sharp)
        return _stack(_loop_vertices(topology, sharp, weights), edge_rows, n)
    if scheme == "midpoint":
        blocks: Iterable[Block] = [(np.arange(len(sharp)), topology.edges, np.array([0.5, 0.5]))]
    elif scheme == "butterfly":
        blocks = butterfly_edges(topology, sharp)
    else:
        raise ValueError(f"unknown scheme {scheme!r}: take 'midpoint', 'loop' or 'butterfly'")
    identity = np.ones(n), np.arange(n, dtype=np.int32), np.arange(n + 1, dtype=np.int32)
    return _stack(csr_array(identity, shape=(n, n)), _from_blocks(blocks, n, sharp), n)


@dataclass(frozen=True)
class Operator:
    """Several levels of a scheme over one connectivity, to be applied to any number of positions."""

    matrices: tuple[csr_array, ...]
    faces: tuple[Int64[ndarray, "nF 3"], ...]  # levels 0 .. L

    def apply(self, positions: Float64[ndarray, "nV k"]) -> list[Float64[ndarray, "nV_level k"]]:
        """Positions (or any other values per vertex) at levels 0 .. L."""
        levels = [np.asarray(positions)]
        for matrix in self.matrices:
            levels.append(matrix @ levels[-1])
        return levels


def subdivision_operator(
    topology: Topology, scheme: str, levels: int, *, weights: str = "loop", creases: ndarray | None = None
) -> Operator:
    """Matrices and faces of `levels` levels; arguments as in `subdivision_matrix`."""
    sharp = None if creases is None else crease_mask(topology, creases)
    matrices, faces = [], [topology.faces]
    for level in range(levels):
        matrices.append(subdivision_matrix(topology, scheme, weights=weights, creases=sharp))
        faces.append(topology.refined_faces)
        if level + 1 < levels:
            coarse, topology = topology, refined_topology(topology)
            sharp = None if sharp is None else refine_creases(coarse, sharp, topology)
    return Operator(tuple(matrices), tuple(faces))


def subdivide_classic(
    mesh: Any,
    scheme: str,
    levels: int,
    *,
    weights: str = "loop",
    creases: ndarray | None = None,
    crease_angle: float | None = None,
    limit_levels: int = 0,
) -> list[Any]:
    """Meshes of levels 0 .. `levels`, then `limit_levels` of Loop; level 0 is the input.

    creases: as in `subdivision_matrix`.  crease_angle: degrees; edges whose dihedral angle is larger are creases too.
    Colours follow the scheme, clipped to [0, 1].
    Raises: ValueError as `subdivision_matrix` does.
    """
    sharp = marked_creases(mesh.topology, mesh.vertices, creases, crease_angle)
    meshes, topology = [mesh], mesh.topology
    check_fits(len(mesh.faces), levels + limit_levels)
    for level in range(levels + limit_levels):
        matrix = subdivision_matrix(topology, scheme if level < levels else "loop", weights=weights, creases=sharp)
        colors = None if mesh.colors is None else np.clip(matrix @ mesh.colors, 0, 1)
        mesh = mesh.refined(matrix @ mesh.vertices, topology.refined_faces, colors)
        meshes.append(mesh)
        if level + 1 < levels + limit_levels:
            coarse, topology = topology, refined_topology(topology)
            sharp = None if sharp is None else refine_creases(coarse, sharp, topology)
    return meshes


# ---- sparse rows ------------------------------------------------------------------------------------------------


def _from_blocks(blocks: Iterable[Block], n_columns: int, edges: ndarray) -> csr_array:
    """One row per edge; a row that occurs in several blocks gets the entries of all of them."""
    blocks = list(blocks)
    width = np.zeros(len(edges), dtype=np.int32)
    for rows, columns, _ in blocks:
        width[rows] += columns.shape[1]
    start = np.zeros(len(edges) + 1, dtype=np.int32)
    np.cumsum(width, out=start[1:])
    if len(blocks) == 1 and len(blocks[0][0]) == len(edges):  # every row alike: no scatter needed
        _, columns, weights = blocks[0]
        data = np.broadcast_to(weights, columns.shape).reshape(-1)
        return csr_array((data, columns.astype(np.int32).reshape(-1), start), shape=(len(edges), n_columns))
    indices, data = np.empty(start[-1], dtype=np.int32), np.empty(start[-1])
    cursor = start[:-1].copy()
    for rows, columns, weights in blocks:
        place = cursor[rows][:, None] + np.arange(columns.shape[1], dtype=np.int32)
        indices[place] = columns
        data[place] = weights
        cursor[rows] += columns.shape[1]
    return csr_array((data, indices, start), shape=(len(edges), n_columns))


def _stack(top: csr_array, bottom: csr_array, n_columns: int) -> csr_array:
    data = np.concatenate([top.data, bottom.data])
    indices = np.concatenate([top.indices, bottom.indices])
    start = np.concatenate([top.indptr, bottom.indptr[1:] + top.indptr[-1]])
    return csr_array((data, indices, start), shape=(len(start) - 1, n_columns))


# ---- Loop -------------------------------------------------------------------------------------------------------


def _loop_beta(valence: Int64[ndarray, " n"], weights: str) -> Float64[ndarray, " n"]:
    """Weight of each neighbour of a smooth vertex."""
    n = np.maximum(valence, 1)
    if weights == "loop":
        return (5 / 8 - (3 / 8 + np.cos(2 * np.pi / n) / 4) ** 2) / n
    if weights == "warren":
        return np.where(n == 3, 3 / 16, 3 / (8 * n))
    raise ValueError(f"unknown weights {weights!r}: take 'loop' or 'warren'")


def _vertex_rows(
    topology: Topology, sharp: Bool[ndarray, " nE"], smooth: Float64[ndarray, " nV"], curve: float
) -> csr_array:
    """Rows of old vertices: `smooth` for each neighbour of a smooth vertex, `curve` for the two along a curve."""
    n = topology.n_vertices
    low, high = topology.edges.T
    count = sharp_count(topology, sharp)
    per_edge = np.where(count < 2, smooth, 0)
    to_low, to_high = per_edge[low], per_edge[high]  # weight that each end gives to the other
    curve_weight = np.where(count == 2, curve, 0)
    to_low[sharp] += curve_weight[low[sharp]]
    to_high[sharp] += curve_weight[high[sharp]]
    start = np.zeros(n + 1, dtype=np.int32)
    np.cumsum(np.bincount(low, minlength=n), out=start[1:])
    # Edges are sorted, so they are the rows of the upper triangle and the columns of the lower one as they stand.
    upper = csr_array((to_low, high.astype(np.int32), start), shape=(n, n))
    lower = csc_array((to_high, high.astype(np.int32), start), shape=(n, n)).tocsr()
    center = 1 - np.where(count < 2, topology.valence * smooth, 2 * curve_weight)
    diagonal = csr_array((center, np.arange(n, dtype=np.int32), np.arange(n + 1, dtype=np.int32)), shape=(n, n))
    return lower + diagonal + upper  # the sum drops zeros, so no entry reaches across an edge that has no part in it


def _loop_vertices(topology: Topology, sharp: Bool[ndarray, " nE"], weights: str) -> csr_array:
    return _vertex_rows(topology, sharp, _loop_beta(topology.valence, weights), 1 / 8)


def _loop_edges(topology: Topology, sharp: Bool[ndarray, " nE"]) -> Iterable[Block]:
    # An edge that ends in a dart is smooth (Hoppe et al. 1994), or the dart would not be.
    curve = sharp & (sharp_count(topology, sharp)[topology.edges] != 1).all(axis=1)
    interior = np.flatnonzero(~curve)
    columns = np.concatenate([topology.edges, topology.edge_opposite], axis=1)
    yield interior, columns[interior] if len(interior) < len(sharp) else columns, np.array([3, 3, 1, 1]) / 8
    if len(interior) < len(sharp):
        yield np.flatnonzero(curve), topology.edges[curve], np.array([1, 1]) / 2


def loop_limit(
    topology: Topology,
    vertices: Float64[ndarray, "nV 3"],
    *,
    weights: str = "loop",
    creases: ndarray | None = None,
) -> tuple[Float64[ndarray, "nV 3"], Float64[ndarray, "nV 3"]]:
    """Where the vertices end under Loop's scheme, and the unit normals of the limit surface there.

    On a crease the normal is the mean of the two sides' normals.  At a corner, and where the two tangents are
    parallel, it is the mean of the faces' normals by area; zero where these cancel too.
    Source: Hoppe et al. 1994, appendix; across the boundary, the left eigenvector of the rules used here.
    """
    sharp = topology.is_boundary_edge
    if creases is not None:
        sharp = sharp | crease_mask(topology, creases)
    count = sharp_count(topology, sharp)
    if (count == 1).any() and (count[topology.edges[sharp]] == 2).any():
        # The edge from a curve to a dart departs from the curve's rule, for one level: the masks hold after it.
        fine = subdivision_matrix(topology, "loop", weights=weights, creases=creases) @ vertices
        refined = refined_topology(topology)
        creases = refine_creases(topology, sharp & ~topology.is_boundary_edge, refined)
        limit = _limit(refined, fine, refined.is_boundary_edge | creases, weights)
        return limit[0][: len(vertices)], limit[1][: len(vertices)]
    return _limit(topology, vertices, sharp, weights)


def _limit(
    topology: Topology, vertices: Float64[ndarray, "nV 3"], sharp: Bool[ndarray, " nE"], weights: str
) -> tuple[Float64[ndarray, "nV 3"], Float64[ndarray, "nV 3"]]:
    """`loop_limit` where no edge joins a dart to a vertex on a curve."""
    count = sharp_count(topology, sharp)
    omega = 1 / (3 / (8 * _loop_beta(topology.valence, weights)) + topology.valence)
    positions = _vertex_rows(topology, sharp, omega, 1 / 6) @ vertices

    around = Around(topology, sharp)
    outgoing = np.full(topology.n_vertices, -1, dtype=np.int64)
    outgoing[around.tail] = np.arange(len(around.tail))
    normals = np.zeros((topology.n_vertices, 3))
    smooth = np.flatnonzero((count < 2) & (outgoing >= 0))
    for n, group in grouped(topology.valence[smooth], smooth):
        angle = 2 * np.pi / n * np.arange(n)
        ring = vertices[around.ring(outgoing[group], n)]
        normals[group] = unit_vectors(np.cross(*(np.einsum("j,ijk->ik", f(angle), ring) for f in (np.cos, np.sin))))
    start = np.flatnonzero(around.sharp & (count[around.tail] == 2))
    for k, group in grouped(around.fan_size(start), start):
        vertex = around.tail[group]
        side = _boundary_normal(vertices[vertex], vertices[around.fan(group, k)], k)
        np.add.at(normals, vertex, side)
    normals = unit_vectors(normals)
    flat = np.zeros_like(normals)
    np.add.at(flat, topology.faces.reshape(-1), np.repeat(area_normals(topology.faces, vertices), 3, axis=0))
    return positions, np.where(normals.any(axis=1, keepdims=True), normals, unit_vectors(flat))


def _boundary_normal(center: ndarray, fan: ndarray, k: int) -> ndarray:
    """Unit normals (n, 3) at vertices with k faces on this side; fan (n, k + 1, 3), counter-clockwise."""
    theta = np.pi / k
    if k == 1:
        inward = fan[:, 0] + fan[:, 1] - 2 * center
    else:
        total = np.sin(theta) / (1 - np.cos(theta))
        weight = (1 + 2 * np.cos(theta)) * np.sin(theta * np.arange(k + 1))
        weight[[0, k]] = -total * np.cos(theta)
        inward = np.einsum("j,ijk->ik", weight, fan) - total * center
    return unit_vectors(np.cross(fan[:, 0] - fan[:, k], inward))
