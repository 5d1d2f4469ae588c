"""Quadrics that keep the appearance: UVs, colours and normals count beside the distances to the planes.

In each face an attribute is affine in the position, s = g.p + d.  A merged vertex at p with the value s costs, for each
face of area w, w (g.p + d - s)^2 more (Hoppe 1999, "New Quadric Metric for Simplifying Meshes with Appearance
Attributes").  The best s is the mean of g.p + d, so that the sum is a quadric in p alone:

    sum w (g, d)(g, d)^T  -  (m, n)(m, n)^T / W     with  (m, n) = sum w (g, d),  W = sum w

The first term is a quadric like that of a plane and is added to it at the start; (m, n, W) is kept for each vertex and
attribute, added up when vertices merge, and subtracted when an edge is judged.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8
from numpy import ndarray

from neusub.mesh import Mesh
from neusub.selfparam.placement import add_walls, affine_quadrics, scatter, unit_normals
from neusub.selfparam.signals import checked_signal, find_seams
from neusub.selfparam.surface import FIXED, FREE, ON_SEAM

__all__ = ["attribute_quadrics", "seam_holds"]

SMOOTH = np.cos(np.radians(30))  # a vertex whose faces turn further from its normal lies on an edge, and has none
WEIGHT = 0.01  # of squared attribute errors, an attribute's range being 1; times the surface's area


def attribute_quadrics(
    mesh: Mesh, positions: Float64[ndarray, "nV 3"]
) -> tuple[Float64[ndarray, "nV 10"], Float64[ndarray, "nV attributes 5"]]:
    """The quadrics to add, and (m, n, W) of each vertex and attribute; positions in the normalised frame.

    A vertex on a seam of the UVs has no one value there: planes along the seam hold it instead; on a sharp edge it has
    no one normal, and the planes of its faces hold it.
    """
    faces, n_vertices = mesh.faces, len(positions)
    unit, size = unit_normals(positions[faces])
    quadrics = np.zeros((n_vertices, 10))
    attributes, seams = corner_attributes(mesh, unit, size), seams_of(mesh)
    add_walls(quadrics, positions, faces, np.concatenate([seams, mesh.topology.twins[seams]]))
    gradients = np.zeros((n_vertices, len(attributes), 5))
    scale = WEIGHT * size.sum() / 2  # squared distances grow with the area, squared attributes do not
    for attribute, (values, has_value) in enumerate(attributes):
        gradient, offset = affine_pieces(positions[faces], values)
        for column in faces.T:
            weight = scale * size / 2 * has_value[column]
            scatter(quadrics, column[:, None], affine_quadrics(gradient, offset, weight))
            terms = (*gradient.T, offset, np.ones(len(faces)))
            for k, term in enumerate(terms):
                gradients[:, attribute, k] += np.bincount(column, weight * term, n_vertices)
    return quadrics, gradients


def seams_of(mesh: Mesh) -> Int64[ndarray, " nSeams"]:
    """A half-edge of each edge inside the mesh across which the UVs jump."""
    if mesh.uv is None or mesh.uv_faces is None:
        return np.zeros(0, dtype=np.int64)
    return find_seams(mesh, checked_signal(mesh.uv, mesh.uv_faces, len(mesh.faces)))[0]


def seam_holds(mesh: Mesh) -> tuple[UInt8[ndarray, " nV"], Bool[ndarray, " nH"]]:
    """How seams hold their vertices, and the half-edges along them (`surface.Surface`).

    A seam is kept like a boundary: its vertices move along it only, and where it ends or branches, not at all.
    """
    seams = seams_of(mesh)
    is_seam = np.zeros(mesh.faces.size, dtype=np.bool_)
    is_seam[seams] = is_seam[mesh.topology.twins[seams]] = True
    face, corner = seams // 3, seams % 3
    ends = np.concatenate([mesh.faces[face, corner], mesh.faces[face, (corner + 1) % 3]])
    degree = np.bincount(ends, minlength=len(mesh.vertices))
    return np.select([degree == 0, degree == 2], [FREE, ON_SEAM], FIXED).astype(np.uint8), is_seam


def corner_attributes(
    mesh: Mesh, unit: Float64[ndarray, "nF 3"], size: Float64[ndarray, " nF"]
) -> list[tuple[Float64[ndarray, "nF 3"], Bool[ndarray, " nV"]]]:
    """Each attribute's values at the corners, of range 1, and which vertices have one value of it."""
    faces = mesh.faces
    normals = np.zeros_like(mesh.vertices)
    scatter(normals, faces, size[:, None] * unit)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    is_smooth, everywhere = np.ones((2, len(normals)), dtype=bool)
    for column in faces.T:
        is_smooth[column[(unit * normals[column]).sum(axis=1) < SMOOTH]] = False
    attributes = [(values[faces] / 2, is_smooth) for values in normals.T]
    if mesh.colors is not None:
        attributes += [(values[faces], everywhere) for values in mesh.colors.T]
    if mesh.uv is None or mesh.uv_faces is None:
        return attributes
    off_seams = seam_holds(mesh)[0] == FREE
    span = np.ptp(mesh.uv, axis=0).max() or 1.0
    return attributes + [(values[mesh.uv_faces] / span, off_seams) for values in mesh.uv.T]


def affine_pieces(
    corners: Float64[ndarray, "nF 3 3"], values: Float64[ndarray, "nF 3"]
) -> tuple[Float64[ndarray, "nF 3"], Float64[ndarray, " nF"]]:
    """g and d of g.p + d = value at each face's corners, g in the face's plane; zero where a face has no area."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    aa, ab, bb = ((p * q).sum(axis=1) for p, q in ((first, first), (first, second), (second, second)))
    determinant = aa * bb - ab**2
    has_area = determinant > 1e-20 * aa * bb
    to_first, to_second = values[:, 1] - values[:, 0], values[:, 2] - values[:, 0]
    along = np.stack([bb * to_first - ab * to_second, aa * to_second - ab * to_first])
    x, y = np.divide(along, determinant, out=np.zeros_like(along), where=has_area)
    gradient = x[:, None] * first + y[:, None] * second
    return gradient, values[:, 0] - (gradient * corners[:, 0]).sum(axis=1)
