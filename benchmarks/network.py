"""Time and memory of the network: inference at 10,000 and (--large) 1,000,000 faces, an epoch of the paper's training.

The reference implementation is not installable; its times on another machine of this kind, quoted with each line, are
for orientation only.  Ratios within the run: two threads against one, batches against single meshes.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from neusub import PRESETS, Mesh, Subdivider, train
from neusub.flaps import level_flaps
from neusub.generation import Pair, save_pairs
from neusub.network import NeuralSubdivision
from neusub.topology import topology_levels


def torus(n: int, m: int) -> Mesh:
    """2 n m faces."""
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    u, v = 2 * np.pi * i / n, 2 * np.pi * j / m
    vertices = np.stack([(2 + np.cos(v)) * np.cos(u), (2 + np.cos(v)) * np.sin(u), np.sin(v)], -1).reshape(-1, 3)
    a, b = (i * m + j).ravel(), ((i + 1) % n * m + j).ravel()
    c, d = ((i + 1) % n * m + (j + 1) % m).ravel(), (i * m + (j + 1) % m).ravel()
    return Mesh(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


def best_of(work, repeats: int) -> float:
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return min(times)


def inference(large: bool) -> None:
    model = Subdivider.load(device="cpu")
    threads = torch.get_num_threads()
    mesh = torus(100, 50)
    seconds = {}
    for n in {1, threads}:
        torch.set_num_threads(n)
        seconds[n] = best_of(lambda: model.subdivide(mesh), 5)
        print(f"10,000 -> 160,000 faces, {n} thread(s): {seconds[n]:.3f} s   (reference 34 s topology + 0.4 s network)")
    print(f"ratio {threads} threads / 1: {seconds[threads] / seconds[1]:.2f}")
    if large:
        mesh = torus(1000, 500)
        took = best_of(lambda: model.subdivide(mesh), 1)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        print(f"1,000,000 -> 16,000,000 faces, {threads} thread(s): {took:.1f} s, peak memory {peak:.1f} GiB")


def architectures() -> None:
    """The networks alone as they are in use, one thread, on the half-flaps of two levels of 20,000 faces."""
    torch.set_num_threads(1)
    mesh = torus(100, 100)
    topologies, _ = topology_levels(mesh.faces, len(mesh.vertices), 2)
    flaps = [level_flaps(topology) for topology in topologies]
    positions = torch.tensor(mesh.vertices, dtype=torch.float32)
    count = 2 * (len(topologies[0].edges) + 2 * sum(len(topology.edges) for topology in topologies))
    networks, cost = {}, {}
    for preset in ("paper", "default"):
        config = PRESETS[preset]
        plan = config.for_use(config.levels)
        networks[preset] = NeuralSubdivision(plan).eval().requires_grad_(False)
    with torch.inference_mode():
        for _ in range(7):  # in turns, so that a machine that slows down does so for both
            for preset, network in networks.items():
                took = best_of(lambda network=network: network(positions, flaps), 1) / count
                cost[preset] = min(cost.get(preset, took), took)
    print(f"a half-flap through the paper's network {1e9 * cost['paper']:.0f} ns, through the default one "
          f"{1e9 * cost['default']:.0f} ns: ratio {cost['default'] / cost['paper']:.2f}")


def pairs_of(levels: int) -> list[Pair]:
    """Ten pairs of 590 faces whose targets are midpoints."""
    pairs = []
    for _ in range(10):
        mesh = torus(59, 5)
        topologies, _ = topology_levels(mesh.faces, len(mesh.vertices), levels)
        sizes = (len(mesh.vertices), *(t.n_vertices + len(t.edges) for t in topologies))
        vertices = mesh.vertices
        for topology in topologies:
            vertices = np.concatenate([vertices, vertices[topology.edges].mean(axis=1)])
        pairs.append(Pair(mesh.faces, (vertices / 6).astype(np.float32), sizes))
    return pairs


def training() -> None:
    """Epochs of the paper's shape: 200 meshes of 590 faces to learn from, 10 to validate.  The first one, in which
    kernels may be compiled, does not count."""
    pairs = pairs_of(2)
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / "train.safetensors", Path(folder) / "validation.safetensors"]
        save_pairs(pairs * 20, files[0], {})
        save_pairs(pairs, files[1], {})
        seconds = {}
        for batch, threads in ((1, 1), (4, 1), (4, 2)):
            config = replace(PRESETS["paper"], epochs=3, batch=batch, threads=threads, device="cpu")
            marks: list[float] = []
            train(files[:1], files[1:], Path(folder) / f"run-{batch}-{threads}", config,
                  on_epoch=lambda _, marks=marks: marks.append(time.perf_counter()))
            seconds[batch, threads] = min(np.diff(marks))
            print(f"epoch, batch {batch}, {threads} thread(s): {seconds[batch, threads]:.2f} s   (reference 9.3 s at "
                  f"batch 1)   ratio to batch 1: {seconds[batch, threads] / seconds[1, 1]:.2f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--large", action="store_true", help="also 1,000,000 faces (7 GiB, 40 s)")
    inference(parser.parse_args().large)
    architectures()
    training()
