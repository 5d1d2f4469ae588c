"""How good a map is, in numbers: distortion, flips, refused collapses, and the shape of the coarse triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64
from numpy import ndarray

from neusub.mesh import Mesh
from neusub.metrics import face_normals, triangle_quality
from neusub.selfparam.parameterization import SelfParameterization, refinement, weighted

__all__ = ["MapReport", "TriangleReport", "map_report", "quasi_conformal_error", "triangle_report"]

DEGENERATE = 0.01  # quality below which a triangle counts as degenerate


@dataclass(frozen=True)
class TriangleReport:
    """The shape of a mesh's triangles; `metrics.triangle_quality` says what Q is."""

    quality_low: float  # 1st percentile of Q
    quality_median: float
    area_variation: float  # standard deviation of the areas, divided by their mean


@dataclass(frozen=True)
class MapReport:
    """What `map_report` finds; shares are fractions of the level-`levels` triangles, errors without unit."""

    levels: int
    conformal_median: float  # quasi-conformal error: ratio of the singular values, 1 for a similarity
    conformal_high: float  # 99th percentile
    conformal_worst: float  # inf where a triangle loses its area
    flipped: float  # share whose normal points away from the fine surface's at the image of their centroid
    degenerate: float  # share with quality < 0.01
    collapses: int
    refusals: dict[str, int]  # by reason, as often as each came up
    decimated: TriangleReport  # coarse triangles at the decimator's positions
    on_surface: TriangleReport  # at their images on the fine surface

    def __str__(self) -> str:
        rows = [
            ("quasi-conformal error, median", self.conformal_median, ""),
            ("quasi-conformal error, 99 %", self.conformal_high, ""),
            ("quasi-conformal error, worst", self.conformal_worst, ""),
            ("flipped triangles", 100 * self.flipped, " %"),
            ("degenerate triangles", 100 * self.degenerate, " %"),
            ("collapses", self.collapses, ""),
        ]
        rows += [(f"refused: {reason}", count, "") for reason, count in self.refusals.items() if count]
        for name, triangles in (("decimated", self.decimated), ("on the surface", self.on_surface)):
            rows += [
                (f"coarse Q, 1 %, {name}", triangles.quality_low, ""),
                (f"coarse Q, median, {name}", triangles.quality_median, ""),
                (f"coarse areas vary, {name}", triangles.area_variation, ""),
            ]
        lines = [f"{name:36s}{value:>14,d}" if isinstance(value, int) else f"{name:36s}{value:14.4g}{unit}"
                 for name, value, unit in rows]
        return f"map, triangles of level {self.levels}\n" + "\n".join(lines)


def map_report(parameterization: SelfParameterization, levels: int = 2) -> MapReport:
    """Judge the map on the triangles of the coarse mesh's `levels`-th refinement.

    Each goes, in its own plane, from the decimator's positions to the triangle over its corners' images.
    Raises: ParameterizationError for a negative level.
    """
    coarse = parameterization.coarse
    refined = refinement(coarse.faces, len(coarse.vertices), levels)
    before = weighted(coarse.vertices, coarse.faces[refined.at], refined.barycentric)
    after = parameterization.points(*parameterization.to_fine(refined.at, refined.barycentric))
    error = quasi_conformal_error(before, after, refined.faces)
    centre, _ = parameterization.to_fine(refined.owner, refined.corners.mean(axis=1))
    ours, theirs = face_normals(Mesh(after, refined.faces)), face_normals(parameterization.fine)
    counts = dict(parameterization.counts)
    collapses = counts.pop("legal", 0)
    return MapReport(
        levels=levels,
        conformal_median=float(np.percentile(error, 50, method="higher")),  # no mean of inf and inf
        conformal_high=float(np.percentile(error, 99, method="higher")),
        conformal_worst=float(error.max()),
        flipped=float(((ours * theirs[centre]).sum(axis=1) < 0).mean()),
        degenerate=float((triangle_quality(after, refined.faces) < DEGENERATE).mean()),
        collapses=collapses,
        refusals=counts,
        decimated=triangle_report(coarse.vertices, coarse.faces),
        on_surface=triangle_report(after[: len(coarse.vertices)], coarse.faces),
    )


def triangle_report(vertices: Float64[ndarray, "nV 3"], faces: Int64[ndarray, "nF 3"]) -> TriangleReport:
    """Quality and variation of the areas of a mesh's triangles."""
    quality = triangle_quality(vertices, faces)
    corners = vertices[faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    mean = areas.mean()
    return TriangleReport(float(np.percentile(quality, 1)), float(np.median(quality)),
                          float(areas.std() / mean) if mean > 0 else float("nan"))


def quasi_conformal_error(
    before: Float64[ndarray, "nV 3"], after: Float64[ndarray, "nV 3"], faces: Int64[ndarray, "nF 3"]
) -> Float64[ndarray, " nF"]:
    """Ratio of the singular values, larger over smaller, of each face's linear map between two positions.

    Dimensionless; 1 for a similarity, inf where a face has no area before or after, whatever its orientation.
    Source: Sander et al. 2001, "Texture Mapping Progressive Meshes".
    """
    # In a frame along the face's first edge both triangles are upper triangular, (l, p; 0, q), and so is the map.
    (l0, p0, q0), (l1, p1, q1) = in_own_plane(before[faces]), in_own_plane(after[faces])
    with np.errstate(divide="ignore", invalid="ignore"):
        a, d = l1 / l0, q1 / q0
        b = (p1 - a * p0) / q0
        turning, mirroring = np.hypot(a + d, b), np.hypot(a - d, b)  # sum and difference of the singular values
        error = (turning + mirroring) / (turning - mirroring)
    return np.where((q0 > 0) & (q1 > 0) & (error >= 1), error, np.inf)


def in_own_plane(corners: Float64[ndarray, "n 3 3"]) -> tuple[ndarray, ndarray, ndarray]:
    """Triangles with the first edge on the x axis: its length, and x and y of the third corner."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(first, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (first * second).sum(axis=1) / length
        across = np.linalg.norm(np.cross(first, second), axis=1) / length
    return length, along, across
