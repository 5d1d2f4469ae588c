"""Two levels of each scheme, 20,480 faces -> 327,680, beside igl's and VTK's in the same run.

Run: python benchmarks/schemes.py [--repeats 5]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import igl
import numpy as np
import pyvista as pv

from neusub.schemes import subdivision_operator
from neusub.topology import build_topology

LEVELS = 2


def shortest(work: Callable[[], object], repeats: int) -> float:
    """Seconds of the fastest run: other work on the machine only ever adds to it."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def sphere(levels: int, solid: pv.PolyData | None = None) -> tuple[np.ndarray, np.ndarray]:
    solid = solid or pv.Icosahedron()
    vertices = np.asarray(solid.points, dtype=np.float64)
    faces = np.asarray(solid.regular_faces, dtype=np.int64)
    for _ in range(levels):
        vertices, faces = igl.loop(vertices, faces, 1)
    return vertices, faces


def irregular() -> tuple[np.ndarray, np.ndarray]:
    """About as many faces, but most vertices extraordinary, as decimation leaves them."""
    vertices, faces = sphere(6)
    rough = vertices * (1 + 0.1 * np.sin(7 * vertices[:, :1]) * np.cos(5 * vertices[:, 1:2]))
    coarse = pv.PolyData.from_regular_faces(rough, faces).decimate(0.75)
    return np.asarray(coarse.points, dtype=np.float64), np.asarray(coarse.regular_faces, dtype=np.int64)


def compare(title: str, vertices: np.ndarray, faces: np.ndarray, repeats: int) -> None:
    mesh = pv.PolyData.from_regular_faces(vertices, faces)
    peers = {
        "midpoint": {
            "igl": lambda: igl.upsample(vertices, faces, LEVELS),
            "VTK": lambda: mesh.subdivide(LEVELS, "linear"),
        },
        "loop": {
            "igl": lambda: igl.loop(vertices, faces, LEVELS),
            "VTK": lambda: mesh.subdivide(LEVELS, "loop"),
        },
        "butterfly": {"VTK": lambda: mesh.subdivide(LEVELS, "butterfly")},
    }
    print(f"{title}: {len(faces)} -> {len(faces) * 4**LEVELS} faces, milliseconds (peer's time / ours)")
    for scheme, others in peers.items():

        def build(scheme: str = scheme):
            return subdivision_operator(build_topology(faces, len(vertices)), scheme, LEVELS)

        operator = build()
        built = shortest(build, repeats)
        applied = shortest(lambda operator=operator: operator.apply(vertices), repeats)
        line = f"  {scheme:9}  build {1e3 * built:6.1f}  apply {1e3 * applied:5.1f}"
        line += f"  build/apply {built / applied:5.1f}x"
        for name, peer in others.items():
            seconds = shortest(peer, repeats)
            line += f"   {name} {1e3 * seconds:6.1f} ({seconds / (built + applied):.2f}x)"
        print(line)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    compare("regular", *sphere(5), repeats)
    compare("irregular", *irregular(), repeats)


if __name__ == "__main__":
    main()
