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
COMMAND = "python experiments/elephant.py cartoon_elephant.npz --runs runs --seed {seed} --ship"


def run(source: Path, runs: Path, seed: int) -> TrainingResult:
    pairs = runs / "pairs"
    if not (pairs / "train.safetensors").exists():
        import_pairs(source, pairs, licence="MPL-2.0")
    config = replace(PRESETS["paper"], seed=seed, threads=1)
    return train([pairs / "train.safetensors"], [pairs / "validation.safetensors"], runs / f"elephant-{seed}", config,
                 resume=True, on_epoch=lambda row: print(row, flush=True))


def first_epoch_below(log: Path, loss: float) -> int | None:
    with log.open(newline="") as file:
        return next((int(row["epoch"]) for row in csv.DictReader(file) if float(row["validation_loss"]) <= loss), None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("source", type=Path)
    parser.add_argument("--runs", type=Path, default=Path("runs"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--ship", action="store_true", help="make the best weights the package's model 'elephant'")
    options = parser.parse_args()
    result = run(options.source, options.runs, options.seed)
    command = COMMAND.format(seed=options.seed)
    commit = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True, cwd=HERE)
    scores = {
        "command": command,
        "commit": commit.stdout.strip(),
        "machine": f"{platform.machine()}, one thread",
        "seed": options.seed,
        "epochs": result.epochs,
        "best_validation_loss": result.best_loss,
        "best_epoch": result.best_epoch,
        "reference_validation_loss": REFERENCE,
        "first_epoch_at_or_below_reference": first_epoch_below(result.folder / "log.csv", REFERENCE),
    }
    (HERE / "results" / "elephant.json").write_text(json.dumps(scores, indent=2) + "\n")
    print(json.dumps(scores, indent=2))
    if options.ship:
        result.model.card |= {"description": DESCRIPTION, "command": command}
        result.model.save(HERE.parent / "src" / "neusub" / "weights" / "elephant.safetensors")


if __name__ == "__main__":
    main()
