"""Edges that stay sharp: how they are given, what becomes of them in a refinement, and a mesh cut open along them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy import ndarray

from neusub.topology import Topology, refined_topology

__all__ = ["area_normals", "crease_edges", "crease_mask", "cut_open", "marked_creases", "refine_creases",
           "unit_vectors"]


def marked_creases(topology: Topology, vertices: Float64[ndarray, "nV 3"], creases: ndarray | None,
                   angle_degrees: float | None) -> Bool[ndarray, " nE"] | None:
    """The creases that are given and those that the angle finds; None where neither is asked for."""
    mask = None if creases is None else crease_mask(topology, creases)
    if angle_degrees is None:
        return mask
    by_angle = crease_edges(topology, vertices, angle_degrees)
    return by_angle if mask is None else mask | by_angle


def crease_mask(topology: Topology, creases: ndarray) -> Bool[ndarray, " nE"]:
    """Creases as a mask over edges, from a mask, from edge indices (n,) or from vertex pairs (n, 2), in any order.

    Raises ValueError for what is none of these, and for an edge that is not there.
    """
    creases = np.asarray(creases)
    n_edges, n = len(topology.edges), topology.n_vertices
    if creases.dtype == bool:
        if creases.shape != (n_edges,):
            raise ValueError(f"crease mask has shape {creases.shape}: expected one entry per edge, ({n_edges},)")
        return creases
    if not creases.size:
        return np.zeros(n_edges, dtype=bool)
    if creases.dtype.kind not in "iu" or creases.shape[1:] not in ((), (2,)) or not creases.ndim:
        raise ValueError(f"creases have shape {creases.shape} and type {creases.dtype}: take a mask over the edges, "
                         "integers (n,) that are edges, or (n, 2) that are vertices.")
    index = creases.astype(np.int64)
    if creases.ndim == 2:
        pairs = np.sort(index, axis=1)
        index = np.searchsorted(topology.edges @ [n, 1], pairs @ [n, 1]) if n_edges else np.zeros(len(pairs), int)
        found = (topology.edges[np.minimum(index, n_edges - 1)] == pairs).all(axis=1)
        if not found.all():
            raise ValueError(f"crease {creases[~found][0].tolist()} is not an edge of the mesh: name both its vertices")
    if index.size and (index.min() < 0 or index.max() >= n_edges):
        raise ValueError(f"crease edge index outside 0 .. {n_edges - 1}: {index.min()} .. {index.max()}")
    mask = np.zeros(n_edges, dtype=bool)
    mask[index] = True
    return mask


def crease_edges(
    topology: Topology, vertices: Float64[ndarray, "nV 3"], angle_degrees: float
) -> Bool[ndarray, " nE"]:
    """Interior edges where the normals of the two faces differ by more than the angle; 0 degrees is flat.

    A face without area has no normal and makes no crease.  Raises ValueError for an angle out of range.
    """
    if not 0 <= angle_degrees <= 180:
        raise ValueError(f"the crease angle is {angle_degrees}: take degrees from 0 to 180.")
    normals = unit_vectors(area_normals(topology.faces, vertices))
    left, right = (topology.edge_halfedges // 3).T
    first, second = normals[left], normals[right]
    # atan2 of sine and cosine stays exact near 0 and 180 degrees, where arccos does not.
    angle = np.arctan2(np.linalg.norm(np.cross(first, second), axis=1), (first * second).sum(axis=1))
    return (np.rad2deg(angle) > angle_degrees) & ~topology.is_boundary_edge


def refine_creases(
    topology: Topology, mask: Bool[ndarray, " nE"], refined: Topology | None = None
) -> Bool[ndarray, " nE_fine"]:
    """Creases of the next level: both halves of each crease.  `refined`: its topology, where there already is one."""
    n = topology.n_vertices
    if refined is None:
        refined = refined_topology(topology)
    # An old vertex is joined only to the midpoints of its own edges, so such an edge is half of an old one.
    low, high = refined.edges.T
    is_half = low < n
    return is_half & mask[np.where(is_half, high - n, 0)]


def cut_open(topology: Topology, creases: Bool[ndarray, " nE"]) -> tuple[Int64[ndarray, "nF 3"], Int64[ndarray, " nC"]]:
    """Faces of the mesh cut along its creases, and the vertex that each of the cut mesh's vertices is a copy of.

    Each vertex gets one copy for each part that the creases cut its faces into; its first copy keeps its index.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    corner = topology.faces.reshape(-1)
    there, back = topology.edge_halfedges[~(creases | topology.is_boundary_edge)].T
    after = np.arange(len(corner)).reshape(-1, 3)[:, [1, 2, 0]].reshape(-1)  # a half-edge runs from its corner to this
    joined = np.concatenate([there, after[there]]), np.concatenate([after[back], back])
    graph = coo_array((np.ones(len(joined[0]), dtype=bool), joined), shape=(len(corner), len(corner)))
    part = connected_components(graph.tocsr(), directed=False)[1]
    first = np.unique(part, return_index=True)[1]  # a corner of each part
    owner = corner[first]
    is_first = np.zeros(len(first), dtype=bool)
    is_first[np.unique(owner, return_index=True)[1]] = True
    copy = np.where(is_first, owner, topology.n_vertices + np.cumsum(~is_first) - 1)
    origin = np.concatenate([np.arange(topology.n_vertices), owner[~is_first]])
    return copy[part].reshape(-1, 3), origin


def area_normals(faces: Int64[ndarray, "nF 3"], vertices: Float64[ndarray, "nV 3"]) -> Float64[ndarray, "nF 3"]:
    """Normals as long as twice the area."""
    a, b, c = (vertices[column] for column in faces.T)
    return np.cross(b - a, c - a)


def unit_vectors(vectors: ndarray) -> ndarray:
    """Divided by their lengths; zero stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
