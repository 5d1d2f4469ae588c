"""Freed memory that stays with the process, to be taken again."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["freed_memory_kept"]

LARGE = 1_000_000  # faces from which it is worth it

TRIM_THRESHOLD, MMAP_THRESHOLD, MMAP_MAX = -1, -3, -4  # of glibc's mallopt
LARGEST_THRESHOLD = 32 << 20  # that glibc comes to by itself, once a block of that size was freed


@contextmanager
def freed_memory_kept(faces: int) -> Iterator[None]:
    """Where there are many faces: what is freed within goes back to the system at the end only.

    Layers of large meshes come and go by the gigabyte, and the system clears every page that it gives: up to a quarter
    of the time of sixteen million faces.  Linux with glibc only, and the main thread; elsewhere nothing happens.
    """
    libc = ctypes.CDLL(None) if sys.platform == "linux" and faces >= LARGE else None
    if libc is None or not hasattr(libc, "mallopt"):
        yield
        return
    libc.mallopt(MMAP_MAX, 0)
    libc.mallopt(TRIM_THRESHOLD, -1)
    try:
        yield
    finally:
        libc.mallopt(MMAP_MAX, 65536)
        libc.mallopt(MMAP_THRESHOLD, LARGEST_THRESHOLD)
        libc.mallopt(TRIM_THRESHOLD, 2 * LARGEST_THRESHOLD)
        libc.malloc_trim(0)
