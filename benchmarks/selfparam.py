"""Decimation with its map beside `igl.qslim`, which keeps none: time, memory of the map, points through it, pairs.

    python benchmarks/selfparam.py [MESH ...] [--large]

Without meshes: bumpy spheres of our own with irregular triangles; --large adds 4,000 and a million vertices.  Kernels
are compiled first.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import igl
import numpy as np
import pyvista as pv
from schemes import sphere

import neusub
from neusub import Mesh, PairConfig, decimate, make_pairs

FACES = 500
POINTS = 100_000


def best_of(work: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Seconds of the fastest run, and what it gave."""
    best, result = np.inf, None
    for _ in range(repeats):
        began = time.perf_counter()
        result = work()
        best = min(best, time.perf_counter() - began)
    return best, result


def bumpy(levels: int, solid: pv.PolyData | None = None) -> Mesh:
    """A sphere of 10 * 4^levels + 2 vertices (over the icosahedron), shaken so that no two triangles are alike."""
    vertices, faces = sphere(levels, solid)
    noise = np.random.default_rng(0).standard_normal(vertices.shape)
    vertices = vertices + noise * 0.15 / 2**levels
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    wave = np.sin(7 * vertices[:, :1]) * np.cos(5 * vertices[:, 1:2]) + np.sin(9 * vertices[:, 2:])
    return Mesh(vertices * (1 + 0.1 * wave), faces)


def compare(name: str, mesh: Mesh) -> dict[str, float]:
    """Prints times; gives the seconds of a collapse by strategy."""
    repeats, costs = 3 if len(mesh.vertices) < 100_000 else 1, {}
    peer, _ = best_of(lambda: igl.qslim(mesh.vertices, mesh.faces, FACES), repeats)
    for strategy in ("quadric", "random"):
        seconds, result = best_of(lambda strategy=strategy: decimate(mesh, n_faces=FACES, strategy=strategy), 3)
        collapses = result.counts["legal"]
        costs[strategy] = seconds / collapses
        size = sum(array.nbytes for array in result.charts) / collapses
        print(f"{name:18s} {len(mesh.vertices):9,} vertices  {strategy:8s} {seconds:7.3f} s  "
              f"{1e6 * costs[strategy]:5.1f} us a collapse  {seconds / peer:.2f} x igl.qslim ({peer:.3f} s)  "
              f"map {size:.0f} bytes a collapse", flush=True)
    rng = np.random.default_rng(0)
    result = decimate(mesh, n_faces=FACES)
    seconds, _ = best_of(result.fitted, repeats)
    print(f"{'':18s} fitted to level 2: {seconds:.3f} s")
    for direction, faces in (("to_fine", result.faces), ("to_coarse", mesh.faces)):
        at, barycentric = np.sort(rng.integers(0, len(faces), POINTS)), rng.dirichlet([1, 1, 1], POINTS)
        seconds, _ = best_of(lambda d=direction, a=at, b=barycentric: getattr(result, d)(a, b), 3)
        print(f"{'':18s} {direction}: {1e6 * seconds / POINTS:.2f} us a point, all threads, points sorted by face")
    return costs


def pairs(name: str, mesh: Mesh) -> None:
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "source.ply"
        neusub.save(mesh, source)
        began = time.perf_counter()
        make_pairs([source], Path(folder) / "pairs", PairConfig(total=200))
        print(f"{name:18s} 200 pairs of 150 to 300 vertices, two levels: {time.perf_counter() - began:.1f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", nargs="*", type=Path)
    parser.add_argument("--large", action="store_true", help="also 4,000 and a million vertices")
    options = parser.parse_args()
    warm = decimate(bumpy(3), n_faces=FACES)
    warm.fitted()
    for move in (warm.to_fine, warm.to_coarse):
        move(np.array([0]), np.array([[1.0, 0, 0]]))
    meshes = {path.stem: neusub.load(path) for path in options.meshes} or {f"sphere {n}": bumpy(n) for n in (5, 6, 7)}
    if options.large:
        meshes |= {f"octahedron {n}": bumpy(n, pv.Octahedron()) for n in (5, 9)}  # 4 * 4^n + 2 vertices
    meshes = dict(sorted(meshes.items(), key=lambda item: len(item[1].vertices)))
    costs = {name: compare(name, mesh) for name, mesh in meshes.items()}
    if len(meshes) > 1:
        small, *_, large = meshes
        for strategy in costs[small]:
            growth = costs[large][strategy] / costs[small][strategy]
            print(f"{strategy}: a collapse of {large} costs {growth:.2f} times one of {small}")
    name = min(meshes, key=lambda name: abs(len(meshes[name].vertices) - 10_000))
    pairs(name, meshes[name])


if __name__ == "__main__":
    main()
