"""Triangles that cross each other where midpoints would not: displacements that push the surface through itself are
taken back, whatever scheme they are of.

Crossings are found exactly, by CGAL, which libigl's Python package carries (`igl.copyleft`, under the GPL).  In Python
only who asks for `uncross` calls it; the command does so on cages, too.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import torch
from jaxtyping import Float64, Int64
from numpy import ndarray
from torch import Tensor

from neusub.bounds import area_normals, moved_back, turned_corners
from neusub.mesh import Mesh

__all__ = ["crossing_pairs", "uncrossed"]


def crossing_pairs(vertices: Float64[ndarray, "nV 3"], faces: Int64[ndarray, "nF 3"]) -> Int64[ndarray, "n 2"]:
    """Pairs of faces that meet elsewhere than in a common vertex or edge, smaller index first, sorted.

    Faces without area cross nothing.
    """
    from igl.copyleft.cgal import remesh_self_intersections

    found = remesh_self_intersections(np.ascontiguousarray(vertices), np.ascontiguousarray(faces), detect_only=True)[2]
    return np.unique(np.sort(np.asarray(found, dtype=np.int64).reshape(-1, 2), axis=1), axis=0)


def uncrossed(mesh: Mesh, levels: list[Mesh]) -> list[Mesh]:
    """Levels 0 .. L of a mesh's refinement, with no faces crossing and no triangle turned over (away from the mesh's
    face that it comes from) that is not in the midpoint refinement of the level before; at level 0, in the mesh itself.

    The vertices go back there by halves (`bounds.moved_back`), points of creases too.  A level that crosses nowhere
    anew keeps its turned triangles where to take them back would bring the crossings of midpoints.
    """
    normals = area_normals(torch.tensor(mesh.faces), torch.tensor(mesh.vertices))
    results, safe = [], mesh.vertices
    for level in levels:
        results.append(level.replace_vertices(_uncrossed_level(level.faces, normals, safe, level.vertices)))
        edges = level.topology.edges if level is not levels[-1] else np.empty((0, 2), dtype=np.int64)
        safe = np.concatenate([results[-1].vertices, results[-1].vertices[edges].mean(axis=1)])
    return results


def _uncrossed_level(faces: ndarray, normals: Tensor, safe: ndarray, wanted: ndarray) -> ndarray:
    counts: list[tuple[int, int]] = []  # of crossing pairs, and of those that midpoints do not have, step by step

    def keys(vertices: ndarray) -> ndarray:
        return crossing_pairs(vertices, faces) @ [len(faces), 1]

    @cache
    def before() -> ndarray:
        return keys(safe)

    def crossing(positions: Tensor) -> Tensor:
        found = keys(positions.numpy())
        new = np.setdiff1d(found, before()) if len(found) else found
        counts.append((len(found), len(new)))
        return torch.as_tensor(faces[np.stack(np.divmod(new, len(faces)))].reshape(-1))

    turned = turned_corners(torch.tensor(faces), normals, torch.tensor(safe))

    def wrong(positions: Tensor) -> Tensor:
        return torch.cat([crossing(positions), turned(positions)]).unique()

    result = moved_back(torch.tensor(safe), torch.tensor(wanted), wrong).numpy()
    (at_first, new_at_first), (at_last, _) = counts[0], counts[-1]
    return wanted if new_at_first == 0 and at_last > at_first else result
