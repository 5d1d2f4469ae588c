"""The kernels' door: what half-flaps say, on a CPU, as a function of tensors with its gradients."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from math import factorial, log
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor
from torch.autograd.function import once_differentiable

from neusub.bounds import Measures
from neusub.compilation import ENOUGH, announce
from neusub.configuration import Architecture
from neusub.flaps import FlapGroups
from neusub.frames import rounding
from neusub.layers import Weights, columns, for_table

__all__ = ["Measuring", "Said", "said", "serves", "star_sums"]

PART = 4096  # half-flaps that are worth a thread
ROWS = 128  # half-flaps of a block, at most; more where one vertex has more
PRODUCT = 1 << 18  # multiplications of a product of matrices that BLAS does in the thread that asks

Measuring = Literal["all", "no turning"] | None  # which `Measures` are wanted


class Said(NamedTuple):
    """Means over each group's half-flaps that have a frame."""

    move: Float[Tensor, "m 3"]  # this and the vectors in the axes of the positions
    vectors: Float[Tensor, "m 3*k"] | None
    features: Float[Tensor, "m c"] | None
    measures: Measures | None


class Layers(NamedTuple):
    """What kernels take of `Weights`."""

    first: ndarray  # (width, 9 + 12 k): edges, then vectors of the corners
    first_bias: ndarray
    hidden: ndarray
    hidden_bias: ndarray
    last: ndarray  # (3 + 3 k, width), or (3, width) where only the displacement is asked for
    last_bias: ndarray


class Shape(NamedTuple):
    """What the half-flaps of a module look at."""

    positions: ndarray  # (nV, 3)
    vectors: ndarray  # (nV, 3 k), k may be 0
    table: ndarray  # (4 nV, width): a vertex's features through the first layer, by slot; (0, width): there are none
    corners: ndarray  # (n, 4) int64
    missing: ndarray  # (2, n) bool; (2, 0) for a closed mesh
    offsets: ndarray  # (m + 1,) int64


class Constants(NamedTuple):
    """Numbers of the arrays' type, with which arithmetic stays in it."""

    one: np.floating
    rounding: np.floating  # relative, of a squared length
    tiny: np.floating  # the smallest normal number
    fifth: np.floating
    is_relative: bool  # whether lengths are in units of the half-flap's
    is_silu: bool
    powers: tuple  # coefficients of the series of 2^x, highest first
    log2_e: np.floating
    magic: np.floating  # a number that it is added to is rounded to an integer, which its last bits then hold
    largest: np.floating  # power of two


def serves(groups: FlapGroups, positions: Tensor, weights: Tensor) -> bool:
    """Whether `said` is to be taken: always for learning on a CPU, else for meshes of some size."""
    return (positions.device.type == "cpu" and positions.dtype in (torch.float32, torch.float64)
            and positions.dtype == weights.dtype and not torch.is_autocast_enabled("cpu")
            and (torch.is_grad_enabled() or len(groups.corners) >= ENOUGH))


def said(
    groups: FlapGroups, positions: Float[Tensor, "nV 3"], vectors: Float[Tensor, "nV 3*k"] | None,
    features: Float[Tensor, "nV c"] | None, weights: Weights, plan: Architecture, learns: bool, measures: Measuring,
) -> Said:
    """As `network.said_by_tensors`."""
    vectors, features = (positions.new_empty(len(positions), 0) if x is None else x for x in (vectors, features))
    turning = measures == "all" and plan.sharp > 0
    move, told, learned, rows = _Said.apply(groups, plan, learns, measures is not None, turning, positions, vectors,
                                            features, *weights)
    found = None if measures is None else Measures(rows[0], rows[1], rows[2], rows[3], rows[4:] if turning else None)
    return Said(move, told if told.shape[1] else None, learned if learns else None, found)


def star_sums(
    groups: FlapGroups, positions: Float[Tensor, "nV 3"], relative: bool, framed: bool
) -> Float[Tensor, "nV 4"] | Float[Tensor, "nV 11"]:
    """As `frames.star_sums`, as constants."""
    from neusub.kernel_frames import sum_stars

    announce(sum_stars, "the network's kernels")
    sums = positions.new_empty(len(positions), 11 if framed else 4)
    none = array(positions.new_empty(0, 0))
    fixed = Shape(array(positions), none, none, *groups.arrays), constants_of(positions.dtype, relative, False)
    in_parts(sum_stars, fixed, len(sums), len(groups.corners), array(sums))
    return sums


class _Said(torch.autograd.Function):
    @staticmethod
    def forward(ctx, groups: FlapGroups, plan: Architecture, learns: bool, measures: bool, turning: bool,
                positions: Tensor, vectors: Tensor, features: Tensor, *tensors: Tensor):
        from neusub import kernel_frames, kernels

        announce(kernels.forwards, "the network's kernels")
        m, weights, asked = len(groups.offsets) - 1, Weights(*tensors), 3 + 3 * plan.vectors * learns
        table = positions.new_empty(0, plan.width)
        if features.shape[1]:
            table = features @ for_table(weights.first, features.shape[1], vectors.shape[1]).T
            table = table.view(-1, plan.width)
        fixed = given_to_kernels(groups, plan, positions, vectors, features, table, weights, asked)
        n_measures = measures * kernel_frames.MEASURES + turning * kernel_frames.TURNING
        told, hidden, count, rows = results = [positions.new_empty(size) for size in (
            (m, asked), (m, plan.width if learns else 0), (m, 1), (n_measures, m))]
        in_parts(kernels.forwards, fixed, m, len(groups.corners), *map(array, results))
        learned = hidden
        if learns:  # the last layer is linear: the mean of its features is its value at the mean
            learned = torch.addmm(weights.last_bias[asked:], hidden, weights.last[asked:].T)
        ctx.groups, ctx.plan, ctx.learns = groups, plan, learns
        ctx.save_for_backward(positions, vectors, features, table, hidden, count, *tensors)
        ctx.mark_non_differentiable(rows)
        return told[:, :3], told[:, 3:], learned, rows

    @staticmethod
    @once_differentiable
    def backward(ctx, of_move, of_told, of_learned, _):  # type: ignore[override]
        from neusub import kernels

        announce(kernels.backwards, "the network's kernels for learning")
        positions, vectors, features, table, hidden, count, *tensors = ctx.saved_tensors
        groups, plan, weights = ctx.groups, ctx.plan, Weights(*tensors)
        of_weights = Weights(*map(torch.zeros_like, weights))
        asked, of_hidden = 3 + of_told.shape[1], hidden
        if ctx.learns:
            of_hidden = (of_learned @ weights.last[asked:]) / count
            of_weights.last[asked:] = of_learned.T @ hidden
            of_weights.last_bias[asked:] = of_learned.sum(0)
        fixed = given_to_kernels(groups, plan, positions, vectors, features, table, weights, asked)
        reads, n = any(ctx.needs_input_grad[5:7]), len(groups.corners)
        of_corners = positions.new_empty(4 * n if reads else 0, 3 + vectors.shape[1])
        of_before = positions.new_empty(n, plan.width)
        shares = in_parts(kernels.backwards, (*fixed, reads), len(hidden), n,
                          array(torch.cat([of_move, of_told], 1) / count), array(of_hidden),
                          array(of_corners.view(-1, 4 * of_corners.shape[1])), array(of_before),
                          own=lambda: Layers(*map(np.zeros_like, fixed[1])))
        of_layers = Layers(*map(sum, zip(*shares)))  # type: ignore[arg-type]
        order, _, starts = map(array, groups.readers)

        def summed(values: Tensor, rows: int, stride: int) -> Tensor:
            sums = values.new_zeros(rows, values.shape[1])
            in_parts(kernels.sum_corners, (array(values), order, starts, stride), (len(starts) - 1) // stride, n,
                     array(sums))
            return sums

        of_positions = of_vectors = of_features = None
        if reads:
            of_positions, of_vectors = summed(of_corners, len(positions), 4).tensor_split([3], dim=1)
        local, corners = columns(features.shape[1], vectors.shape[1])
        if features.shape[1]:
            of_table = summed(of_before, 4 * len(positions), 1).view(len(positions), -1)
            if ctx.needs_input_grad[7]:
                of_features = of_table @ for_table(weights.first, features.shape[1], vectors.shape[1])
            of_weights.first[:, corners] = (of_table.T @ features).view(4, plan.width, -1).transpose(0, 1).flatten(1)
        of_weights.first[:, local] = torch.from_numpy(of_layers.first)
        for part, asked_for in zip(of_weights[1:], of_layers[1:]):  # of the last layer the first rows
            part[: len(asked_for)] = torch.from_numpy(asked_for)
        return None, None, None, None, None, of_positions, of_vectors, of_features, *of_weights


def given_to_kernels(groups: FlapGroups, plan: Architecture, positions: Tensor, vectors: Tensor, features: Tensor,
                     table: Tensor, weights: Weights, asked: int) -> tuple:
    """What kernels are given first: the shape, the layers (`asked` rows of the last one), the same transposed,
    constants, and the rows of a block."""
    first = weights.first.detach().index_select(1, columns(features.shape[1], vectors.shape[1])[0])
    layers = Layers(*map(array, (first, *weights[1:4], weights.last[:asked], weights.last_bias[:asked])))
    transposed = Layers(*(np.ascontiguousarray(value.T) for value in layers))
    rows = max(groups.largest, min(ROWS, PRODUCT // (plan.width * max(layers.first.shape))))
    return (Shape(array(positions), array(vectors), array(table), *groups.arrays), layers, transposed,
            constants_of(positions.dtype, plan.relative, plan.activation == "silu"), rows)


def array(tensor: Tensor) -> ndarray:
    return tensor.detach().contiguous().numpy()


@cache
def constants_of(dtype: torch.dtype, is_relative: bool, is_silu: bool) -> Constants:
    kind, terms = (np.float32, 8) if dtype == torch.float32 else (np.float64, 14)
    limit = np.finfo(kind)
    powers = [log(2) ** k / factorial(k) for k in reversed(range(terms))]
    return Constants(
        one=kind(1), rounding=kind(rounding(torch.finfo(dtype))), tiny=limit.tiny, fifth=kind(1 / 5),
        is_relative=is_relative, is_silu=is_silu, powers=tuple(map(kind, powers)), log2_e=kind(1 / log(2)),
        magic=kind(1.5 * 2.0**limit.nmant), largest=kind(-limit.minexp - 1))


@cache
def workers() -> ThreadPoolExecutor:
    """As many as there are cores: for all threads that call kernels, each of which has its own number of torch's."""
    return ThreadPoolExecutor(os.cpu_count())


def in_parts(kernel: Callable, fixed: tuple, count: int, half_flaps: int, *results: ndarray,
             own: Callable[[], Any] | None = None) -> list:
    """kernel(*fixed, first, last, *results[, own()]) for runs of 0 .. count - 1, one in each of torch's threads if
    there are half-flaps enough; what each had of its own."""
    parts = min(torch.get_num_threads(), half_flaps // PART + 1)
    stops = [count * k // parts for k in range(parts + 1)]
    owned = [own() for _ in range(parts)] if own else []
    calls = [(*fixed, a, b, *results, *owned[k : k + 1]) for k, (a, b) in enumerate(itertools.pairwise(stops))]
    if parts == 1:
        kernel(*calls[0])
    else:
        for task in [workers().submit(kernel, *call) for call in calls]:
            task.result()
    return owned
