"""Wall time of whole processes: the help, and two levels of a 400-face mesh.

Peer within the run: a Python that imports torch and does nothing else, which the second cannot undercut.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import network

import neusub


def seconds(*command: str) -> float:
    """The best of three runs."""
    times = []
    for _ in range(3):
        began = time.perf_counter()
        subprocess.run([sys.executable, *command], check=True, capture_output=True)
        times.append(time.perf_counter() - began)
    return min(times)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        coarse = Path(folder) / "coarse.obj"
        neusub.save(network.torus(20, 10), coarse)
        torch = seconds("-c", "import torch")
        work = seconds("-m", "neusub", "subdivide", str(coarse), "-o", f"{folder}/fine.obj", "--overwrite")
        print(f"neusub --help: {seconds('-m', 'neusub', '--help'):.2f} s")
        print(f"neusub subdivide, 400 faces, two levels: {work:.2f} s   ratio to 'import torch': {work / torch:.2f}")
