"""Memory that is kept while a large mesh is refined, and given back."""

import ctypes
import resource
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import neusub.memory
import shapes
from neusub import Mesh, Subdivider
from neusub.memory import freed_memory_kept

glibc = pytest.mark.skipif(sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "mallopt"), reason="glibc only")


def faults_of_a_block() -> int:
    """Pages that the system has to give for 64 MiB."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    torch.ones(16 << 20)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


def resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


@glibc
def test_freed_memory_is_taken_again_and_given_back_at_the_end():
    with freed_memory_kept(faces=1):  # too few
        faults_of_a_block()
        assert faults_of_a_block() > 100
    with freed_memory_kept(faces=10**9):
        faults_of_a_block()
        assert faults_of_a_block() < 10
        kept = resident()
    assert resident() < kept - (60 << 20)
    assert faults_of_a_block() > 100


@glibc
def test_an_error_gives_it_back_too():
    with pytest.raises(ZeroDivisionError), freed_memory_kept(faces=10**9):
        faults_of_a_block()
        1 / 0  # noqa: B018
    assert faults_of_a_block() > 100


def test_results_are_the_same(monkeypatch):
    mesh, model = Mesh(*shapes.torus(9, 7)), Subdivider.load(device="cpu")
    once = model.subdivide(mesh)
    monkeypatch.setattr(neusub.memory, "LARGE", 1)
    for a, b in zip(once, model.subdivide(mesh)):
        np.testing.assert_array_equal(a.vertices, b.vertices)
