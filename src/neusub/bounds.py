"""What keeps a trained network in check on meshes and levels that its training had none of: bounds of displacements,
fading on flat faces and around their sharp edges, Loop's points where the surface is nearly flat, no triangle turned
over, and, in `crisp.py`, the planes of faces between flat and sharp edges.  Not in the paper.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from neusub.compilation import announce
from neusub.configuration import Architecture, Bound
from neusub.crisp import SHARP, Planes, held, in_planes, surely_sharp
from neusub.flaps import CHUNK, FlapGroups, LevelFlaps, by_columns, extremes, means_of_ends, pool, worth_kernels
from neusub.frames import CANCELLED, cross, edge_vectors, local_frames, sizes, squared_lengths, turn_sums, turns

__all__ = ["Measures", "area_normals", "around_edges", "around_vertices", "measured", "moved_back", "restrained",
           "settled", "turned_corners", "unturned"]

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

    return Measures(extremes(groups, height, "max"), extremes(groups, squared.amin(0), "min"),
                    extremes(groups, altitude, "min"),
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
    if worth_kernels(len(groups.corners), measures.height):
        return vertices_by_kernel(groups, measures, sharp)
    count = groups.offsets.diff()
    mean, second, third, fourth, bend = turns(measures.turning, count)

    def free(left: Tensor, turning: Tensor) -> Tensor:
        return 1 - surely_sharp(turning) * held(left, sharp)

    on_edge, at_corner = free(torch.maximum(third, bend / 2), 2 * second), free(fourth, 3 * third)  # of equal s
    if groups.missing is not None:
        border = extremes(groups, groups.missing.any(0).to(mean.dtype), "max") > 0
        on_edge = torch.where(border, free(second, mean * count), on_edge)
    inside = 1 - held(mean, sharp)
    return torch.stack([measures.height, on_edge, at_corner, inside, torch.minimum(on_edge, at_corner)]).T


def vertices_by_kernel(groups: FlapGroups, measures: Measures, sharp: float) -> Float[Tensor, "nV 5"]:
    from neusub.kernel_bounds import hold_vertices

    announce(hold_vertices, "the network's kernels")
    assert measures.turning is not None
    numbers = torch.finfo(measures.height.dtype).tiny, CANCELLED, SHARP[0], 1 / (SHARP[1] - SHARP[0]), sharp**2
    _, missing, offsets = groups.arrays
    results = measures.height.new_empty(5, len(measures.height))
    hold_vertices(tuple(results.new_tensor(numbers).numpy()), measures.height.numpy(), measures.turning.numpy(),
                  offsets, missing, results.numpy())  # type: ignore[call-arg]
    return results.T


def around_edges(groups: FlapGroups, around: Tensor) -> Float[Tensor, "nE 1"] | Float[Tensor, "nE 2"]:
    """The same of edges, from that of their ends: the height, and the factor of their displacement.

    Both faces of an edge are flat where one end is on a sharp edge between flat faces.  They are at a corner too, but
    that may be a pointed tip of something round: the other end must be at a corner as well, or inside a flat face.
    """
    if around.shape[1] > 1 and worth_kernels(len(groups.corners), around):
        return edges_by_kernel(groups, around)
    ends = groups.corners[::2, :2].T  # the same from both half-flaps
    a, b = around.T.index_select(1, ends.reshape(-1)).unflatten(1, (2, -1)).unbind(1)  # columns as rows
    height = torch.maximum(a[0], b[0])
    if len(a) == 1:
        return height[:, None]
    factor = torch.minimum(a[1], b[1])
    for end, other in ((a, b), (b, a)):
        factor = torch.minimum(factor, torch.maximum(end[2], torch.minimum(other[2], other[3])))
    return torch.stack([height, factor]).T


def edges_by_kernel(groups: FlapGroups, around: Float[Tensor, "nV 5"]) -> Float[Tensor, "nE 2"]:
    from neusub.kernel_bounds import hold_edges

    announce(hold_edges, "the network's kernels")
    results = around.new_empty(2, len(groups.corners) // 2)
    hold_edges(groups.arrays[0], around.T.contiguous().numpy(), results.numpy())
    return results.T


def restrained(
    move: Float[Tensor, "m 3"], measures: Measures, around: Float[Tensor, "m k"], plan: Architecture,
    bound: Bound | None,
) -> Float[Tensor, "m 3"]:
    """A module's displacements as far as what is around them lets them go: times the factor of `around_vertices` or
    `around_edges` if `plan.sharp`, times that of `flattened`, and within the bound."""
    heights = around[:, 0].contiguous()
    if (plan.sharp and plan.flat and bound is not None and len(bound) == 3 and worth_kernels(2 * len(move), move)
            and not move.requires_grad):
        return restrained_by_kernel(move, measures, heights, around[:, -1], (plan.flat, *bound, NOTHING))
    if plan.sharp:
        move = move * around[:, -1:]
    if plan.flat:
        move = move * flattened(heights, measures.size, plan.flat)[:, None]
    return move if bound is None else bounded(move, measures, heights, bound)


def restrained_by_kernel(
    move: Float[Tensor, "m 3"], measures: Measures, heights: Float[Tensor, " m"], factors: Float[Tensor, " m"],
    numbers: tuple[float, ...],
) -> Float[Tensor, "m 3"]:
    from neusub.kernel_bounds import restrain

    announce(restrain, "the network's kernels")
    results = move.new_empty(move.shape)
    rows = move, factors, heights, measures.size, measures.edge, measures.altitude, results
    restrain(tuple(move.new_tensor(numbers).numpy()), *(x.contiguous().numpy() for x in rows))  # type: ignore[call-arg]
    return results


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
            boundary = extremes(part, along.to(before.dtype), "max") > 0
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
        if worth_kernels(3 * len(faces), positions):
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
