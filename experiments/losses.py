"""Losses without correspondences: chamfer distance and closest points, against targets that a bijective map gives.

    python -m experiments losses MESHES [--quick]

MESHES is the folder that holds INDEX.csv.  First, without a network (`fig:point2mesh`): coarse meshes are refined by
midpoints, and their vertices sent to the fine surface by closest points, and by the map of `decimate`; how much of the
fine surface do they reach?  Then (`fig:chamfer`) the same network is trained on the same pairs of one shape with three
losses, each summed over the levels, and tried on discretizations that were held out.  A triangle is flipped where its
normal points away from the fine surface under its centre, an edge folded where its faces turn by more than 120 degrees.
Writes results/losses.json, docs/reproduction/losses.webp and docs/reproduction/point2mesh.webp.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import igl
import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

import neusub
from experiments.common import draws, parsed, parser_of, provenance, seeded, write_results
from experiments.drawing import FRONT, UP, panel, red, titled, write_panels
from experiments.measures import FOLD, angles, is_flipped, mean_of, percents, remeshed
from experiments.variants import NETWORKS, Fit, fit, refined
from neusub import Mesh, PairConfig, TrainingConfig
from neusub.discretization import in_unit_box
from neusub.generation import Batch, Pair, batch_pairs, load_pairs
from neusub.map_pictures import View
from neusub.metrics import point_distance, sample_surface

SHOWS = ("fig:chamfer", "fig:point2mesh")
SOURCE = "organic/oded_skull_low_resolution.ply"  # has deep and thin parts: the closest point may be on another one
SHAPES = (SOURCE, "organic/oded_hand_closed.ply", "organic/oded_penguin_hr.ply",
          "organic/oded_scorpion_low_resolution.ply")
SAMPLES = 10_000
FINE_LEVELS, VERTICES = 5, 200  # of the coarse meshes without a network
NEAR, VERY_NEAR = 0.5, 0.1  # percent of the diagonal: how near a result reaches, and how near targets do
PANEL = (300, 340)
TITLES = {"correspondences": "our loss", "chamfer": "chamfer", "closest points": "closest points"}


# --- losses ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ChamferBatch(Batch):
    """The squared chamfer distance between the vertices of each level and samples of the fine surface."""

    samples: Tensor
    tree: cKDTree  # of the samples

    def loss(self, outputs: list[Tensor], kind: str = "squared") -> Tensor:
        terms = []
        for out in outputs:
            here = out.detach().numpy()
            there = self.samples[torch.from_numpy(self.tree.query(here)[1])]
            nearest = torch.from_numpy(cKDTree(here).query(self.samples.numpy())[1])
            terms.append((out - there).square().mean() + (out[nearest] - self.samples).square().mean())
        return torch.stack(terms).sum()


@dataclass(frozen=True, eq=False)
class ClosestBatch(Batch):
    """The squared distance of the vertices of each level to the fine surface: targets are the closest points."""

    fine: Mesh
    boxes: Any  # igl's tree of the fine surface's boxes

    def loss(self, outputs: list[Tensor], kind: str = "squared") -> Tensor:
        terms = []
        for out in outputs:
            _, _, closest = self.boxes.squared_distance(self.fine.vertices, self.fine.faces,
                                                        out.detach().double().numpy())
            terms.append((out - torch.from_numpy(closest).float()).square().mean())
        return torch.stack(terms).sum()


def losses_of(fine: Mesh) -> dict[str, Callable[[Batch], Batch]]:
    """Each loss as what it makes of a batch."""
    samples = sample_surface(fine, SAMPLES, np.random.default_rng(0))[0].astype(np.float32)
    tree, boxes = cKDTree(samples), igl.AABB()
    boxes.init(fine.vertices, fine.faces)
    return {"correspondences": lambda batch: batch,
            "chamfer": lambda batch: ChamferBatch(**vars(batch), samples=torch.from_numpy(samples), tree=tree),
            "closest points": lambda batch: ClosestBatch(**vars(batch), fine=fine, boxes=boxes)}


# --- what is measured --------------------------------------------------------------------------------------------


def covered(result: Mesh, fine: Mesh, within: float) -> float:
    """Percent of the fine surface that lies within some percent of the diagonal of the result."""
    samples = sample_surface(fine, 20_000, np.random.default_rng(1))[0]
    diagonal = np.linalg.norm(np.ptp(fine.vertices, axis=0))
    return float(100 * (point_distance(samples, result)[0] <= within / 100 * diagonal).mean())


def numbers_of(result: Mesh, fine: Mesh) -> dict[str, float]:
    return {"flipped": 100 * float(is_flipped(result, fine).mean()),
            "folded": 100 * float((angles(result) > FOLD).mean()),
            "covered": covered(result, fine, NEAR), **percents(result, fine)}


def correspondences(fine: Mesh, seed: int) -> dict[str, Mesh]:
    """fig:point2mesh: the refined coarse mesh, and where closest points and the map send its vertices."""
    result = neusub.decimate(fine, n_vertices=VERTICES, strategy="random", seed=seed)
    plain = neusub.subdivide(result.on_surface, "midpoint", FINE_LEVELS)[-1]
    return {"midpoints": plain, "closest points": plain.replace_vertices(point_distance(plain.vertices, fine)[2]),
            "map": remeshed(result, FINE_LEVELS)}


def reach(fine: Mesh, seed: int) -> dict[str, dict[str, float]]:
    """What the targets of each kind cover of the fine surface, and how many of their triangles are flipped."""
    targets = correspondences(fine, seed)
    return {name: {"covered": covered(mesh, fine, VERY_NEAR), "flipped": 100 * float(is_flipped(mesh, fine).mean())}
            for name, mesh in targets.items()}


# --- pictures ----------------------------------------------------------------------------------------------------


def draw_targets(fine: Mesh, rows: dict, seed: int) -> Path:
    """The fine surface, red where the targets do not reach it."""
    view, panels, targets = View(fine, PANEL, FRONT, UP), [], correspondences(fine, seed)
    near = VERY_NEAR / 100 * np.linalg.norm(np.ptp(fine.vertices, axis=0))
    centres = fine.vertices[fine.faces].mean(axis=1)
    for name in ("closest points", "map"):
        missed = point_distance(centres, targets[name])[0] > near
        title = f"{name}: {100 - rows[name]['covered']:.1f} % missed"
        panels.append(titled(panel(fine, view, red(missed)), title))
    return write_panels("point2mesh", [panels])


def draw_results(results: dict[str, Fit], pair: Pair, fine: Mesh) -> Path:
    """Results for one coarse mesh, flipped triangles in red."""
    batch = batch_pairs([pair])
    coarse = Mesh(pair.positions("on_surface").astype(float), pair.faces)
    view = View(fine, PANEL, FRONT, UP)
    panels = [titled(panel(coarse, view, edges=True), f"coarse, {len(coarse.faces)} faces")]
    for name, title in TITLES.items():
        mesh = refined(results[name].network, pair, batch.positions, batch)[-1]
        flipped = is_flipped(mesh, fine)
        panels.append(titled(panel(mesh, view, red(flipped)), f"{title}: {flipped.sum()} flipped"))
    return write_panels("losses", [panels])


def main() -> None:
    parser = parser_of("experiments losses", __doc__, "4 pairs, 5 epochs", trains=True)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--epochs", type=int, default=100)
    options = parsed(parser)
    if options.quick:
        options.pairs, options.epochs = 4, 5
    reached = {}
    for name in SHAPES[: 1 if options.quick else None]:
        reached[Path(name).stem] = reach(in_unit_box(neusub.load(options.meshes / name)), options.seed)
        print(name, json.dumps(reached[Path(name).stem]), flush=True)
    fine = in_unit_box(neusub.load(options.meshes / SOURCE))
    config = PairConfig(total=options.pairs, validation=5, seed=options.seed)
    folder = options.runs / "losses" / seeded(f"pairs-{options.pairs}", options)
    report = neusub.make_pairs([options.meshes / SOURCE], folder, config, workers=options.threads, strict=True)
    train, held_out = load_pairs(report.train[0]), load_pairs(report.validation[0])
    training = TrainingConfig(epochs=options.epochs, seed=options.seed, threads=options.threads, schedule="cosine")
    results, rows = {}, {}
    for name, with_loss in losses_of(fine).items():
        batches = [[with_loss(batch_pairs([pair])) for pair in pairs] for pairs in (train, held_out)]
        results[name] = result = fit(NETWORKS["paper"], *batches, training)
        numbers = [numbers_of(refined(result.network, pair, batch.positions, batch)[-1], fine)
                   for pair, batch in zip(held_out, batches[1])]
        rows[name] = {**mean_of(numbers), "best_epoch": result.best_epoch, "cpu_seconds": round(result.seconds)}
        print(name, json.dumps(rows[name]), flush=True)
    if draws(options):
        print(draw_targets(fine, reached[Path(SOURCE).stem], options.seed), draw_results(results, held_out[0], fine))
    write_results("losses", {
        **provenance(options), "source": SOURCE, "pairs": options.pairs, "epochs": options.epochs,
        "covered_within_percent_of_the_diagonal": {"targets": VERY_NEAR, "results": NEAR},
        "targets": {"levels": FINE_LEVELS, "vertices": VERTICES, **reached}, "results": rows}, options)


if __name__ == "__main__":
    main()
