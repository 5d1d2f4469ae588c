"""Half-flaps on the device, grouped by what pools them, and the three sums over them that the network is made of.

A gather or a pooling is a sum over bags of rows; its gradient is the same sum over the transposed bags, kept with the
groups.  On a CPU this is several times faster than indexing, whose gradient adds row by row.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import embedding_bag

from neusub.compilation import ENOUGH
from neusub.topology import Topology, counting_order

__all__ = ["FlapGroups", "LevelFlaps", "by_columns", "extremes", "gather_corners", "level_flaps", "means_of_ends",
           "pool", "sum_slots", "worth_kernels"]

CHUNK = 1 << 20  # numbers of one layer at a time without gradients, on a CPU: they stay in the cache
GPU_CHUNK = 1 << 26  # a quarter of a gigabyte


@dataclass(frozen=True, eq=False)
class FlapGroups:
    """Half-flaps sorted by the vertex or edge that pools them: group i owns rows offsets[i] .. offsets[i + 1]."""

    corners: Int[Tensor, "n 4"]  # v0 v1 v2 v3; at a boundary the missing one repeats the other
    missing: Bool[Tensor, "2 n"] | None  # whether v2, v3 is missing; None for a closed mesh
    offsets: Int[Tensor, " m+1"]

    @cached_property
    def slots(self) -> Int[Tensor, "n 4"]:
        """Row of (vertex, slot) in a table with four rows a vertex."""
        return self.corners * 4 + torch.arange(4, device=self.corners.device)

    def chunks(self, width: int = 32) -> Iterator[FlapGroups]:
        """The groups in runs of half-flaps whose layers of that width have about CHUNK numbers; in a recording
        (`recording.py`) all at once, for where a run ends is asked of the device."""
        on_gpu = self.corners.is_cuda
        rows_at_once = (GPU_CHUNK if on_gpu else CHUNK) // width
        if len(self.corners) <= rows_at_once or (on_gpu and torch.cuda.is_current_stream_capturing()):
            yield self
            return
        last = len(self.offsets) - 1
        a = 0
        while a < last:
            start = int(self.offsets[a])
            b = int(torch.searchsorted(self.offsets, start + rows_at_once, right=True)) - 1
            b = min(max(b, a + 1), last)
            rows = slice(start, int(self.offsets[b]))
            missing = None if self.missing is None else self.missing[:, rows]
            yield FlapGroups(self.corners[rows], missing, self.offsets[a : b + 1] - start)
            a = b

    @cached_property
    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """corners, missing (2, 0 for a closed mesh) and offsets, for kernels."""
        missing = np.empty((2, 0), bool) if self.missing is None else self.missing.contiguous().numpy()
        return self.corners.contiguous().numpy(), missing, self.offsets.contiguous().numpy()

    @cached_property
    def largest(self) -> int:
        """Half-flaps of the largest group."""
        return int(self.offsets.diff().max())

    def complete(self) -> None:
        """Make all that is kept for sums and their gradients, which otherwise is made when first needed."""
        for name in ("slots", "readers", "ones", "fours", "owner"):
            getattr(self, name)

    # Transposes, for gradients only: which rows read a given vertex, and which group reads a given row.

    @cached_property
    def readers(self) -> tuple[Tensor, Tensor, Tensor]:
        """Corners in the order of the rows of `slots` that they read, their half-flaps, and where each row begins."""
        flat = self.slots.reshape(-1)
        order = torch.argsort(flat)
        bounds = torch.arange(4 * int(self.corners.max()) + 5, device=flat.device)
        return order, order // 4, torch.searchsorted(flat[order], bounds)

    @cached_property
    def ones(self) -> Tensor:
        """0 .. 4 n: offsets of bags of one row."""
        return torch.arange(4 * len(self.corners) + 1, device=self.corners.device)

    @cached_property
    def fours(self) -> Tensor:
        """0, 4 .. 4 n: offsets of bags of one half-flap's corners."""
        return self.ones[::4].contiguous()

    @cached_property
    def owner(self) -> Int[Tensor, " n"]:
        return torch.repeat_interleave(torch.arange(len(self.offsets) - 1, device=self.offsets.device),
                                       self.offsets.diff())


@dataclass(frozen=True, eq=False)
class LevelFlaps:
    """One level's half-flaps: as its vertices pool them (I, V) and as its edges do (E)."""

    by_vertex: FlapGroups
    by_edge: FlapGroups
    edges: Int[Tensor, "nE 2"]
    topology: Topology

    def on_device(self, indices: np.ndarray) -> Tensor:
        """An array of the topology, to be read."""
        writable = np.require(indices, requirements="W")  # torch warns of what a mesh has frozen
        return torch.as_tensor(writable, device=self.edges.device)


def level_flaps(topology: Topology, device: torch.device | str = "cpu") -> LevelFlaps:
    """Put a level's half-flaps on a device, in both orders."""
    corners, absent = topology.flaps, None
    if topology.is_boundary_edge.any():
        absent = (corners[:, 2:] < 0).T
        corners = np.where(corners < 0, corners[:, [0, 1, 3, 2]], corners)
    by_origin = counting_order(corners[:, 0], topology.n_vertices)
    starts = np.concatenate([[0], np.cumsum(topology.valence)])

    def groups(corners, absent, offsets) -> FlapGroups:
        missing = None if absent is None else torch.as_tensor(np.ascontiguousarray(absent), device=device)
        return FlapGroups(torch.as_tensor(corners, device=device), missing, torch.as_tensor(offsets, device=device))

    return LevelFlaps(groups(np.take(corners, by_origin, axis=0),  # several times faster than corners[by_origin]
                             None if absent is None else absent[:, by_origin], starts),
                      groups(corners, absent, np.arange(0, len(corners) + 1, 2)),
                      torch.as_tensor(topology.edges, device=device), topology)


class _SumRows(torch.autograd.Function):
    """out[i] = sum of values[index[j]] over bag i; the gradient is the same sum over the transposed bags."""

    @staticmethod
    def forward(ctx, values, index, offsets, back_index, back_offsets):
        ctx.save_for_backward(back_index, back_offsets)
        ctx.rows = len(values)
        return embedding_bag(index, values, offsets, mode="sum", include_last_offset=True)

    @staticmethod
    def backward(ctx, grad):  # type: ignore[override]
        index, offsets = ctx.saved_tensors
        grad = embedding_bag(index, grad.contiguous(), offsets, mode="sum", include_last_offset=True)
        if len(grad) < ctx.rows:  # vertices beyond the last one that any half-flap reads
            grad = torch.cat([grad, grad.new_zeros(ctx.rows - len(grad), grad.shape[1])])
        return grad, None, None, None, None


def by_columns(values: Float[Tensor, "nV c"]) -> Float[Tensor, "nV c"]:
    """The same, one column after the other in memory: what `gather_corners` reads fastest without gradients."""
    return values if torch.is_grad_enabled() else values.T.contiguous().T


def gather_corners(groups: FlapGroups, values: Float[Tensor, "nV c"]) -> Float[Tensor, "4 c n"]:
    """values[corners], one contiguous row a corner and coordinate.  See `by_columns`, where it is called in chunks."""
    if values.requires_grad:
        order, _, starts = groups.readers
        rows = _SumRows.apply(values, groups.corners.reshape(-1), groups.ones, order, starts[::4])
        return rows.view(-1, 4, values.shape[1]).permute(1, 2, 0).contiguous()
    columns = values.T.index_select(1, groups.corners.T.reshape(-1))
    return columns.view(values.shape[1], 4, -1).transpose(0, 1)


def sum_slots(groups: FlapGroups, table: Float[Tensor, "4*nV c"]) -> Float[Tensor, "n c"]:
    """Sum over a half-flap's corners k of row 4 * corner + k."""
    if not table.requires_grad:
        return embedding_bag(groups.slots, table, mode="sum")
    _, readers, starts = groups.readers
    return _SumRows.apply(table, groups.slots.reshape(-1), groups.fours, readers, starts)


def pool(groups: FlapGroups, values: Float[Tensor, "n c"]) -> Float[Tensor, "m c"]:
    """Sum over each group."""
    rows = groups.ones[: len(values)]
    if not values.requires_grad:
        return embedding_bag(rows, values, groups.offsets, mode="sum", include_last_offset=True)
    return _SumRows.apply(values, rows, groups.offsets, groups.owner, groups.ones[: len(values) + 1])


def extremes(groups: FlapGroups, values: Float[Tensor, " n"], reduction: Literal["min", "max"]) -> Float[Tensor, " m"]:
    """The least or the largest of each group."""
    return torch.segment_reduce(values, reduction, offsets=groups.offsets)


def means_of_ends(level: LevelFlaps, values: Float[Tensor, "nV c"]) -> Float[Tensor, "nE c"]:
    """Of each edge."""
    if not values.requires_grad:
        return embedding_bag(level.edges, values, mode="sum") / 2  # three times faster
    return (values.index_select(0, level.edges[:, 0]) + values.index_select(0, level.edges[:, 1])) / 2


def worth_kernels(half_flaps: int, values: Tensor) -> bool:
    """Whether a kernel is to go over the values of a mesh with that many half-flaps: on a CPU, if there are enough of
    them to be worth its compilation."""
    return (values.device.type == "cpu" and values.dtype in (torch.float32, torch.float64) and half_flaps >= ENOUGH)
