"""What the loss costs beside two chamfer distances, and what decimation with its map costs, against the size.

    python -m experiments runtime [--quick] [--only fig:runtime | sec:SSS]

Loss: one evaluation, forward and gradient, on the vertices of a refined icosahedron, float32.  "known targets" is the
paper's loss; "chamfer, KD-tree" finds neighbours with scipy on the CPU; "chamfer, all pairs" compares all points, in
blocks that fit the memory.  Where torch has a GPU, all but the tree run there too.  The target's tree is built once.
Decimation: the demo's blob, refined by midpoints, always down to 500 vertices; `igl.qslim` keeps no map.
Seconds are of the processor on the CPU, for other programs may run there, and of the clock on a GPU.
Writes results/runtime.json, each of the two with where it was measured, and docs/reproduction/runtime.webp; --quick
takes small sizes, and writes nothing.
"""

from __future__ import annotations

import ctypes
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import igl
import numpy as np
import torch
import trimesh
from scipy.spatial import cKDTree
from torch import Tensor

import neusub
from experiments.common import HERE, add_result, parsed, parser_of, provenance, read_results
from experiments.drawing import write_chart

SHOWS = ("fig:runtime", "sec:SSS")
TARGETS, TREE, PAIRS = "known targets", "chamfer, KD-tree", "chamfer, all pairs"
BLOCK = 2**24  # pairs of points at a time
LONG = 2.5  # seconds of one evaluation: it is not repeated, and that loss not measured on more points
COARSE = 500  # vertices
BASE = 8_000  # faces of the blob that is refined


# --- the losses --------------------------------------------------------------------------------------------------


def known_targets(points: Tensor, targets: Tensor) -> Tensor:
    """Vertex k belongs to target k (paper, section 4)."""
    return (points - targets).square().mean()


def chamfer(points: Tensor, targets: Tensor, there: Tensor, back: Tensor) -> Tensor:
    """Mean squared distance to the nearest point, both ways; the gradient goes through the points, not the choice."""
    return (points - targets[there]).square().sum(1).mean() + (points[back] - targets).square().sum(1).mean()


def by_trees(points: Tensor, targets: Tensor, tree: cKDTree) -> Tensor:
    place = points.detach().numpy()
    there, back = tree.query(place)[1], cKDTree(place).query(targets.numpy())[1]
    return chamfer(points, targets, torch.from_numpy(there), torch.from_numpy(back))


def by_all_pairs(points: Tensor, targets: Tensor) -> Tensor:
    place = points.detach()
    return chamfer(points, targets, nearest(place, targets), nearest(targets, place))


def nearest(points: Tensor, others: Tensor) -> Tensor:
    rows = max(1, BLOCK // len(others))
    return torch.cat([torch.cdist(block, others).argmin(dim=1) for block in points.split(rows)])


# --- what is measured --------------------------------------------------------------------------------------------


def seconds_of(work: Callable[[], Any], on_gpu: bool = False) -> float:
    """Of one call: the least of three at least, and of as many as take half a second; a long one is not repeated."""
    took = [work_and_wait(work, on_gpu)]
    while took[0] < LONG and (len(took) < 3 or (sum(took) < 0.5 and len(took) < 200)):
        took.append(work_and_wait(work, on_gpu))
    return min(took)


def work_and_wait(work: Callable[[], Any], on_gpu: bool) -> float:
    clock = time.perf_counter if on_gpu else time.process_time
    start = clock()
    work()
    if on_gpu:
        torch.cuda.synchronize()
    return clock() - start


def sphere(levels: int) -> Tensor:
    solid = trimesh.creation.icosahedron()
    mesh = neusub.Mesh(np.asarray(solid.vertices), np.asarray(solid.faces))
    vertices = neusub.subdivide(mesh, "midpoint", levels)[-1].vertices
    return torch.from_numpy(vertices / np.linalg.norm(vertices, axis=1, keepdims=True)).float()


def losses(largest: int, seed: int) -> list[dict]:
    rows, left_out = [], set()
    for levels in range(3, largest + 1):
        targets = sphere(levels)
        edge = (4 * np.pi / len(targets)) ** 0.5
        noise = torch.randn(targets.shape, generator=torch.Generator().manual_seed(seed))
        points = (targets + edge / 4 * noise).requires_grad_()
        row: dict = {"points": len(targets)}
        for name, loss, place in evaluations(points, targets):
            if name not in left_out:
                row[name] = seconds_of(partial(evaluate, loss, place), place.is_cuda)
                left_out |= {name} if row[name] > LONG else set()
        rows.append(row)
        print(row, flush=True)
    return rows


def evaluations(points: Tensor, targets: Tensor) -> list[tuple[str, Callable[[Tensor], Tensor], Tensor]]:
    """Name, loss, and the points on the device where it is measured."""
    tree = cKDTree(targets.numpy())
    found = [(TARGETS, partial(known_targets, targets=targets), points),
             (TREE, partial(by_trees, targets=targets, tree=tree), points),
             (PAIRS, partial(by_all_pairs, targets=targets), points)]
    if torch.cuda.is_available():
        place, goal = points.detach().cuda().requires_grad_(), targets.cuda()
        found += [(f"{TARGETS}, GPU", partial(known_targets, targets=goal), place),
                  (f"{PAIRS}, GPU", partial(by_all_pairs, targets=goal), place)]
    return found


def evaluate(loss: Callable[[Tensor], Tensor], points: Tensor) -> Tensor:
    return torch.autograd.grad(loss(points), points)[0]


def decimations(largest: int) -> dict:
    sys.path.insert(0, str(HERE.parent / "examples"))
    import demo

    mesh, rows = neusub.decimate(demo.blob(), n_faces=BASE).on_surface, []
    neusub.decimate(mesh, n_vertices=COARSE)  # compiles the kernels
    while len(mesh.faces) <= largest:
        rows.append(decimation_of(mesh, repeats=3 if len(mesh.faces) < 500_000 else 1))
        print(rows[-1], flush=True)
        mesh = neusub.subdivide(mesh, "midpoint", 1)[-1]
    slope = np.polyfit(*(np.log([row[key] for row in rows]) for key in ("vertices", "seconds")), 1)[0]
    return {"sizes": rows, "exponent": float(slope)}


def decimation_of(mesh: neusub.Mesh, repeats: int) -> dict:
    """Time with the map and without one, the least of the repetitions, and the memory that it takes."""
    took, peer, peak = [], [], 0
    for _ in range(repeats):
        again = neusub.Mesh(mesh.vertices, mesh.faces)  # without the topology
        before, start = memory("VmRSS", reset=True), time.process_time()
        result = neusub.decimate(again, n_vertices=COARSE)
        took.append(time.process_time() - start)
        peak = max(peak, memory("VmHWM") - before)
        start = time.process_time()
        igl.qslim(mesh.vertices, mesh.faces, len(result.faces))
        peer.append(time.process_time() - start)
    collapses = result.counts["legal"]
    return {"faces": len(mesh.faces), "vertices": len(mesh.vertices), "reached": result.reached, "collapses": collapses,
            "seconds": min(took), "microseconds_a_collapse": 1e6 * min(took) / collapses,
            "igl_qslim_seconds": min(peer), "map_bytes_a_collapse": sum(a.nbytes for a in result.charts) / collapses,
            "peak_megabytes": peak / 1e6}


def memory(kind: str, reset: bool = False) -> int:
    """Bytes of this process by Linux's count, now (VmRSS) or the most since the last reset (VmHWM)."""
    if reset:
        ctypes.CDLL(None).malloc_trim(0)  # what was freed goes back, or it would count as used before
        Path("/proc/self/clear_refs").write_text("5")
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(line.split()[1] for line in lines if line.startswith(kind)))


# --- the picture -------------------------------------------------------------------------------------------------


def draw(rows: list[dict], decimation: dict) -> Path:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4.4), dpi=100, layout="constrained")
    left, right = figure.subplots(1, 2)
    for name in sorted({key for row in rows for key in row} - {"points"}, key=list(rows[0]).index):
        measured = [(row["points"], row[name]) for row in rows if name in row]
        left.loglog(*np.array(measured).T, "o-", label=name)
    left.set(xlabel="points", ylabel="seconds of an evaluation", title="loss and its gradient")
    sizes = decimation["sizes"]
    n = np.array([row["vertices"] for row in sizes])
    exponent = f"{decimation['exponent']:.2f}"
    right.loglog(n, [row["seconds"] for row in sizes], "o-", label=f"with the map, exponent {exponent}")
    right.loglog(n, [row["igl_qslim_seconds"] for row in sizes], "s-", label="igl.qslim, no map")
    guide = n * np.log(n)
    right.loglog(n, sizes[-1]["seconds"] * guide / guide[-1], "--", color="gray", label="N log N, from the last point")
    right.set(xlabel="vertices", ylabel="seconds of one core", title=f"decimation to {COARSE} vertices")
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.2))
    return write_chart("runtime", figure)


def ratios(rows: list[dict]) -> list[dict]:
    """How many times longer the others take than known targets, on the same device."""
    out = []
    for row in rows:
        own = {"": row[TARGETS], ", GPU": row.get(f"{TARGETS}, GPU", np.nan)}
        out.append({"points": row["points"], **{
            name: row[name] / own[", GPU" if name.endswith("GPU") else ""]
            for name in row if name != "points" and not name.startswith(TARGETS)}})
    return out


def main() -> None:
    parser = parser_of("experiments runtime", __doc__, "small sizes")
    parser.add_argument("--only", choices=SHOWS, help="one of the two; the other's last results stay")
    options = parsed(parser)
    if options.only != "fig:runtime":
        measured = decimations(70_000 if options.quick else 2_100_000)
        add_result("runtime", ["sec:SSS"], {**provenance(options), **measured}, options)
    if options.only != "sec:SSS":
        rows = losses(5 if options.quick else 8, options.seed)
        gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else None
        add_result("runtime", ["fig:runtime"], {**provenance(options), "gpu": gpu, "seconds": rows,
                                                "times_the_known_targets": ratios(rows)}, options)
        print(*ratios(rows), sep="\n")
    results = read_results("runtime")
    if not options.quick and all(name in results for name in SHOWS):
        print(draw(results["fig:runtime"]["seconds"], results["sec:SSS"]))


if __name__ == "__main__":
    main()
