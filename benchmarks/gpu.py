"""What a CUDA GPU gains: inference, and epochs with each step recorded as a CUDA graph, beside launching it kernel by
kernel and beside the CPU's threads.

Busy: the share of the time in which a kernel ran, as the driver counts it (with the package nvidia-ml-py), over the
last epochs.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from network import best_of, pairs_of, torus

import neusub.training
from neusub import PRESETS, Subdivider, train
from neusub.generation import save_pairs

RECORDABLE = neusub.training.recordable


def inference(large: bool) -> None:
    for n, m, repeats in [(100, 50, 5), *([(1000, 500, 2)] if large else [])]:
        mesh, seconds = torus(n, m), {}
        for device in ("cpu", "cuda"):
            model = Subdivider.load(device=device)
            torch.cuda.reset_peak_memory_stats()
            model.subdivide(mesh, levels=1)  # compiles
            seconds[device] = best_of(lambda model=model, mesh=mesh: model.subdivide(mesh), repeats)
        print(f"{len(mesh.faces):,} -> {16 * len(mesh.faces):,} faces: CPU, {torch.get_num_threads()} threads, "
              f"{seconds['cpu']:.3f} s; GPU {seconds['cuda']:.3f} s; ratio {seconds['cpu'] / seconds['cuda']:.2f}; "
              f"GPU memory {torch.cuda.max_memory_allocated() / 2**30:.1f} GiB", flush=True)


class Busy:
    """Ten times a second, from when the block begins: the time, and how busy the driver says that the GPU is."""

    def __enter__(self) -> Busy:
        self.seen: list[tuple[float, int]] = []
        self.done = threading.Event()
        self.thread = threading.Thread(target=self.watch)
        self.thread.start()
        return self

    def watch(self) -> None:
        while not self.done.wait(0.1):
            with suppress(ModuleNotFoundError, RuntimeError):
                self.seen.append((time.perf_counter(), torch.cuda.utilization()))

    def __exit__(self, *_) -> None:
        self.done.set()
        self.thread.join()

    def since(self, start: float) -> str:
        shares = [share for moment, share in self.seen if moment > start]
        return f"busy {np.mean(shares):.0f} %" if shares else "busy: not known"


def training(preset: str, folder: Path) -> None:
    """Epochs of 100 meshes of 590 faces, every step to the last level; the least but the first counts, in which kernels
    are compiled and steps recorded."""
    file = folder / f"{preset}.safetensors"
    save_pairs(pairs_of(PRESETS[preset].levels) * 10, file, {})
    seconds, busy = {}, ""
    for name, device, records, epochs in (("CPU", "cpu", False, 2), ("GPU", "cuda", False, 3),
                                          ("recorded", "cuda", True, 24)):
        neusub.training.recordable = RECORDABLE if records else lambda *_: False
        config = replace(PRESETS[preset], epochs=epochs, cycles=1, shallow=0.0, device=device)  # all epochs alike
        marks: list[float] = []
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats()
        with Busy() as watch:
            train([file], [], folder / f"{preset}-{name}", config,
                  on_epoch=lambda _, marks=marks: marks.append(time.perf_counter()))
        seconds[name], busy = min(np.diff(marks)), watch.since(marks[-10:][0])
        print(f"  {name}: epochs " + " ".join(f"{t:.2f}" for t in np.diff(marks)) + " s", flush=True)
    cpu, direct, recorded = seconds.values()
    memory = f"{torch.cuda.max_memory_reserved() / 2**30:.1f} GiB"
    print(f"epoch of 100 meshes, preset {preset}: CPU, {torch.get_num_threads()} thread(s), {cpu:.2f} s; GPU "
          f"{direct:.2f} s; recorded {recorded:.3f} s, {busy}, {memory}; ratio to the CPU {cpu / recorded:.1f}, to the "
          f"GPU without {direct / recorded:.1f}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--large", action="store_true", help="also 1,000,000 faces")
    parser.add_argument("--threads", type=int, default=2, help="of the CPU")
    options = parser.parse_args()
    if not torch.cuda.is_available():
        raise SystemExit("torch sees no CUDA GPU.")
    torch.set_num_threads(options.threads)
    print(torch.cuda.get_device_name())
    with tempfile.TemporaryDirectory() as place:
        for chosen in ("paper", "default"):
            training(chosen, Path(place))
    inference(options.large)
