"""The paper's training protocol on the authors' public elephant pairs: best validation loss, and the shipped weights.

    python -m experiments elephant cartoon_elephant.npz --runs runs

The authors' released weights have a validation loss of 1.926012e-6 on the same 10 pairs.  Writes
results/elephant.json and, with --ship, src/neusub/weights/elephant.safetensors.  An interrupted run goes on.
"""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

from experiments.common import parsed, parser_of, provenance, ship, show, training_scores, write_results
from neusub import PRESETS, import_pairs, train
from neusub.training import TrainingResult

SHOWS = ("app:experiments",)
REFERENCE = 1.926012e-6
SOURCE = {"file": "cartoon_elephant.npz", "repository": "HTDerekLiu/neuralSubdiv", "author": "Hsueh-Ti Derek Liu",
          "licence": "MPL-2.0"}
DESCRIPTION = "smooth organic shapes; trained on one shape, the cartoon elephant of the paper's authors' public pairs"


def run(source: Path, runs: Path, seed: int, threads: int, quick: bool) -> TrainingResult:
    pairs = runs / "pairs"
    if not (pairs / "train.safetensors").exists():
        import_pairs(source, pairs, licence="MPL-2.0")
    config = replace(PRESETS["paper"], seed=seed, threads=threads)
    folder = runs / f"elephant-{seed}"
    if quick:
        config, folder = replace(config, epochs=2), folder.with_name(f"{folder.name}-quick")
    return train([pairs / "train.safetensors"], [pairs / "validation.safetensors"], folder, config, resume=True,
                 on_epoch=show)


def first_epoch_below(log: Path, loss: float) -> int | None:
    with log.open(newline="") as file:
        return next((int(row["epoch"]) for row in csv.DictReader(file) if float(row["validation_loss"]) <= loss), None)


def main() -> None:
    parser = parser_of("experiments elephant", __doc__, "two epochs; not shipped", trains=True)
    parser.add_argument("source", type=Path, help="cartoon_elephant.npz, the authors' public pairs")
    parser.add_argument("--ship", action="store_true", help="make the best weights a model of the package")
    options = parsed(parser)
    result = run(options.source, options.runs, options.seed, options.threads, options.quick)
    below = first_epoch_below(result.folder / "log.csv", REFERENCE)
    origin = provenance(options)
    write_results("elephant", {**origin, **training_scores(result), "reference_validation_loss": REFERENCE,
                               "first_epoch_at_or_below_reference": below}, options)
    if options.ship and not options.quick:
        result.model.card["sources"] = [SOURCE]
        ship("elephant", origin["command"], DESCRIPTION, result)


if __name__ == "__main__":
    main()
