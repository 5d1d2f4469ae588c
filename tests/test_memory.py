"""Memory that is kept while a large mesh is refined, and given back."""

import ctypes
import subprocess
import sys

import numpy as np
import pytest

import neusub.memory
import shapes
from neusub import Mesh, Subdivider

glibc = pytest.mark.skipif(sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "gnu_get_libc_version"),
                           reason="glibc only")

# In a process of its own: a thread whose request once failed takes memory elsewhere.
BEGINNING = """
import ctypes, resource
from pathlib import Path
from neusub.memory import freed_memory_kept

libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes, libc.free.argtypes = ctypes.c_void_p, [ctypes.c_size_t], [ctypes.c_void_p]

def faults():  # pages that the system gives for 64 MiB
    before, size = resource.getrusage(resource.RUSAGE_SELF).ru_minflt, 64 << 20
    block = libc.malloc(size)
    ctypes.memset(block, 1, size)
    libc.free(block)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()

"""


def run(script: str) -> None:
    ended = subprocess.run([sys.executable, "-c", BEGINNING + script], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr


@glibc
def test_freed_memory_is_taken_again_and_given_back_at_the_end():
    run("""
with freed_memory_kept(faces=1):  # too few
    faults()
    assert faults() > 100
with freed_memory_kept(faces=10**9):
    with freed_memory_kept(faces=10**9):
        faults()
    assert faults() < 10
    kept = resident()
assert resident() < kept - (60 << 20)
assert faults() > 100
""")


@glibc
def test_an_error_gives_it_back_too():
    run("""
try:
    with freed_memory_kept(faces=10**9):
        faults()
        assert faults() < 10
        1 / 0
except ZeroDivisionError:
    assert faults() > 100
""")


def test_results_are_the_same(monkeypatch):
    mesh, model = Mesh(*shapes.torus(9, 7)), Subdivider.load(device="cpu")
    once = model.subdivide(mesh)
    monkeypatch.setattr(neusub.memory, "LARGE", 1)
    for a, b in zip(once, model.subdivide(mesh)):
        np.testing.assert_array_equal(a.vertices, b.vertices)
