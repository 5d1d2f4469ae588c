"""A module's layers, and how the columns of the first one are ordered: for the kernels and for the tensors."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["Weights", "columns", "for_table"]


class Weights(NamedTuple):
    """Of a module whose corners bring c features and k vectors.

    The first layer's columns go vertex by vertex: features of v0, vectors of v0, e1, those of v1, e2, those of v2, e3,
    those of v3; the last layer's rows: displacement, vectors, features.
    """

    first: Float[Tensor, "width 9+4*(c+3*k)"]
    first_bias: Float[Tensor, " width"]
    hidden: Float[Tensor, "width width"]
    hidden_bias: Float[Tensor, " width"]
    last: Float[Tensor, "3+3*k+c width"]
    last_bias: Float[Tensor, " 3+3*k+c"]


@cache
def columns(features: int, coordinates: int, device: torch.device | str = "cpu") -> tuple[Tensor, Tensor]:
    """Of the first layer, where a corner brings so many features and coordinates of vectors: its columns for edges and
    then for vectors, and those for features."""
    corner = features + coordinates
    with torch.inference_mode(False):  # or gradients could not go through what is kept
        starts = torch.arange(4, device=device)[:, None] * (corner + 3)
        of_features, of_vectors, of_edges = (starts + torch.arange(corner + 3, device=device)).tensor_split(
            [features, corner], dim=1)
        return torch.cat([of_edges[:3].flatten(), of_vectors.flatten()]), of_features.flatten()


def for_table(first: Tensor, features: int, coordinates: int) -> Float[Tensor, "4*width c"]:
    """What takes a vertex's features through the first layer: into a row for each corner that it may be."""
    corners = first.index_select(1, columns(features, coordinates, first.device)[1])
    return corners.view(len(first), 4, features).transpose(0, 1).reshape(4 * len(first), features)
