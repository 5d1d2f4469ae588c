"""The kernels' door: what half-flaps say, on a CPU, as a function of tensors with its gradients."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
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
from neusub.compilation import announce
from neusub.configuration import Architecture
from neusub.flaps import FlapGroups

__all__ = ["Layers", "Measuring", "Said", "said", "serves"]

ENOUGH = 50_000  # half-flaps for which the kernels are worth their compilation, where nothing is learned
PART = 4096  # half-flaps that are worth a thread
ROWS = 128  # half-flaps of a block, at most; more where one vertex has more
PRODUCT = 1 << 18  # multiplications of a product of matrices that BLAS does in the thread that asks

Measuring = Literal["all", "no turning"] | None  # which `Measures` are wanted


class Layers(NamedTuple):
    """A module's weights and biases; the first layer's without its columns for features."""

    first: Float[Tensor, "width 9+12*k"]  # edges, then vectors of the corners
    first_bias: Float[Tensor, " width"]
    hidden: Float[Tensor, "width width"]
    hidden_bias: Float[Tensor, " width"]
    last: Float[Tensor, "3*j width"]  # vectors only, of which the first is the displacement
    last_bias: Float[Tensor, " 3*j"]


class Said(NamedTuple):
    """Sums over each group's half-flaps."""

    vectors: Float[Tensor, "m 3*j"]  # in the axes of the positions
    hidden: Float[Tensor, "m width"] | None  # the last hidden layer
    count: Float[Tensor, "m 1"]  # half-flaps that have a frame; at least 1
    measures: Measures | None


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
    to_size: np.floating  # from the sum of five lengths; 0 for a network that knows the scale
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
    table: Float[Tensor, "4*nV c"] | None, layers: Layers, plan: Architecture, learns: bool, measures: Measuring,
) -> Said:
    """As `network.said_by_tensors`."""
    vectors = positions.new_empty(len(positions), 0) if vectors is None else vectors
    table = positions.new_empty(0, plan.width) if table is None else table
    turning = measures == "all" and plan.sharp > 0
    spoken, hidden, count, rows = _Said.apply(groups, plan, learns, measures is not None, turning, positions, vectors,
                                              table, *layers)
    found = None if measures is None else Measures(rows[0], rows[1], rows[2], rows[3], rows[4:] if turning else None)
    return Said(spoken, hidden if learns else None, count, found)


class _Said(torch.autograd.Function):
    @staticmethod
    def forward(ctx, groups: FlapGroups, plan: Architecture, learns: bool, measures: bool, turning: bool,
                *tensors: Tensor):
        """tensors: positions, vectors, table, then the layers."""
        from neusub import kernel_frames, kernels

        announce(kernels.forwards, "the network's kernels")
        m, positions = len(groups.offsets) - 1, tensors[0]
        fixed = given_to_kernels(groups, plan, tensors)
        n_measures = measures * kernel_frames.MEASURES + turning * kernel_frames.TURNING
        results = [positions.new_empty(size) for size in (
            (m, len(tensors[-1])), (m, plan.width if learns else 0), (m, 1), (n_measures, m))]
        in_parts(kernels.forwards, fixed, m, len(groups.corners), *map(array, results))
        ctx.groups, ctx.plan = groups, plan
        ctx.save_for_backward(*tensors)
        ctx.mark_non_differentiable(*results[2:])
        return tuple(results)

    @staticmethod
    @once_differentiable
    def backward(ctx, of_vectors, of_hidden, *_):  # type: ignore[override]
        from neusub import kernels

        announce(kernels.backwards, "the network's kernels for learning")
        groups = ctx.groups
        fixed = given_to_kernels(groups, ctx.plan, ctx.saved_tensors)
        shape, weights = fixed[:2]
        reads = any(ctx.needs_input_grad[5:7])
        n, m, dtype = len(shape.corners), len(shape.offsets) - 1, shape.positions.dtype
        of_corners = np.empty((4 * n if reads else 0, 3 + shape.vectors.shape[1]), dtype)
        of_before = np.empty((n, shape.table.shape[1]), dtype)
        shares = in_parts(kernels.backwards, (*fixed, reads), m, n, array(of_vectors), array(of_hidden),
                          of_corners.reshape(-1, 4 * of_corners.shape[1]), of_before,
                          own=lambda: Layers(*map(np.zeros_like, weights)))
        of_weights = Layers(*map(sum, zip(*shares)))  # type: ignore[arg-type]
        order, _, starts = map(array, groups.readers)

        def summed(values: ndarray, rows: int, stride: int) -> Tensor:
            sums = np.zeros((rows, values.shape[1]), dtype)
            in_parts(kernels.sum_corners, (values, order, starts, stride), (len(starts) - 1) // stride, n, sums)
            return torch.from_numpy(sums)

        of_positions = of_vectors = of_table = None
        if reads:
            of_positions, of_vectors = summed(of_corners, len(shape.positions), 4).tensor_split([3], dim=1)
        if len(shape.table):
            of_table = summed(of_before, len(shape.table), 1)
        return None, None, None, None, None, of_positions, of_vectors, of_table, *map(torch.from_numpy, of_weights)


def given_to_kernels(groups: FlapGroups, plan: Architecture, tensors: Sequence[Tensor]) -> tuple:
    """What kernels are given first: the shape, the layers, the same transposed, constants, and the rows of a block."""
    arrays = [array(tensor) for tensor in tensors]
    missing = np.empty((2, 0), bool) if groups.missing is None else array(groups.missing)
    layers = Layers(*arrays[3:])  # type: ignore[arg-type]
    transposed = Layers(*(np.ascontiguousarray(value.T) for value in layers))  # type: ignore[arg-type]
    rows = max(int(groups.offsets.diff().max()), min(ROWS, PRODUCT // (plan.width * max(layers.first.shape))))
    return (Shape(arrays[0], arrays[1], arrays[2], array(groups.corners), missing, array(groups.offsets)), layers,
            transposed, constants_of(tensors[0].dtype, plan.relative, plan.activation == "silu"), rows)


def array(tensor: Tensor) -> ndarray:
    return tensor.detach().contiguous().numpy()


@cache
def constants_of(dtype: torch.dtype, is_relative: bool, is_silu: bool) -> Constants:
    kind, terms = (np.float32, 8) if dtype == torch.float32 else (np.float64, 14)
    limit = np.finfo(kind)
    powers = [log(2) ** k / factorial(k) for k in reversed(range(terms))]
    return Constants(
        one=kind(1), rounding=kind((16 * limit.eps) ** 2), tiny=limit.tiny, to_size=kind(is_relative / 5),
        is_silu=is_silu, powers=tuple(map(kind, powers)), log2_e=kind(1 / log(2)),
        magic=kind(1.5 * 2.0**limit.nmant), largest=kind(-limit.minexp - 1))


@cache
def threads_of(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count)


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
        for task in [threads_of(torch.get_num_threads()).submit(kernel, *call) for call in calls]:
            task.result()
    return owned
