"""What the experiments measure: refinements by any method, and numbers of a mesh, alone or beside a reference."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache

import numpy as np
from numpy import ndarray

import neusub
from neusub import Mesh, SelfParameterization
from neusub.metrics import face_normals, point_distance
from neusub.selfparam.parameterization import refinement

SCHEMES = ("midpoint", "loop", "butterfly")
KINDS = ("on_surface", "decimated")
FOLD = 120  # degrees between the faces of an edge, above which it counts as folded


# --- refinements -------------------------------------------------------------------------------------------------


@cache
def loaded(model: str) -> neusub.Subdivider:
    return neusub.Subdivider.load(model)


def refined(mesh: Mesh, method: str | neusub.Subdivider, levels: int = 2, kind: str = "on_surface") -> list[Mesh]:
    """Levels 0 .. levels of a scheme, a network or a shipped model by its name, which is told the kind of input where
    its card names weights for it."""
    if isinstance(method, str):
        if method in SCHEMES:
            return neusub.subdivide(mesh, method, levels)  # type: ignore[arg-type]
        method = loaded(method)
    given = kind if kind in method.card.get("companions", {}) else None
    return method.subdivide(mesh, levels, input=given)  # type: ignore[arg-type]


def remeshed(result: SelfParameterization, levels: int = 2) -> Mesh:
    """The refinement of the coarse mesh, each vertex at its image on the fine surface."""
    parts = refinement(result.faces, len(result.decimated), levels)
    return Mesh(result.points(*result.to_fine(parts.at, parts.barycentric)), parts.faces)


# --- numbers -----------------------------------------------------------------------------------------------------


def score(result: Mesh, reference: Mesh, seeds: Iterable[int] = range(1)) -> tuple[float, float]:
    """H and M in the reference's units, means over sampling seeds."""
    draws = [neusub.distance(result, reference, seed=seed) for seed in seeds]
    return float(np.mean([d.hausdorff for d in draws])), float(np.mean([d.mean for d in draws]))


def percents(result: Mesh, reference: Mesh) -> dict[str, float]:
    """H and M in percent of the reference's diagonal, and the mean angle between normals in degrees."""
    d = neusub.distance(result, reference)
    return {"H": d.percent(d.hausdorff), "M": d.percent(d.mean), "normals": d.normal_angle}


def mean_of(rows: Mapping[str, dict] | Iterable[dict]) -> dict[str, float]:
    """Of each key, the mean over the rows."""
    rows = list(rows.values() if isinstance(rows, Mapping) else rows)
    return {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}


def angles(mesh: Mesh) -> ndarray:
    """Degrees between the normals of the two faces of each inner edge."""
    normals = face_normals(mesh)
    halfedges = mesh.topology.edge_halfedges[~mesh.topology.is_boundary_edge]
    cosine = (normals[halfedges[:, 0] // 3] * normals[halfedges[:, 1] // 3]).sum(axis=1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def is_turned(mesh: Mesh, coarse: Mesh) -> ndarray:
    """Which faces of a refinement look away from the coarse face that they come from."""
    start = face_normals(coarse)
    return (face_normals(mesh) * start[np.arange(len(mesh.faces)) % len(start)]).sum(axis=1) < 0


def is_flipped(result: Mesh, fine: Mesh) -> ndarray:
    """Which faces look away from the fine surface under their centre."""
    _, at, _ = point_distance(result.vertices[result.faces].mean(axis=1), fine)
    return (face_normals(result) * face_normals(fine)[at]).sum(axis=1) < 0


def volume(mesh: Mesh) -> float:
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    return float((a * np.cross(b, c)).sum() / 6)


def round_trip(result: SelfParameterization, points: int) -> ndarray:
    """Coarse -> fine -> coarse of random points: how far they come back from where they were, in diagonals."""
    rng = np.random.default_rng(0)
    faces, barycentric = rng.integers(0, len(result.faces), points), rng.dirichlet([1, 1, 1], points)
    back, there = result.to_coarse(*result.to_fine(faces, barycentric))
    corners = result.decimated[result.faces]
    moved = np.einsum("nk,nkx->nx", barycentric, corners[faces]) - np.einsum("nk,nkx->nx", there, corners[back])
    return np.linalg.norm(moved, axis=1) / np.linalg.norm(np.ptp(result.fine.vertices, axis=0))
