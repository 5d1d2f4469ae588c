"""Threads of the CPU in a training: torch's own, and those that share the meshes of a batch."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import torch

from neusub.configuration import TrainingConfig

__all__ = ["Map", "in_threads", "some_threads", "workers_of"]

Map = Callable[..., Iterable]  # as `map`


@contextmanager
def some_threads(count: int) -> Iterator[None]:
    """As many of torch's threads for a while, or as many as there are for 0."""
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def workers_of(config: TrainingConfig, device: torch.device) -> int:
    """Threads that share the meshes of a batch.  Most operations on a mesh of some hundred faces are too short to be
    shared themselves."""
    alone = device.type != "cpu" or not config.is_single
    return 1 if alone else min(torch.get_num_threads(), config.batch)


@contextmanager
def in_threads(count: int) -> Iterator[Map]:
    """A `map` that so many threads share.  Each has its part of torch's threads, and so has the caller meanwhile, whose
    own would spin while they wait for more."""
    if count == 1:
        yield map
        return
    threads = torch.get_num_threads()
    part = threads // count
    torch.set_num_threads(part)
    try:
        with ThreadPoolExecutor(count, initializer=torch.set_num_threads, initargs=(part,)) as pool:
            yield pool.map
    finally:
        torch.set_num_threads(threads)
