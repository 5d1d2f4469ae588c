"""Bounds on a trained network's displacements, for meshes unlike anything that it was trained on.  Not in the paper."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from neusub.flaps import FlapGroups, pool

__all__ = ["bounded", "flattened", "heights_of"]

NOTHING = 1e-6  # a bound below this, of a mesh at the training's scale, is that of a flat patch


def heights_of(groups: FlapGroups, edges: Float[Tensor, "3 3 n"], axes: Float[Tensor, "3 3 n"]) -> Float[Tensor, " m"]:
    """How far the surface around each vertex is from flat: the largest height of v2 or v3 over the frame's plane."""
    heights = (edges[1:] * axes[2]).sum(1).abs().amax(0)
    return torch.segment_reduce(heights, "max", offsets=groups.offsets)


def flattened(
    heights: Float[Tensor, " m"], groups: FlapGroups, size: Float[Tensor, " n"], flat: float
) -> Float[Tensor, " m"]:
    """A factor of displacements: h / (h + flat), with the height h in mean edges of the group's half-flaps.

    From level to level the edges of a smooth surface halve, and heights and true displacements go down to a quarter.
    What is wrong in a displacement stays in proportion to the edge, though, and makes the surface rougher, the deeper
    the level; with this factor it goes down too.
    """
    edge = pool(groups, size[:, None])[:, 0] / groups.offsets.diff().to(size.dtype)
    return heights / (heights + flat * edge)


def bounded(
    move: Float[Tensor, "m 3"], groups: FlapGroups, edges: Float[Tensor, "3 3 n"], heights: Float[Tensor, " m"],
    bound: tuple[float, float],
) -> Float[Tensor, "m 3"]:
    """Displacements shorter than bound[0] times the shortest edge of their half-flaps, and bound[1] times the height.

    Smoothly: with x the length over its bound, it is divided by (1 + x^4)^(1/4), which is nearly 1 below a half.

    Weights that never saw a thin triangle or a short edge would displace by more than the edge and fold the surface; on
    a flat patch they leave a ripple.  Networks that are trained within wide bounds lose nothing by tighter ones in use:
    `docs/research.md` has the numbers.
    """
    e1, e2, e3 = edges
    squared = torch.stack([e1, e2, e3, e2 - e1, e3 - e1]).square().sum(1).amin(0)
    shortest = torch.segment_reduce(squared, "min", offsets=groups.offsets).sqrt()
    limit = torch.minimum(bound[0] * shortest, bound[1] * heights)
    ratio = move.square().sum(1) / limit.clamp(min=NOTHING).square()
    return move * ((1 + ratio.square()) ** -0.25 * (limit / NOTHING).clamp(max=1))[:, None]
