"""A network trained on three levels against one trained on two, on the same coarse meshes of one shape.

    python -m experiments level3 MESHES [--pairs 40 --epochs 40] [--quick]

MESHES is the folder of INDEX.csv.  The paper's network on --pairs discretizations of 150 to 300 vertices of one shape,
--epochs epochs of one mesh a step, cosine (the paper: 200 and 700, constant).  Scored on the organic shapes that
`styles.py` holds out, decimated to 350 vertices on the surface, at levels 1 to 4: H and M in percent of the diagonal,
mean angle between neighbouring faces in degrees.  Writes results/level3.json and docs/reproduction/level3.webp.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import neusub
from experiments.common import draws, parsed, parser_of, provenance, seeded, training_scores, write_results
from experiments.drawing import BACK, BLUE, GREEN, GREY, shaded, titled, write_panels
from experiments.measures import angles, mean_of, percents, refined
from experiments.styles import HELD_OUT, SPOT, VALIDATION, held_out
from neusub import PRESETS, PairConfig

SHOWS = ("fig:level3",)
TRAINED, TESTED = (2, 3), 4
DRAWN, PANEL = HELD_OUT["organic"][0], (300, 260)


def trained(levels: int, options: argparse.Namespace) -> tuple[neusub.Subdivider, dict]:
    """Pairs of the same seeds whatever the number of levels: the two networks see the same coarse meshes."""
    folder = options.runs / "level3" / seeded(f"{levels}-levels-{options.pairs}", options)
    plan = PairConfig(total=options.pairs, validation=VALIDATION, levels=levels, seed=options.seed)
    pairs = neusub.make_pairs([options.meshes / SPOT], folder / "pairs", plan, workers=options.threads, strict=True,
                              licence="CC0 (Crane)")
    config = replace(PRESETS["paper"], schedule="cosine", epochs=options.epochs, levels=levels, seed=options.seed,
                     threads=options.threads)
    result = neusub.train(pairs.train, pairs.validation, folder / f"{options.epochs}-epochs", config, resume=True)
    return result.model, {"pairs": options.pairs, **training_scores(result)}


def scores(method: neusub.Subdivider | str, options: argparse.Namespace) -> dict:
    """Means over the shapes, of each level."""
    rows: dict = {f"level {level}": {} for level in range(1, TESTED + 1)}
    for name in HELD_OUT["organic"][: 1 if options.quick else None]:
        fine, coarse = held_out(options.meshes, name)
        for level, mesh in enumerate(refined(coarse, method, TESTED)[1:], start=1):
            rows[f"level {level}"][name] = {**percents(mesh, fine), "angle": float(angles(mesh).mean())}
    return {level: mean_of(shapes) for level, shapes in rows.items()}


def draw(model: neusub.Subdivider, folder: Path) -> Path:
    """The figure: the training shape, and the levels of a shape that the network never saw."""
    _, coarse = held_out(folder, DRAWN)
    levels = model.subdivide(coarse, 3)
    panels = [titled(shaded(neusub.load(folder / SPOT), GREEN, PANEL, BACK), "the training shape"),
              titled(shaded(coarse, GREY, PANEL, edges=True), f"coarse, {len(coarse.vertices)} vertices")]
    panels += [titled(shaded(mesh, BLUE, PANEL, edges=level < 2), f"level {level}")
               for level, mesh in enumerate(levels[1:], start=1)]
    return write_panels("level3", [panels])


def main() -> None:
    parser = parser_of("experiments level3", __doc__, "8 pairs, 5 epochs, one shape", trains=True)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--epochs", type=int, default=700)
    options = parsed(parser)
    if options.quick:
        options.pairs, options.epochs = 8, 5
    rows: dict = {scheme: scores(scheme, options) for scheme in ("loop", "butterfly")}
    trainings, models = {}, {}
    for levels in TRAINED:
        name = f"{levels} levels"
        models[name], trainings[name] = trained(levels, options)
        rows[name] = scores(models[name], options)
    for name, levels in rows.items():
        for level, row in levels.items():
            print(f"{name:10s}{level}  " + "  ".join(f"{key} {value:.4g}" for key, value in row.items()))
    if draws(options):
        print(draw(models["3 levels"], options.meshes))
    write_results("level3", {**provenance(options), "shape": Path(SPOT).stem, "trainings": trainings, "scores": rows},
                  options)


if __name__ == "__main__":
    main()
