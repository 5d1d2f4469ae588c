"""What the experiments share: their options, where their numbers come from and where they go, TOSCA."""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import torch

import neusub
from neusub.files import replacing
from neusub.training import TrainingResult

HERE = Path(__file__).parent
RESULTS = HERE / "results"
TOSCA = "TOSCA: Bronstein, Bronstein, Kimmel 2008, Numerical Geometry of Non-Rigid Shapes"


# --- options -----------------------------------------------------------------------------------------------------


def parser_of(module: str, doc: str | None, quick: str, *, trains: bool = False) -> argparse.ArgumentParser:
    """The options that every experiment has; `quick` says what --quick leaves out.  trains: those of trainings, too."""
    commit()  # of the code as it is read now, not of what is there when a long run ends
    parser = argparse.ArgumentParser(prog=f"python -m {module}", description=doc,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    if trains:
        parser.add_argument("--runs", type=Path, default=Path("runs"),
                            help="pairs and trainings; both go on after a stop")
        parser.add_argument("--seed", type=int, default=0, help="with another one, pictures are not drawn")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help=f"{quick}; nothing is written{' but runs' * trains}")
    return parser


def parsed(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """The options; torch takes as many threads as they say."""
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    return options


def seed_of(options: argparse.Namespace) -> int:
    return getattr(options, "seed", 0)


def seeded(name: str, options: argparse.Namespace) -> str:
    """The name of a folder or of results: every seed has its own."""
    return f"{name}-seed{seed_of(options)}" if seed_of(options) else name


def draws(options: argparse.Namespace) -> bool:
    """Whether pictures are drawn: those of the documentation are seed 0's."""
    return not options.quick and not seed_of(options)


# --- results -----------------------------------------------------------------------------------------------------


@cache
def commit() -> str:
    """The commit, and whether the code differs from it; what experiments write does not count."""
    def git(*words: str) -> str:
        return subprocess.run(["git", *words], capture_output=True, text=True, check=True, cwd=HERE.parent).stdout

    try:
        changes = git("status", "--porcelain", "-uno", "--", "src", "experiments", ":!experiments/results")
        return git("rev-parse", "HEAD").strip() + (" with changes" if changes else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def processor() -> str:
    """The processor's model, where Linux tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def provenance(options: argparse.Namespace) -> dict:
    """Command, commit, machine and seed, as they stand in every result."""
    shown = [Path(word).name if "/" in word else word for word in sys.argv[1:]]  # no path of a machine
    return {"command": " ".join([sys.argv[0], *shown]), "commit": commit(),
            "machine": f"{processor()}, {torch.get_num_threads()} thread(s), torch {torch.__version__}",
            "seed": seed_of(options)}


def write_results(name: str, numbers: dict, options: argparse.Namespace) -> None:
    """The whole of results/NAME.json; with --quick nothing."""
    if not options.quick:
        replace_results(seeded(name, options), numbers)


def add_result(name: str, keys: Sequence[str], part: dict, options: argparse.Namespace) -> None:
    """A part of results/NAME.json at these keys; what other runs have added meanwhile stays.  With --quick nothing."""
    if options.quick:
        return
    numbers = here = read_results(name)
    for key in keys[:-1]:
        here = here.setdefault(key, {})
    here[keys[-1] + (f", seed {seed_of(options)}" if seed_of(options) else "")] = part
    replace_results(name, numbers)


def read_results(name: str) -> dict:
    path = RESULTS / f"{name}.json"
    return json.loads(path.read_text()) if path.exists() else {}


def replace_results(name: str, numbers: dict) -> None:
    path = RESULTS / f"{name}.json"
    with replacing(path) as new:
        new.write_text(json.dumps(numbers, indent=2) + "\n")
    print(path)


# --- trainings ---------------------------------------------------------------------------------------------------


def training_scores(result: TrainingResult) -> dict:
    return {"epochs": result.epochs, "best_validation_loss": result.best_loss, "best_epoch": result.best_epoch,
            "validation_loss_in_use": result.loss_in_use, "seconds": round(result.seconds)}


def ship(name: str, command: str, description: str, result: TrainingResult) -> None:
    """Make the best weights the package's model NAME."""
    result.model.card |= {"description": description, "command": command}
    result.model.save(HERE.parent / "src" / "neusub" / "weights" / f"{name}.safetensors")


def show(row: dict) -> None:
    print(f"epoch {row['epoch']}: training {row['training_loss']:.4e}, validation {row['validation_loss']:.4e}, "
          f"best {row['best_loss']:.4e}, {row['seconds_left']:.0f} s left", flush=True)


# --- TOSCA -------------------------------------------------------------------------------------------------------


def tosca_poses(folder: Path, category: str) -> dict[int, neusub.Mesh]:
    """All poses of a category, in TOSCA's units."""
    with np.load(folder / f"{category}.npz") as data:
        faces = data["F"].astype(np.int64)
        return {int(pose): neusub.Mesh(vertices.astype(np.float64), faces)
                for pose, vertices in zip(data["pose"], data["V"])}


def fixed_inputs(file: Path, kind: str) -> dict[str, neusub.Mesh]:
    """The coarse meshes of the fixed benchmark: kind is `on_surface` or `decimated`."""
    with np.load(file) as data:
        names = sorted({key.split("/")[0] for key in data})
        return {name: neusub.Mesh(data[f"{name}/{kind}"].astype(np.float64), data[f"{name}/faces"].astype(np.int64))
                for name in names}


def fixed_reference(folder: Path, category: str) -> neusub.Mesh:
    return tosca_poses(folder, category)[1 if category == "gorilla" else 0]
