"""Options of all compiled kernels, and a word to the user before one is compiled.

numba keeps what it compiled in `__pycache__`, and notices changes of a kernel's own file only: who edits a kernel that
others call removes that folder.
"""

from __future__ import annotations

import logging
from functools import cache
from pathlib import Path
from typing import Any

__all__ = ["ALLOCATES", "COMPILED", "CONTRACTED", "ENOUGH", "INNER", "ONCE", "announce",
           "say_that_it_compiles"]

# Most kernels allocate nothing, so numba need not count references to arrays (`_nrt`; counting took a third to a half
# of the time).  Then no array is assigned to a slice as a whole.  Divisions by zero give inf, as in numpy.
COMPILED = {"cache": True, "nogil": True, "no_cfunc_wrapper": True, "error_model": "numpy", "_nrt": False}
ALLOCATES = {**COMPILED, "_nrt": True}
# For kernels that only kernels call, which saves a third of the compilation.  Called from Python they crash.
INNER = {**COMPILED, "no_cpython_wrapper": True}
# For large kernels that one kernel calls: written into it, as a kernel's compilation goes over all that it calls again.
ONCE = {**INNER, "inline": "always"}
CONTRACTED = {"fastmath": {"contract"}}  # a product and a sum may be rounded once

ENOUGH = 50_000  # half-flaps of a mesh that are worth the compilation of the network's kernels


def announce(kernel: Any, what: str) -> None:
    """Say so where a kernel is about to be compiled, once on a machine, which takes some seconds; once of what belongs
    together."""
    if kernel.signatures:
        return
    module, source = kernel.py_func.__module__.rpartition(".")[2], Path(kernel.py_func.__code__.co_filename)
    kept = Path(kernel.stats.cache_path or ".").glob(f"{module}.{kernel.py_func.__name__}-*.nbi")
    if not any(index.stat().st_mtime >= source.stat().st_mtime for index in kept):
        say_that_it_compiles(what)


@cache
def say_that_it_compiles(what: str) -> None:
    logging.getLogger("neusub").warning(f"neusub: compiling {what}, once on this machine ...")
