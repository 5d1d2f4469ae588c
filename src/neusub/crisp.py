"""Crisp faces, whose own edges are each either flat or sharp: displacements keep to their planes.  Not in the paper."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from neusub.compilation import announce
from neusub.flaps import LevelFlaps, by_columns, worth_kernels
from neusub.frames import cross, rounding, unit

__all__ = ["CrispFaces", "Planes", "crisp_faces", "held", "in_planes", "planes_of", "surely_sharp"]

SHARP = 0.45, 0.6  # sines of half of 53 and 74 degrees: two edges (three) that turn by less are not sharp, by more are

FLAT_AT_VERTICES = 0.001, 0.04  # sines of half the angles at edges that are half flat (`crisp_faces`): away from sharp
FLAT_AT_EDGES = 0.001, 0.015  # edges, and beside them


class CrispFaces(NamedTuple):
    """How much displacements are to keep to the planes of the input's faces (`crisp_faces`)."""

    normals: Float[Tensor, "nF 3"]
    weights: Float[Tensor, "nF 2"]  # for vertices, for midpoints of edges


class Planes(NamedTuple):
    """Matrices that take from displacements what leaves the planes of crisp faces."""

    vertices: Float[Tensor, "nV 3 3"]
    edges: Float[Tensor, "nE 3 3"]


def crisp_faces(level: LevelFlaps, positions: Float[Tensor, "nV 3"]) -> CrispFaces:
    """How crisp the input's faces are, from 0 to nearly 1: whether their own three edges are each either flat or sharp.

    Of the two faces at the rim of a cylinder, one has an edge that is neither.  What counts as flat depends on whether
    one of the three edges is sharp, for little is smooth beside sharp edges; elsewhere it has to be as flat as rounding
    or a decimation leave it, or smooth surfaces of small triangles would count too.  Borders are flat.
    """
    faces, face_edges, halfedges = of_level(level)
    positions = positions.detach()
    reach = positions.abs().max().square()  # heights of a triangle that are rounding errors of its corners are none
    if worth_kernels(3 * len(faces), positions):
        return crisp_by_kernel(faces, face_edges, halfedges, positions, float(reach))
    a, b, c = by_columns(positions).T.index_select(1, faces.T.reshape(-1)).view(3, 3, -1).unbind(1)
    longest = torch.maximum((b - a).square().sum(0), (c - a).square().sum(0))
    normals = unit(cross(b - a, c - a), longest * reach)[0]
    left, right = (halfedges // 3).clamp(min=0).T  # of a border too, where both are not the faces of an edge
    s = (normals.index_select(1, left) - normals.index_select(1, right)).square().sum(0).sqrt() / 2
    has_area, is_border = normals.square().sum(0) > 0, (halfedges < 0).any(1)
    s = torch.where(has_area[left] & has_area[right] & ~is_border, s, 0)  # a face without area turns nothing
    sharp = surely_sharp(s)
    near = sharp[face_edges].amax(1)

    def weight(flat: tuple[float, float]) -> Float[Tensor, " nF"]:
        away, beside = (torch.maximum(sharp, held(s, at))[face_edges].amin(1) for at in flat)
        return torch.maximum(away, near * beside).clamp(max=firm(positions.dtype))

    return CrispFaces(normals.T.contiguous(), torch.stack([weight(FLAT_AT_VERTICES), weight(FLAT_AT_EDGES)], dim=1))


def crisp_by_kernel(
    faces: Int[Tensor, "nF 3"], face_edges: Int[Tensor, "nF 3"], halfedges: Int[Tensor, "nE 2"],
    positions: Float[Tensor, "nV 3"], reach: float,
) -> CrispFaces:
    from neusub.kernel_faces import find_crisp

    announce(find_crisp, "the network's kernels")
    squares = [flat**2 for flat in (*FLAT_AT_VERTICES, *FLAT_AT_EDGES)]
    limit = torch.finfo(positions.dtype)
    numbers = positions.new_tensor([limit.tiny, rounding(limit) * reach, SHARP[0], 1 / (SHARP[1] - SHARP[0]),
                                    firm(positions.dtype), *squares])
    of_edge, *results = (positions.new_empty(size) for size in ((len(halfedges), 2), (len(faces), 3), (len(faces), 2)))
    arrays = faces, face_edges, halfedges, positions.contiguous(), of_edge, *results
    find_crisp(tuple(numbers.numpy()), *(x.numpy() for x in arrays))  # type: ignore[call-arg]
    return CrispFaces(*results)


def planes_of(level: LevelFlaps, crisp: CrispFaces) -> Planes:
    """For each vertex of a level, and each edge's midpoint, the planes of the input's faces that its faces come from.

    So the corners of a solid stay, points on its edges stay on their line, and those inside its sides in their plane,
    however many edges meet there and whatever else does.  Only the input tells what is crisp: from level to level the
    angles of a smooth surface halve, and sooner or later all of it is flat.

    The matrix is the inverse of 1 + sum of w / (1 - w) n n^T, over the faces around with their weights w and normals n:
    one face leaves 1 - w of a displacement along n, k faces in one plane leave (1 - w) / (1 - w + k w) of it.
    """
    faces, _, halfedges = of_level(level)
    if worth_kernels(3 * len(faces), crisp.normals):
        return planes_by_kernel(faces, halfedges, crisp, level.topology.n_vertices)
    precise = torch.float32 if crisp.normals.device.type == "mps" else torch.float64  # for w / (1 - w) is large
    normals, weights = crisp.normals.to(precise), crisp.weights.to(precise)
    stiff = (weights / (1 - weights))[:, :, None, None] * (normals[:, :, None] * normals[:, None])[:, None]
    at_vertices, at_edges = stiff.unbind(1)
    of_vertices = at_vertices.new_zeros(level.topology.n_vertices, 3, 3)
    of_corners = at_vertices.repeat(len(faces) // len(normals), 1, 1)
    for corner in faces.T:
        of_vertices.index_add_(0, corner, of_corners)
    is_border, (left, right) = halfedges < 0, (halfedges // 3).T % len(normals)
    of_edges = at_edges[left].masked_fill(is_border[:, :1, None], 0)
    of_edges = of_edges + at_edges[right].masked_fill(is_border[:, 1:, None], 0)
    one = torch.eye(3, dtype=precise, device=normals.device)
    return Planes(*(torch.linalg.inv(one + matrices).to(crisp.normals.dtype) for matrices in (of_vertices, of_edges)))


def planes_by_kernel(
    faces: Int[Tensor, "nF 3"], halfedges: Int[Tensor, "nE 2"], crisp: CrispFaces, n_vertices: int
) -> Planes:
    from neusub.kernel_faces import add_planes

    announce(add_planes, "the network's kernels")
    results = Planes(*(crisp.normals.new_empty(size, 3, 3) for size in (n_vertices, len(halfedges))))
    add_planes(*(x.numpy() for x in (faces, halfedges, *crisp, *results)))  # type: ignore[call-arg]
    return results


def of_level(level: LevelFlaps) -> tuple[Int[Tensor, "nF 3"], Int[Tensor, "nF 3"], Int[Tensor, "nE 2"]]:
    """Faces, their edges, and the half-edges of edges, where the level's half-flaps are."""
    topology = level.topology
    faces, face_edges, halfedges = map(level.on_device, (topology.faces, topology.face_edges, topology.edge_halfedges))
    return faces, face_edges, halfedges


def firm(dtype: torch.dtype) -> float:
    """The largest weight of a plane: w / (1 - w) takes no more than half of the digits."""
    return 1 - torch.finfo(dtype).eps ** 0.5


def in_planes(move: Float[Tensor, "m 3"], matrices: Float[Tensor, "m 3 3"] | None) -> Float[Tensor, "m 3"]:
    """Displacements without what leaves the planes, if there are any."""
    if matrices is None:
        return move
    if worth_kernels(2 * len(move), move) and not move.requires_grad:
        return in_planes_by_kernel(move, matrices)
    return torch.bmm(matrices, move[:, :, None])[..., 0]


def in_planes_by_kernel(move: Float[Tensor, "m 3"], matrices: Float[Tensor, "m 3 3"]) -> Float[Tensor, "m 3"]:
    from neusub.kernel_faces import keep_in_planes

    announce(keep_in_planes, "the network's kernels")
    results = move.new_empty(move.shape)
    keep_in_planes(matrices.contiguous().numpy(), move.contiguous().numpy(), results.numpy())  # type: ignore[call-arg]
    return results


def surely_sharp(s: Tensor) -> Tensor:
    """From 0 to 1 over SHARP."""
    return ((s - SHARP[0]) / (SHARP[1] - SHARP[0])).clamp(0, 1)


def held(s: Tensor, halved: float) -> Tensor:
    """From 1 down to 0: a half where s, by which the surface turns and should not, is `halved`."""
    return halved**2 / (s.square() + halved**2)
