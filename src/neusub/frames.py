"""The frame of a half-flap, its size, and the vectors that the network starts from.

Vectors of half-flaps are stored (3, n), one row a coordinate: dot products then run over contiguous rows, several times
faster than (n, 3).
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from neusub.flaps import FlapGroups, by_columns, gather_corners, pool

__all__ = [
    "CANCELLED", "TURNS", "cross", "differential_coordinates", "edge_vectors", "in_frames", "known_true",
    "local_frames", "root", "rounding", "sizes", "squared_lengths", "star_sums", "turn_sums", "turns", "vertex_normals",
    "vertex_turns",
]

TURNS = 4  # numbers of `vertex_turns`
CANCELLED = 1e-4  # in `turns`, a polynomial this small beside the power of the sum may be rounding alone


def rounding(limit: torch.finfo) -> float:
    """The square of a length that may be nothing but rounding errors of numbers of size 1."""
    return (16 * limit.eps) ** 2


def known_true(conditions: Tensor) -> bool:
    """Whether all are true; no, where that is not known without waiting for a GPU, which takes longer than going on as
    if some were not, and is impossible in a recording (`recording.py`)."""
    return conditions.device.type == "cpu" and bool(conditions.all())


def unit(vector: Float[Tensor, "*b 3 n"], size: Tensor | float) -> tuple[Tensor, Bool[Tensor, "*b 1 n"]]:
    """The vector's direction, and whether it has one: its length exceeds rounding errors of `size`, squared."""
    squared = vector.square().sum(-2, keepdim=True)
    limit = torch.finfo(vector.dtype)
    defined = squared > rounding(limit) * size + limit.tiny
    return vector * torch.where(defined, squared, torch.inf).rsqrt(), defined


def root(squared: Tensor) -> Tensor:
    """Square roots, with a gradient of zero where they are zero: there a length has no direction to grow in."""
    positive = squared > 0
    return torch.where(positive, torch.where(positive, squared, 1).sqrt(), 0)


def cross(a: Float[Tensor, "*b 3 n"], b: Float[Tensor, "*b 3 n"]) -> Float[Tensor, "*b 3 n"]:
    """Cross products; torch.linalg.cross is three to five times slower in this layout."""
    a0, a1, a2 = a.unbind(-2)
    b0, b1, b2 = b.unbind(-2)
    return torch.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], dim=-2)


def edge_vectors(groups: FlapGroups, positions: Float[Tensor, "nV 3"]) -> Float[Tensor, "3 3 n"]:
    """v1 - v0, v2 - v0, v3 - v0.  A missing vertex is the other one's reflection through the edge's midpoint."""
    origin, others = gather_corners(groups, positions).split([1, 3])
    edges = others - origin
    if groups.missing is None:
        return edges
    reflected = edges[:1] - edges[1:].flip(0)
    return torch.cat([edges[:1], torch.where(groups.missing[:, None], reflected, edges[1:])])


def local_frames(edges: Float[Tensor, "3 3 n"]) -> tuple[Float[Tensor, "3 3 n"], Bool[Tensor, " n"]]:
    """Axes x, y, z of each half-flap's frame, and whether it has one.

    Where the two normals cancel, z is the left face's, and the right one's where the left face has none.
    """
    e1, e2, e3 = edges.unbind()
    lengths = edges.detach().square().sum(1, keepdim=True)
    x, has_edge = unit(e1, 0.0)
    normals = cross(torch.stack([e1, e3]), torch.stack([e2, e1]))
    normals, has_normal = unit(normals, lengths[:1] * lengths[1:])
    z, has_both = unit(normals.sum(0), 1.0)
    if not known_true(has_both):
        z = torch.where(has_both, z, torch.where(has_normal[0], normals[0], normals[1]))
    return torch.stack([x, cross(z, x), z]), (has_edge & has_normal.any(0))[0]


def squared_lengths(edges: Float[Tensor, "3 3 n"]) -> Float[Tensor, "5 n"]:
    """Of the five edges of each half-flap, as constants: v0v1, v0v2, v0v3, v1v2, v1v3."""
    edges = edges.detach()
    return torch.cat([edges, edges[1:] - edges[:1]]).square().sum(1)


def sizes(squared: Float[Tensor, "5 n"]) -> Float[Tensor, " n"]:
    """Mean length of the five edges of each half-flap, from `squared_lengths`; 1 where all its vertices coincide."""
    size = squared.sqrt().mean(0)
    return torch.where(size > 0, size, 1)


def in_frames(vectors: Float[Tensor, "k 3 n"], axes: Float[Tensor, "3 3 n"]) -> Float[Tensor, "3*k n"]:
    """Coordinates of k vectors of each half-flap along its axes."""
    vectors = vectors[:, None]
    dots = vectors[:, :, 0] * axes[:, 0]
    for k in (1, 2):
        dots.addcmul_(vectors[:, :, k], axes[:, k])
    return dots.flatten(0, 1)


def star_sums(
    groups: FlapGroups, positions: Float[Tensor, "nV 3"], relative: bool = False, framed: bool = False
) -> Float[Tensor, "nV 4"] | Float[Tensor, "nV 11"]:
    """Over the half-flaps of each vertex: of the vectors to its neighbours (3), and of their lengths (if `relative`) or
    their number; if `framed`, of the frames' z (3), and, as constants, the first four `turn_sums`.

    A boundary vertex counts the reflected vertices of `edge_vectors` among its neighbours.  `compiled.star_sums` does
    the same on a CPU, faster.
    """
    parts, positions = [], by_columns(positions)
    for part in groups.chunks():
        edges = edge_vectors(part, positions)
        use = torch.ones_like(edges[:, :1])
        if part.missing is not None:
            use[1:] = part.missing[:, None]
            near = edges
        else:
            near, use = edges[:1], use[:1]
        rows = [(near * use).sum(0), (use * root(near.square().sum(1, keepdim=True)) if relative else use).sum(0)]
        if framed:
            axes, defined = local_frames(edges)
            rows.append(torch.where(defined, axes[2], 0))
        sums = pool(part, torch.cat(rows).T.contiguous())
        if framed:
            sums = torch.cat([sums, turn_sums(part, edges.detach(), axes.detach())[:4].T], dim=1)
        parts.append(sums)
    return torch.cat(parts)


def differential_coordinates(stars: Float[Tensor, "nV 4"] | Float[Tensor, "nV 11"]) -> Float[Tensor, "nV 3"]:
    """Each vertex minus the mean of its neighbours, from its `star_sums`; if they are `relative`, in units of the mean
    length of its edges.

    On a straight border of a regular flat patch a vertex then has none, like one inside, and the border is not drawn
    inwards.
    """
    return -stars[:, :3] / stars[:, 3:4].clamp(min=torch.finfo(stars.dtype).tiny)


def vertex_normals(stars: Float[Tensor, "nV 11"]) -> Float[Tensor, "nV 3"]:
    """The direction of the sum of z over a vertex's half-flaps; zero where they cancel."""
    return unit(stars[:, 4:7].T, 1.0)[0].T


def vertex_turns(stars: Float[Tensor, "nV 11"], count: Int[Tensor, " nV"]) -> Float[Tensor, "nV 4"]:
    """The first four of the `turns`."""
    return turns(stars[:, 7:].T, count)[:TURNS].T


def turn_sums(
    groups: FlapGroups, edges: Float[Tensor, "3 3 n"], axes: Float[Tensor, "3 3 n"]
) -> Float[Tensor, "7 m"]:
    """Sums over each group's half-flaps of s, of its square, cube and fourth power, and of s x: s is the sine of half
    the angle between the normals of an edge's two faces, x the edge's direction.

    An edge with a face without area does not turn, nor does one that is folded shut.
    """
    sideways, up = (edges[1:] * axes[1]).sum(1).square(), (edges[1:] * axes[2]).sum(1).square()
    squared = (up / (sideways + up).clamp(min=torch.finfo(up.dtype).tiny)).amin(0)  # alike where both faces have areas
    s = squared.sqrt()
    return pool(groups, torch.stack([s, squared, squared * s, squared.square(), *(s * axes[0])], dim=1)).T


def turns(
    sums: Float[Tensor, "7 m"] | Float[Tensor, "4 m"], count: Int[Tensor, " m"]
) -> Float[Tensor, "5 m"]:
    """At how many of a vertex's edges the surface turns, and how far; from their `turn_sums` and number.

    With e1 .. e4 the elementary symmetric polynomials of a vertex's s: their mean, e2 / e1, e3 / e2 and e4 / e3.  Each
    ratio is about the sum of all s but the one, two, three largest, where these are much larger.  So the third number
    is zero on a sharp edge between flat faces, where the surface turns at two edges, and the fourth at a corner of
    three such faces.
    The fifth is the length of the sum of s x, if that is given, over that of s: zero where the edges that turn lead on
    straight, the sine of half the bend of two that do not.
    """
    p1, p2, p3, p4 = sums[:4]
    least = torch.finfo(p1.dtype).tiny
    e2 = (p1 * p1 - p2) / 2  # from the sums of powers, by Newton's identities
    e3 = (e2 * p1 - p1 * p2 + p3) / 3
    e4 = (e3 * p1 - e2 * p2 + p1 * p3 - p4) / 4
    rounding = CANCELLED * p1
    ratios = e2 / (p1 + least), e3 / (e2 + rounding * p1 + least), e4 / (e3 + rounding * p1.square() + least)
    bend = sums[4:].square().sum(0).sqrt() / (p1 + least)
    return torch.stack([p1 / count, *(ratio.clamp(min=0) for ratio in ratios), bend])
