"""How far two surfaces are from each other: Metro's measures (Cignoni et al. 1998).

Each surface is sampled uniformly by area; each sample's distance to the other surface's triangles is exact (libigl).
"""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Float64, Int64
from numpy import ndarray
from numpy.random import Generator

from neusub.mesh import Mesh, check_is_mesh

__all__ = ["Distance", "distance", "face_normals", "point_distance", "sample_surface", "triangle_quality"]


@dataclass(frozen=True)
class Distance:
    """Distances in the meshes' unit; `forward` is from the result to the reference, `backward` the other way."""

    mean_forward: float
    mean_backward: float
    rms_forward: float
    rms_backward: float
    max_forward: float  # over samples and vertices
    max_backward: float
    normal_angle: float  # degrees, mean over the result's samples, against the reference at the closest point
    flipped: float  # fraction of the result's faces whose normal points away from the reference's
    degenerate: float  # fraction of the result's faces without area
    diagonal: float  # of the reference's bounding box

    @property
    def hausdorff(self) -> float:
        """H: the larger of the two sides."""
        return max(self.max_forward, self.max_backward)

    @property
    def mean(self) -> float:
        """M: the mean of the two one-sided means."""
        return (self.mean_forward + self.mean_backward) / 2

    @property
    def larger_side(self) -> str:
        return "forward" if self.max_forward >= self.max_backward else "backward"

    def percent(self, value: float) -> float:
        """A distance as a percentage of the reference's diagonal."""
        return 100 * value / self.diagonal if self.diagonal else float("nan")

    def __str__(self) -> str:
        rows = [
            ("Hausdorff H (" + self.larger_side + ")", self.hausdorff),
            ("mean M", self.mean),
            ("mean, result to reference", self.mean_forward),
            ("mean, reference to result", self.mean_backward),
            ("RMS, result to reference", self.rms_forward),
            ("RMS, reference to result", self.rms_backward),
        ]
        lines = [f"{name:28s}{value:14.6g}{self.percent(value):12.4f} % of the diagonal" for name, value in rows]
        lines.append(f"{'normal angle':28s}{self.normal_angle:14.4g} degrees")
        lines.append(f"{'flipped faces':28s}{100 * self.flipped:14.4g} %")
        lines.append(f"{'degenerate faces':28s}{100 * self.degenerate:14.4g} %")
        return "\n".join(lines)


def distance(result: Mesh, reference: Mesh, samples: int = 20_000, seed: int = 0) -> Distance:
    """Both one-sided distances between two surfaces.

    samples: points on each surface.  H takes the vertices in, M and the RMS do not, as vertices are not uniform.
    Raises ValueError for fewer than one sample or a seed below 0, TypeError for what is no mesh.
    """
    check_is_mesh(result, "result")
    check_is_mesh(reference, "reference")
    if samples < 1 or seed < 0:
        raise ValueError(f"samples = {samples}, seed = {seed}: take at least one sample, and a seed from 0.")
    rng = np.random.default_rng(seed)
    points, faces = sample_surface(result, samples, rng)
    forward, closest_face, _ = point_distance(points, reference)
    backward, _, _ = point_distance(sample_surface(reference, samples, rng)[0], result)
    ours, theirs = face_normals(result), face_normals(reference)
    cosine = (ours[faces] * theirs[closest_face]).sum(1)
    has_normals = ours[faces].any(axis=1) & theirs[closest_face].any(axis=1)
    angle = np.degrees(np.arccos(np.clip(cosine[has_normals], -1, 1)))
    _, at_centre, _ = point_distance(result.vertices[result.faces].mean(axis=1), reference)
    return Distance(
        mean_forward=float(forward.mean()),
        mean_backward=float(backward.mean()),
        rms_forward=float(np.sqrt((forward**2).mean())),
        rms_backward=float(np.sqrt((backward**2).mean())),
        max_forward=float(max(forward.max(), point_distance(result.vertices, reference)[0].max())),
        max_backward=float(max(backward.max(), point_distance(reference.vertices, result)[0].max())),
        normal_angle=float(angle.mean()) if len(angle) else float("nan"),
        flipped=float(((ours * theirs[at_centre]).sum(1) < 0).mean()),
        degenerate=float((~ours.any(axis=1)).mean()),
        diagonal=float(np.linalg.norm(np.ptp(reference.vertices, axis=0))),
    )


def point_distance(
    points: Float64[ndarray, "n 3"], mesh: Mesh
) -> tuple[Float64[ndarray, " n"], Int64[ndarray, " n"], Float64[ndarray, "n 3"]]:
    """Distance of each point to the mesh, the closest face, and the closest point on it."""
    squared, face, closest = igl.point_mesh_squared_distance(
        np.ascontiguousarray(points), np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces)
    )
    return np.sqrt(squared), np.asarray(face).reshape(-1), np.asarray(closest)


def sample_surface(
    mesh: Mesh, count: int, rng: Generator
) -> tuple[Float64[ndarray, "n 3"], Int64[ndarray, " n"]]:
    """Points uniform by area, and the face of each; of a surface without area, points of its faces evenly."""
    corners = mesh.vertices[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    total = area.sum()
    faces = rng.choice(len(area), size=count, p=area / total if total > 0 else None)
    a, b = rng.random((2, count, 1))
    inside = a + b > 1
    a, b = np.where(inside, 1 - a, a), np.where(inside, 1 - b, b)
    p0, p1, p2 = corners[faces].transpose(1, 0, 2)
    return p0 + a * (p1 - p0) + b * (p2 - p0), faces


def face_normals(mesh: Mesh) -> Float64[ndarray, "nF 3"]:
    """Unit normals; zero where the area is within rounding of zero."""
    corners = mesh.vertices[mesh.faces]
    edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(*edges)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    size = np.linalg.norm(edges[0], axis=1, keepdims=True) * np.linalg.norm(edges[1], axis=1, keepdims=True)
    return np.divide(normal, length, out=np.zeros_like(normal), where=length > 1e-14 * size)


def triangle_quality(vertices: Float64[ndarray, "nV 3"], faces: Int64[ndarray, "nF 3"]) -> Float64[ndarray, " nF"]:
    """Q = 4 sqrt(3) area / (sum of the squared edges): 1 for an equilateral triangle, 0 for one without area."""
    corners = vertices[faces]
    edges = corners[:, [1, 2, 0]] - corners
    twice_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    squared = (edges**2).sum(axis=(1, 2))
    return np.divide(2 * np.sqrt(3) * twice_area, squared, out=np.zeros_like(squared), where=squared > 0)
