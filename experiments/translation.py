"""Local frames: without them a network fails on a rigid motion of its own training shape.

    python -m experiments translation MESHES [--quick]

MESHES is the folder that holds INDEX.csv.  Three networks learn one coarse mesh of one shape (`fig:toy_translation`):
the paper's; one whose inputs and displacements are along the world's axes; and one that sees positions, too.  Each then
subdivides the same mesh turned or moved.  The error is the distance of each vertex of level 2 to its target, turned or
moved likewise, in percent of the diagonal of the box.  Writes results/translation.json and
docs/reproduction/translation.webp.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from scipy.spatial.transform import Rotation
from torch import Tensor

import neusub
from experiments.common import draws, parsed, parser_of, provenance, seeded, write_results
from experiments.drawing import BACK, UP, panel, titled, write_picture
from experiments.variants import NETWORKS, Fit, fit, refined
from neusub import PairConfig, TrainingConfig
from neusub.generation import Batch, Pair, batch_pairs, load_pairs
from neusub.map_pictures import View

SHOWS = ("fig:toy_translation",)
SOURCE = "organic/oded_spot.ply"
NETS = {"paper": "local frames", "world axes": "world axes", "world positions": "world axes, positions"}
ANGLES = (0, 5, 10, 20, 45, 90, 180)  # degrees around AXIS
SHIFTS = (0, 0.02, 0.05, 0.1, 0.2, 0.5, 1)  # along AXIS, in sides of the unit box
AXIS = np.array([1, 2, 3]) / np.sqrt(14)  # along none of the world's
TURN, SHIFT = 90, 1  # of the picture


def one_pair(options: argparse.Namespace) -> Pair:
    config = PairConfig(total=1, vertices=(250, 250), seed=options.seed)
    folder = options.runs / "translation" / seeded("pairs", options)
    report = neusub.make_pairs([options.meshes / SOURCE], folder, config, workers=options.threads, strict=True)
    return load_pairs(report.train[0])[0]


def motion(angle: float = 0, shift: float = 0) -> tuple[Tensor, Tensor]:
    turn = Rotation.from_rotvec(np.radians(angle) * AXIS).as_matrix()
    return torch.as_tensor(turn).float(), torch.as_tensor(shift * AXIS).float()


def error(result: Fit, batch: Batch, turn: Tensor, shift: Tensor) -> float:
    """Mean distance of the last level to its targets, percent."""
    with torch.no_grad():
        out = result.network(batch.positions @ turn.T + shift, batch.levels)[-1]
    distances = (out - batch.targets @ turn.T - shift).norm(dim=1)
    return 100 * float(distances.mean() / (batch.targets.amax(0) - batch.targets.amin(0)).norm())


def midpoint_error(pair: Pair) -> float:
    """What no displacement at all would give."""
    coarse = neusub.Mesh(pair.positions("on_surface").astype(float), pair.faces)
    distances = np.linalg.norm(neusub.subdivide(coarse, "midpoint", 2)[-1].vertices - pair.targets, axis=1)
    return float(100 * distances.mean() / np.linalg.norm(np.ptp(pair.targets, axis=0)))


def draw(results: dict[str, Fit], pair: Pair, batch: Batch, rows: dict) -> Path:
    """Above, results for the mesh where it was trained, turned and moved, all moved back; below, the errors."""
    motions = {"as trained": motion(), f"turned by {TURN} degrees": motion(angle=TURN), "moved by the box's side":
               motion(shift=SHIFT)}
    shown = []
    for name, title in NETS.items():
        line = []
        for where, (turn, shift) in motions.items():
            mesh = refined(results[name].network, pair, batch.positions @ turn.T + shift, batch)[-1]
            back = mesh.replace_vertices((mesh.vertices - shift.numpy()) @ turn.numpy())
            view = View(neusub.Mesh(pair.targets.astype(float), back.faces), (250, 270), BACK, UP)
            words = f"{title}: {where}" if where == "as trained" else where
            line.append(titled(panel(back, view), words))
        shown.append(np.concatenate(line, axis=1))
    meshes = Image.fromarray(np.concatenate(shown))
    chart = charts(rows, meshes.width)
    whole = Image.new("RGB", (meshes.width, meshes.height + chart.height), "white")
    whole.paste(meshes)
    whole.paste(chart, (0, meshes.height))
    return write_picture("translation", whole)


def charts(rows: dict, width: int) -> Image.Image:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width / 100, 2.8), dpi=100, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    labels = {"angle": "turned by, degrees", "shift": "moved by, sides of the box"}
    for axes, (key, label) in zip(figure.subplots(1, 2, sharey=True), labels.items()):
        for name, title in NETS.items():
            axes.plot(*zip(*rows[name][key]), "o-", ms=3, label=title)
        axes.set(xlabel=label, yscale="log")
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("mean error, % of the diagonal")
    figure.axes[1].legend(fontsize=8)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def main() -> None:
    parser = parser_of("experiments translation", __doc__, "50 epochs", trains=True)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--epochs", type=int, default=600, help="of one step each")
    options = parsed(parser)
    pair = one_pair(options)
    batch = batch_pairs([pair])
    config = TrainingConfig(epochs=50 if options.quick else options.epochs, seed=options.seed,
                            threads=options.threads, schedule="cosine")
    results, rows = {}, {}
    for name in NETS:
        results[name] = result = fit(NETWORKS[name], [batch], [batch], config)
        rows[name] = {"best_training_loss": float(result.losses.min()), "cpu_seconds": round(result.seconds),
                      "angle": [[a, error(result, batch, *motion(angle=a))] for a in ANGLES],
                      "shift": [[s, error(result, batch, *motion(shift=s))] for s in SHIFTS]}
        print(name, json.dumps(rows[name]), flush=True)
    if draws(options):
        print(draw(results, pair, batch, rows))
    write_results("translation", {**provenance(options), "source": SOURCE, "vertices": pair.level_sizes[0],
                                  "epochs": config.epochs,
                                  "midpoint_percent_of_the_diagonal": midpoint_error(pair),
                                  "mean_error_percent_of_the_diagonal": rows}, options)


if __name__ == "__main__":
    main()
