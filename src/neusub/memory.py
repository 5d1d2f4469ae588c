"""Freed memory that stays with the process, to be taken again."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

__all__ = ["freed_memory_kept"]

LARGE = 1_000_000  # faces from which it is worth it

TRIM_THRESHOLD, MMAP_THRESHOLD, MMAP_MAX = -1, -3, -4  # of glibc's mallopt
LARGEST_THRESHOLD = 32 << 20  # that glibc comes to by itself, once a block of that size was freed

_users, _lock = 0, Lock()


@contextmanager
def freed_memory_kept(faces: int) -> Iterator[None]:
    """Where there are many faces: what is freed within goes back to the system at the end only.

    Layers of large meshes come and go by the gigabyte, and the system clears every page that it gives.  With glibc
    only; elsewhere nothing happens.  It is a setting of the process: while it lasts no thread's memory goes back, and
    afterwards glibc has the thresholds that it adapts to where large blocks are freed, whatever they were before.
    """
    libc = ctypes.CDLL(None) if sys.platform == "linux" and faces >= LARGE else None
    if libc is None or not hasattr(libc, "gnu_get_libc_version"):
        yield
        return
    _count(libc, 1)
    try:
        yield
    finally:
        _count(libc, -1)


def _count(libc: ctypes.CDLL, step: int) -> None:
    """The first user keeps, the last one gives back."""
    global _users
    with _lock:
        _users += step
        if step > 0 and _users == 1:
            libc.mallopt(MMAP_MAX, 0)
            libc.mallopt(TRIM_THRESHOLD, -1)
        elif _users == 0:
            libc.mallopt(MMAP_MAX, 65536)
            libc.mallopt(MMAP_THRESHOLD, LARGEST_THRESHOLD)
            libc.mallopt(TRIM_THRESHOLD, 2 * LARGEST_THRESHOLD)
            libc.malloc_trim(0)
