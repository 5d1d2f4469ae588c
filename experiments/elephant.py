"""The paper's training protocol on the authors' public elephant pairs: best validation loss, and the shipped weights.

    python experiments/elephant.py cartoon_elephant.npz --runs runs

The authors' released weights have a validation loss of 1.926012e-6 on the same 10 pairs.  Writes
results/elephant.json and, with --ship, src/neusub/weights/elephant.safetensors.  An interrupted run goes on.
"""

from __future__ import annotations

import argparse
import csv
import json
import platform
import subprocess
from dataclasses import replace
from pathlib import Path

from neusub.configuration import PRESETS
from neusub.generation import import_pairs
from neusub.training import TrainingResult, train

HERE = Path(__file__).parent
REFERENCE = 1.926012e-6
DESCRIPTION = "smooth organic shapes; trained on one shape, the cartoon elephant of the paper's authors' public pairs"


def run(source: Path, runs: Path, seed: int, threads: int) -> TrainingResult:
    pairs = runs / "pairs"
    if not (pairs / "train.safetensors").exists():
        import_pairs(source, pairs, licence="MPL-2.0")
    config = replace(PRESETS["paper"], seed=seed, threads=threads)
    return train([pairs / "train.safetensors"], [pairs / "validation.safetensors"], runs / f"elephant-{seed}", config,
                 resume=True, on_epoch=lambda row: print(row, flush=True))


def first_epoch_below(log: Path, loss: float) -> int | None:
    with log.open(newline="") as file:
        return next((int(row["epoch"]) for row in csv.DictReader(file) if float(row["validation_loss"]) <= loss), None)


def parser_of(doc: str | None) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=doc)
    parser.add_argument("source", type=Path, help="cartoon_elephant.npz, the authors' public pairs")
    parser.add_argument("--runs", type=Path, default=Path("runs"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--ship", action="store_true", help="make the best weights a model of the package")
    return parser


def write_scores(name: str, command: str, options: argparse.Namespace, result: TrainingResult, more: dict) -> None:
    """results/NAME.json: where the numbers come from, and the numbers."""
    commit = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True, cwd=HERE)
    scores = {
        "command": command,
        "commit": commit.stdout.strip(),
        "machine": f"{platform.machine()}, {options.threads} thread(s)",
        "seed": options.seed,
        "epochs": result.epochs,
        "best_validation_loss": result.best_loss,
        "best_epoch": result.best_epoch,
        **more,
    }
    (HERE / "results" / f"{name}.json").write_text(json.dumps(scores, indent=2) + "\n")
    print(json.dumps(scores, indent=2))


def ship(name: str, command: str, description: str, result: TrainingResult) -> None:
    """Make the best weights the package's model NAME."""
    result.model.card |= {"description": description, "command": command}
    result.model.save(HERE.parent / "src" / "neusub" / "weights" / f"{name}.safetensors")


def main() -> None:
    options = parser_of(__doc__).parse_args()
    result = run(options.source, options.runs, options.seed, options.threads)
    command = f"python experiments/elephant.py cartoon_elephant.npz --runs runs --seed {options.seed} --ship"
    below = first_epoch_below(result.folder / "log.csv", REFERENCE)
    write_scores("elephant", command, options, result,
                 {"reference_validation_loss": REFERENCE, "first_epoch_at_or_below_reference": below})
    if options.ship:
        ship("elephant", command, DESCRIPTION, result)


if __name__ == "__main__":
    main()
