"""What fits into memory, and freed memory that stays with the process, to be taken again."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock

from neusub.errors import TooLargeError

__all__ = ["check_fits", "freed_memory_kept"]

LARGE = 1_000_000  # faces from which it is worth it

TRIM_THRESHOLD, MMAP_THRESHOLD, MMAP_MAX = -1, -3, -4  # of glibc's mallopt
LARGEST_THRESHOLD = 32 << 20  # that glibc comes to by itself, once a block of that size was freed

FACE = 200  # bytes of memory for each face of the last level, at least: its corners, vertices, edges; and levels before

_users, _lock = 0, Lock()


def check_fits(faces: int, levels: int) -> None:
    """Raises TooLargeError where so many levels of refinement cannot fit into the memory of the machine."""
    needed, available = faces * 4 ** max(levels, 0) * FACE, memory_size()
    if available is not None and needed > available:
        raise TooLargeError(f"{faces:,} faces at {levels} levels are {float(faces * 4**levels):.3g}, which take more "
                            f"than {needed / 2**30:.3g} GiB; this machine has {available / 2**30:.3g}. Take fewer "
                            "levels.")


def memory_size() -> int | None:
    """Bytes of memory that this process may have; None where the system does not tell."""
    try:
        sizes = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    except (AttributeError, ValueError, OSError):
        return None
    limit = Path("/sys/fs/cgroup/memory.max")  # of a container
    if limit.is_file() and (text := limit.read_text().strip()).isdigit():
        sizes.append(int(text))
    return min(sizes)


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
