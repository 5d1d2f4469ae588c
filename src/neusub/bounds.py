"""What keeps a trained network in check on meshes and levels that its training had none of: bounds of displacements,
fading on flat faces and around their sharp edges, the planes of faces between flat and sharp edges, Loop's points where
the surface is nearly flat, and no triangle turned over.  Not in the paper.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from neusub.compilation import ENOUGH, announce
from neusub.configuration import Bound
from neusub.flaps import CHUNK, FlapGroups, LevelFlaps, by_columns, means_of_ends, pool
from neusub.frames import cross, edge_vectors, local_frames, rounding, sizes, squared_lengths, turn_sums, turns, unit

__all__ = ["Measures", "Planes", "area_normals", "around_edges", "around_vertices", "bounded", "crisp_faces",
           "flattened", "in_planes", "measured", "moved_back", "planes_of", "settled", "turned_corners", "unturned"]

SHARP = 0.45, 0.6  # sines of half of 53 and 74 degrees: two edges (three) that turn by less are not sharp, by more are

FLAT_AT_VERTICES = 0.001, 0.04  # sines of half the angles at edges that are half flat (`crisp_faces`): away from sharp
FLAT_AT_EDGES = 0.001, 0.015  # edges, and beside them

TURNED = 0.05  # a triangle is turned over where the cosine of its angle to the input's face is below: at 87 degrees

NOTHING = 1e-6  # a bound below this, of a mesh at the training's scale, is that of a flat patch


class Measures(NamedTuple):
    """Of each vertex's or edge's half-flaps, what bounds and fading depend on."""

    height: Float[Tensor, " m"]  # how far the surface around is from flat: the largest of v2 or v3 over a frame's plane
    edge: Float[Tensor, " m"]  # square of the shortest edge
    altitude: Float[Tensor, " m"]  # square of the smallest altitude of their triangles
    size: Float[Tensor, " m"]  # mean of the half-flaps' sizes
    turning: Float[Tensor, "7 m"] | None  # `turn_sums`


def measured(
    groups: FlapGroups, edges: Float[Tensor, "3 3 n"], axes: Float[Tensor, "3 3 n"], turning: bool
) -> Measures:
    """From the edges of half-flaps and their frames' axes, as constants; `kernel_frames.measure` does the same."""
    edges, axes = edges.detach(), axes.detach()
    squared = squared_lengths(edges)
    height = (edges[1:] * axes[2]).sum(1).abs().amax(0)
    longest = torch.maximum(squared[0], torch.maximum(squared[1:3], squared[3:]))
    doubled = cross(edges[:1], edges[1:]).square().sum(1)  # areas, squared
    altitude = (doubled / longest.clamp(min=torch.finfo(longest.dtype).tiny)).amin(0)

    def of_groups(values: Tensor, reduction: str) -> Tensor:
        return torch.segment_reduce(values, reduction, offsets=groups.offsets)

    return Measures(of_groups(height, "max"), of_groups(squared.amin(0), "min"), of_groups(altitude, "min"),
                    means_of(groups, sizes(squared)), turn_sums(groups, edges, axes) if turning else None)


def around_vertices(
    groups: FlapGroups, measures: Measures, sharp: float
) -> Float[Tensor, "nV 1"] | Float[Tensor, "nV 5"]:
    """What displacements depend on: the height of each vertex and, if `sharp`, how much it is not held by what is
    around it, from 1 down to 0 where it lies exactly: on a straight sharp edge between two flat faces, at a corner of
    three, inside one; at last the factor of its own displacement, the smaller of the first two.

    Edges are sharp from angles as large as SHARP on, for the strips of a cylinder are flat faces too.  `sharp` is the
    sine of half the angle, at an edge where the surface should not turn, that halves the hold; twice that angle where
    the sharp edge bends.  Where a sharp edge ends at a boundary, one edge turns instead of two.
    """
    if not sharp or measures.turning is None:
        return measures.height[:, None]
    count = groups.offsets.diff()
    mean, second, third, fourth, bend = turns(measures.turning, count)

    def free(left: Tensor, turning: Tensor) -> Tensor:
        return 1 - surely_sharp(turning) * held(left, sharp)

    on_edge, at_corner = free(torch.maximum(third, bend / 2), 2 * second), free(fourth, 3 * third)  # of equal s
    if groups.missing is not None:
        border = torch.segment_reduce(groups.missing.any(0).to(mean.dtype), "max", offsets=groups.offsets) > 0
        on_edge = torch.where(border, free(second, mean * count), on_edge)
    inside = 1 - held(mean, sharp)
    return torch.stack([measures.height, on_edge, at_corner, inside, torch.minimum(on_edge, at_corner)]).T


def around_edges(groups: FlapGroups, around: Tensor) -> Float[Tensor, "nE 1"] | Float[Tensor, "nE 2"]:
    """The same of edges, from that of their ends: the height, and the factor of their displacement.

    Both faces of an edge are flat where one end is on a sharp edge between flat faces.  They are at a corner too, but
    that may be a pointed tip of something round: the other end must be at a corner as well, or inside a flat face.
    """
    ends = groups.corners[::2, :2].T  # the same from both half-flaps
    a, b = around.T.index_select(1, ends.reshape(-1)).unflatten(1, (2, -1)).unbind(1)  # columns as rows
    height = torch.maximum(a[0], b[0])
    if len(a) == 1:
        return height[:, None]
    factor = torch.minimum(a[1], b[1])
    for end, other in ((a, b), (b, a)):
        factor = torch.minimum(factor, torch.maximum(end[2], torch.minimum(other[2], other[3])))
    return torch.stack([height, factor]).T


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
    if by_kernel(faces, positions):
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
    if by_kernel(faces, crisp.normals):
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
    return move if matrices is None else torch.bmm(matrices, move[:, :, None])[..., 0]


def surely_sharp(s: Tensor) -> Tensor:
    """From 0 to 1 over SHARP."""
    return ((s - SHARP[0]) / (SHARP[1] - SHARP[0])).clamp(0, 1)


def held(s: Tensor, halved: float) -> Tensor:
    """From 1 down to 0: a half where s, by which the surface turns and should not, is `halved`."""
    return halved**2 / (s.square() + halved**2)


def flattened(heights: Float[Tensor, " m"], size: Float[Tensor, " m"], flat: float) -> Float[Tensor, " m"]:
    """A factor of displacements: h / (h + flat), with the height h in units of the size.

    From level to level the edges of a smooth surface halve, and heights and true displacements go down to a quarter.
    What is wrong in a displacement stays in proportion to the edge, though, and makes the surface rougher, the deeper
    the level; with this factor it goes down too.
    """
    return heights / (heights + flat * size)


def means_of(groups: FlapGroups, size: Float[Tensor, " n"]) -> Float[Tensor, " m"]:
    """Mean size of each group's half-flaps."""
    return pool(groups, size[:, None])[:, 0] / groups.offsets.diff().to(size.dtype)


def settled(
    level: LevelFlaps, before: Float[Tensor, "nV 3"], after: Float[Tensor, "nV+nE 3"], settle: float, sharp: float,
    planes: Planes | None = None,
) -> Float[Tensor, "nV+nE 3"]:
    """A level's vertices, drawn to those of Loop's scheme where the surface before was nearly flat.

    The share of `after` is h / (h + settle) as in `flattened`, at an edge the mean of its ends'.  Every smooth scheme
    comes to the same there; Loop's limit is smooth around irregular vertices too.  Along a boundary it is Loop's curve
    rule; the height there is at least h (h / edge), h from the neighbours' middle: bends go, corners stay.  What
    `around_vertices` holds stays as it is, and Loop's points keep to the planes.
    """
    moves, shares, columns = [], [], by_columns(before)
    for part in level.by_vertex.chunks():
        edges = edge_vectors(part, columns)
        measures = measured(part, edges, local_frames(edges)[0], sharp > 0)
        around = around_vertices(part, measures, sharp)
        heights = measures.height
        valence = part.offsets.diff().to(before.dtype)
        beta = 5 / 8 - (3 / 8 + torch.cos(2 * torch.pi / valence) / 4).square()
        move = pool(part, edges[0].T.contiguous()) * (beta / valence)[:, None]
        if part.missing is not None:
            along = part.missing.any(0)  # two half-flaps of each boundary vertex
            curve = pool(part, edges[0].T * along[:, None]) / 2
            boundary = torch.segment_reduce(along.to(before.dtype), "max", offsets=part.offsets) > 0
            move = torch.where(boundary[:, None], curve / 4, move)
            heights = torch.maximum(heights, curve.square().sum(1) / measures.size)
        moves.append(move)
        share = flattened(heights, measures.size, settle)
        shares.append(1 - (1 - share) * around[:, -1] if sharp else share)
    for part in level.by_edge.chunks():
        ends, wings = before[part.corners[::2]].split(2, dim=1)  # the same from both half-flaps
        move = (wings.mean(dim=1) - ends.mean(dim=1)) / 4
        moves.append(move if part.missing is None else move.masked_fill(part.missing.any(0)[::2, None], 0))
    share = torch.cat(shares)
    share = torch.cat([share, share[level.edges].mean(dim=1)])
    points = torch.cat([before, means_of_ends(level, before)])
    points = points + in_planes(torch.cat(moves), None if planes is None else torch.cat(planes))
    return points.lerp(after, share[:, None])


def bounded(
    move: Float[Tensor, "m 3"], measures: Measures, heights: Float[Tensor, " m"], bound: Bound
) -> Float[Tensor, "m 3"]:
    """Displacements shorter than bound[0] times the shortest edge of their half-flaps, bound[1] times the height and,
    where there is one, bound[2] times the smallest altitude of their triangles.

    Smoothly: with x the length over its bound, it is divided by (1 + x^4)^(1/4), which is nearly 1 below a half.

    Weights that never saw a thin triangle or a short edge would displace by more than the edge and fold the surface; on
    a flat patch they leave a ripple.  Networks that are trained within wide bounds lose nothing by tighter ones in use:
    `docs/research.md` has the numbers.
    """
    limit = torch.minimum(bound[0] * measures.edge.sqrt(), bound[1] * heights)
    if len(bound) > 2:
        limit = torch.minimum(limit, bound[2] * measures.altitude.sqrt())
    ratio = move.square().sum(1) / limit.clamp(min=NOTHING).square()
    return move * ((1 + ratio.square()).sqrt().rsqrt() * (limit / NOTHING).clamp(max=1))[:, None]


def by_kernel(faces: Tensor, positions: Tensor) -> bool:
    """Whether a kernel is to look at the faces: on a CPU, if there are enough of them to be worth its compilation."""
    return (positions.device.type == "cpu" and positions.dtype in (torch.float32, torch.float64)
            and 3 * len(faces) >= ENOUGH)


def area_normals(faces: Int[Tensor, "nF 3"], positions: Float[Tensor, "nV 3"]) -> Float[Tensor, "3 nF"]:
    """Normals of the faces, as long as their double areas; one row a coordinate."""
    a, b, c = positions.T.index_select(1, faces.T.reshape(-1)).view(3, 3, -1).unbind(1)
    return cross(b - a, c - a)


def unturned(
    faces: Int[Tensor, "k*nF_0 3"], normals: Float[Tensor, "3 nF_0"], safe: Float[Tensor, "nV 3"],
    wanted: Float[Tensor, "nV 3"],
) -> Float[Tensor, "nV 3"]:
    """The wanted positions, but no triangle turned over that is not in the safe ones: the midpoints of the level before
    and, on creases, given points."""
    return moved_back(safe, wanted, turned_corners(faces, normals, safe))


def turned_corners(
    faces: Int[Tensor, "k*nF_0 3"], normals: Float[Tensor, "3 nF_0"], safe: Float[Tensor, "nV 3"]
) -> Callable[[Tensor], Int[Tensor, " n"]]:
    """For `moved_back`: the corners of triangles that some positions turn over, and the safe ones do not.

    normals: `area_normals` of the input's faces; those of `faces` come from them block by block.
    """
    def turned_over(positions: Tensor) -> Bool[Tensor, " n"]:
        if by_kernel(faces, positions):
            return turned_by_kernel(faces, normals, positions)
        columns, results = by_columns(positions), []
        for part in faces.split(normals.shape[1] * max(1, CHUNK // normals.shape[1])):
            now = area_normals(part, columns).unflatten(1, (-1, normals.shape[1]))
            cosine = (now * normals[:, None]).sum(0)  # times both lengths
            least = TURNED * now.square().sum(0).sqrt() * normals.square().sum(0).sqrt()
            results.append((cosine < least).flatten())
        return torch.cat(results)

    @cache
    def before() -> Bool[Tensor, " n"]:
        return turned_over(safe)

    def corners(positions: Tensor) -> Int[Tensor, " k"]:
        turned = turned_over(positions)
        return faces[turned & ~before()].unique() if turned.any() else faces.new_empty(0)

    return corners


def turned_by_kernel(
    faces: Int[Tensor, "k*nF_0 3"], normals: Float[Tensor, "3 nF_0"], positions: Float[Tensor, "nV 3"]
) -> Bool[Tensor, " n"]:
    from neusub.kernel_faces import turned_over

    announce(turned_over, "the network's kernels")
    results = torch.empty(len(faces), dtype=torch.bool)
    rows, least = normals.detach().T.contiguous().numpy(), normals.new_tensor(TURNED).numpy()[()]
    turned_over(faces.numpy(), rows, positions.detach().contiguous().numpy(), least, results.numpy())
    return results


def moved_back(
    safe: Float[Tensor, "nV 3"], wanted: Float[Tensor, "nV 3"], wrong: Callable[[Tensor], Int[Tensor, " k"]]
) -> Float[Tensor, "nV 3"]:
    """The wanted positions, where nothing is wrong with them; else part of the way back to the safe ones.

    wrong: the vertices that take part in what is wrong at some positions.  They go half of their way back, until
    nothing is; from an eighth of the way on, all of it.  This ends if nothing is ever wrong whose vertices all are in
    their safe places: `wrong` has to pass over what is wrong there already.
    """
    positions, share = wanted, wanted.new_ones(len(wanted), 1)
    while len(back := wrong(positions)):
        share[back] = torch.where(share[back] > 0.125, share[back] / 2, 0)
        positions = safe.lerp(wanted, share)
    return positions
