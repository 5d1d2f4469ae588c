"""Triangles that cross each other where midpoints would not: displacements that push the surface through itself are
taken back.

Crossings are found exactly, by CGAL, which libigl's Python package carries (`igl.copyleft`, under the GPL); only who
asks for `uncross` calls it.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float64, Int64
from numpy import ndarray
from torch import Tensor

from neusub.bounds import moved_back
from neusub.mesh import Mesh

__all__ = ["crossing_pairs", "uncrossed"]


def crossing_pairs(vertices: Float64[ndarray, "nV 3"], faces: Int64[ndarray, "nF 3"]) -> Int64[ndarray, "n 2"]:
    """Pairs of faces that meet elsewhere than in a common vertex or edge, smaller index first, sorted."""
    from igl.copyleft.cgal import remesh_self_intersections

    found = remesh_self_intersections(np.ascontiguousarray(vertices), np.ascontiguousarray(faces), detect_only=True)[2]
    return np.unique(np.sort(np.asarray(found, dtype=np.int64).reshape(-1, 2), axis=1), axis=0)


def uncrossed(mesh: Mesh, levels: list[Mesh]) -> list[Mesh]:
    """Levels 0 .. L of a mesh's refinement, with no faces crossing that do not cross in the midpoint refinement of the
    level before (at level 0, in the mesh itself): their vertices go back there by halves (`bounds.moved_back`).
    """
    results, safe = [], mesh.vertices
    for level in levels:
        results.append(level.replace_vertices(_uncrossed_level(level.faces, safe, level.vertices)))
        edges = level.topology.edges if level is not levels[-1] else np.empty((0, 2), dtype=np.int64)
        safe = np.concatenate([results[-1].vertices, results[-1].vertices[edges].mean(axis=1)])
    return results


def _uncrossed_level(faces: ndarray, safe: ndarray, wanted: ndarray) -> ndarray:
    before: ndarray | None = None

    def keys(vertices: ndarray) -> ndarray:
        return crossing_pairs(vertices, faces) @ [len(faces), 1]

    def crossing(positions: Tensor) -> Tensor:
        nonlocal before
        found = keys(positions.numpy())
        if len(found) and before is None:
            before = keys(safe)
        new = np.setdiff1d(found, before) if len(found) else found
        return torch.as_tensor(np.unique(faces[np.stack(np.divmod(new, len(faces)))]))

    return moved_back(torch.tensor(safe), torch.tensor(wanted), crossing).numpy()
