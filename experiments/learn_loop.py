"""Learning Loop subdivision: the network is trained on two levels of Loop, and compared with Loop on other shapes.

    python -m experiments learn_loop MESHES [--quick]

MESHES is the folder that holds INDEX.csv.  One shape is decimated at random and each coarse mesh subdivided twice by
Loop; the loss compares each level with Loop's (`app:Loop`).  The test: coarse meshes of other shapes, the distance of
each vertex of level 2 to Loop's, in percent of the diagonal of the box.  Writes results/learn_loop.json and
docs/reproduction/learn_loop.webp.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import neusub
from experiments.common import draws, parsed, parser_of, provenance, seeded, write_results
from experiments.drawing import BACK, FRONT, SIDE, UP, panel, titled, write_panels
from experiments.measures import mean_of
from experiments.variants import NETWORKS, Fit, fit
from neusub import Mesh, PairConfig, Subdivider, TrainingConfig
from neusub.generation import Batch, Pair, batch_pairs, load_pairs
from neusub.map_pictures import View
from neusub.training import mean_coarse_edge

SHOWS = ("app:Loop", "fig:learnLoop")
SOURCE = "organic/oded_spot.ply"
NOVEL = {  # other shapes, and where to look from
    "organic/oded_hand_closed.ply": FRONT,
    "organic/oded_koala_low_resolution.ply": FRONT,
    "organic/oded_penguin_hr.ply": FRONT,
    "organic/oded_cat_low_resolution.ply": FRONT,
    "organic/oded_fish.ply": SIDE,
    "organic/oded_skull_low_resolution.ply": FRONT,
    "manmade/oded_wingnut.ply": BACK,
    "manmade/oded_hammer.ply": FRONT,
}
DRAWN = list(NOVEL)[:3]
VERTICES = (150, 300)


@dataclass(frozen=True, eq=False)
class LoopBatch(Batch):
    """A coarse mesh whose levels are compared with Loop's.

    A pair file cannot say this: there a vertex has one target for all levels, and Loop moves it at each.
    """

    sequence: list[Tensor]  # positions of levels 0 .. L; level 0 is the coarse mesh

    def loss(self, outputs: list[Tensor], kind: str = "squared") -> Tensor:
        rows = zip(outputs, self.sequence, self.weights)
        return torch.stack([((out - there).square() * weight).sum() for out, there, weight in rows]).sum()


def loop_batch(coarse: Mesh) -> LoopBatch:
    """neusub.subdivide numbers vertices as pairs do: the old ones, then one for each edge."""
    levels = neusub.subdivide(coarse, "loop", 2)
    sizes = tuple(len(level.vertices) for level in levels)
    pair = Pair(coarse.faces, levels[-1].vertices.astype(np.float32), sizes, coarse.vertices.astype(np.float32))
    batch = batch_pairs([pair], "decimated")
    return LoopBatch(**vars(batch), sequence=[torch.tensor(level.vertices).float() for level in levels])


def trained(options: argparse.Namespace) -> tuple[Fit, Subdivider]:
    folder = options.runs / "learn_loop" / seeded(f"pairs-{options.pairs}", options)
    config = PairConfig(total=options.pairs, validation=5, vertices=VERTICES, seed=options.seed)
    report = neusub.make_pairs([options.meshes / SOURCE], folder, config, workers=options.threads, strict=True)
    pairs = [load_pairs(files[0]) for files in (report.train, report.validation)]
    train, validation = ([loop_batch(Mesh(pair.positions("on_surface").astype(float), pair.faces)) for pair in group]
                         for group in pairs)
    training = TrainingConfig(epochs=options.epochs, seed=options.seed, threads=options.threads, schedule="cosine")
    result = fit(NETWORKS["paper"], train, validation, training)
    card = {"architecture": asdict(result.network.plan), "input": "on_surface",
            "scale": {"box": 1.0, "edge": mean_coarse_edge(pairs[0])}}
    return result, Subdivider(result.network, card)


def coarse_of(mesh: Mesh, seed: int) -> Mesh:
    return neusub.decimate(mesh, n_vertices=int(np.mean(VERTICES)), strategy="random", seed=seed).on_surface


def percent(result: Mesh, there: Mesh) -> np.ndarray:
    """Distance of each vertex to its own place, in percent of the diagonal."""
    distances = np.linalg.norm(result.vertices - there.vertices, axis=1)
    return 100 * distances / np.linalg.norm(np.ptp(there.vertices, axis=0))


def compared(coarse: Mesh, model: Subdivider) -> dict:
    """The network's distance to Loop; beside it what midpoint's and butterfly's would be."""
    loop, ours = neusub.subdivide(coarse, "loop", 2), model.subdivide(coarse, 2)
    errors = percent(ours[2], loop[2])
    other = {scheme: float(percent(neusub.subdivide(coarse, scheme, 2)[2], loop[2]).mean())  # type: ignore[arg-type]
             for scheme in ("midpoint", "butterfly")}
    return {"mean": float(errors.mean()), "99 %": float(np.percentile(errors, 99)), "worst": float(errors.max()),
            "mean of level 1": float(percent(ours[1], loop[1]).mean()), **other}


def draw(folder: Path, model: Subdivider, seed: int, names: Sequence[str]) -> Path:
    rows = []
    for name in names:
        coarse = coarse_of(neusub.load(folder / name), seed)
        view = View(coarse, (290, 270), NOVEL[name], UP)
        shown = {"coarse": coarse, "network": model.subdivide(coarse, 2)[-1],
                 "Loop": neusub.subdivide(coarse, "loop", 2)[-1]}
        rows.append([titled(panel(mesh, view, edges=mesh is coarse), f"{title}, {len(mesh.faces):,} faces")
                     for title, mesh in shown.items()])
    return write_panels("learn_loop", rows)


def main() -> None:
    parser = parser_of("experiments learn_loop", __doc__, "6 pairs, 10 epochs, two shapes", trains=True)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--epochs", type=int, default=200)
    options = parsed(parser)
    if options.quick:
        options.pairs, options.epochs = 6, 10
    result, model = trained(options)
    print(f"best validation loss {result.losses.min():.3e} in epoch {result.best_epoch}, {result.seconds:.0f} s of the "
          "processor", flush=True)
    rows = {}
    for name in list(NOVEL)[: 2 if options.quick else None]:
        rows[Path(name).stem] = compared(coarse_of(neusub.load(options.meshes / name), options.seed), model)
        print(Path(name).stem, json.dumps(rows[Path(name).stem]), flush=True)
    means = mean_of(rows)
    print("mean", json.dumps(means))
    if draws(options):
        print(draw(options.meshes, model, options.seed, DRAWN))
    write_results("learn_loop", {
        **provenance(options), "source": SOURCE, "pairs": options.pairs, "epochs": options.epochs,
        "best_epoch": result.best_epoch, "best_validation_loss": float(result.losses.min()),
        "cpu_seconds": round(result.seconds), "percent_of_the_diagonal": {"mean": means, "shapes": rows}},
        options)


if __name__ == "__main__":
    main()
