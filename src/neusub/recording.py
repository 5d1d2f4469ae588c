"""Work on a GPU, recorded once and replayed.

A training step is one to four thousand kernels, each on a few thousand half-flaps.  To launch them one by one from
Python takes several times longer than to run them; a CUDA graph launches all at once.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence

import torch
from torch import Tensor

__all__ = ["Recorder", "copy_to", "has_room"]

ROOM = 0.25  # of a GPU's memory: what is left for the work itself


def has_room(device: torch.device) -> bool:
    """Whether more may be kept on a device: on a CPU always, on a GPU while ROOM of its memory is free."""
    if device.type != "cuda":
        return True
    free, total = torch.cuda.mem_get_info(device)
    return free > ROOM * total


class Recorder:
    """CUDA graphs of pieces of work that come again and again, each with a key.

    Work always reads and writes the same tensors, makes none that is kept (`FlapGroups.complete`), and never waits for
    the GPU (`frames.known_true`).  All graphs share one pool of memory, for none leaves anything there that another
    could overwrite: results are copied out.
    """

    def __init__(self, device: torch.device):
        self.stream, self.pool = torch.cuda.Stream(device), torch.cuda.graph_pool_handle()
        self.graphs: dict[Hashable, torch.cuda.CUDAGraph] = {}
        self.loss = torch.zeros((), device=device)  # where works may leave theirs

    def run(self, key: Hashable, work: Callable[[], Iterable[Tensor]], results: Sequence[Tensor],
            again: bool = True) -> Tensor:
        """Bring what `work` gives into `results`, whose first it returns.

        It is recorded the first time, unless it does not come `again` with the same tensors or there is no room.
        """
        current = torch.cuda.current_stream(self.stream.device)
        self.stream.wait_stream(current)
        with torch.cuda.stream(self.stream):
            if key not in self.graphs and not (again and has_room(self.stream.device)):
                copy_to(results, work())
            else:
                if not self.graphs:
                    tuple(work())  # libraries allocate what they need on a stream
                if key not in self.graphs:
                    self.graphs[key] = self._recorded(work, results)
                self.graphs[key].replay()
        current.wait_stream(self.stream)
        return results[0]

    def _recorded(self, work: Callable[[], Iterable[Tensor]], results: Sequence[Tensor]) -> torch.cuda.CUDAGraph:
        """Without torch.cuda.graph, which would empty all caches before each of some thousand recordings."""
        graph = torch.cuda.CUDAGraph()
        graph.capture_begin(pool=self.pool, capture_error_mode="thread_local")
        try:
            copy_to(results, work())
        finally:
            graph.capture_end()
        return graph


def copy_to(results: Sequence[Tensor], values: Iterable[Tensor]) -> None:
    """Each value into its place among the results."""
    for result, value in zip(results, values, strict=True):
        result.copy_(value)
