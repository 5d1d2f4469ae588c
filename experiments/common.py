"""What the experiments share: their options, where their numbers come from, scores against a reference."""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from PIL import Image

import neusub
from neusub.files import replacing
from neusub.training import TrainingResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HERE = Path(__file__).parent
RESULTS = HERE / "results"
PICTURES = HERE.parent / "docs" / "reproduction"
TOSCA = "TOSCA: Bronstein, Bronstein, Kimmel 2008, Numerical Geometry of Non-Rigid Shapes"


def parser_of(module: str, doc: str | None) -> argparse.ArgumentParser:
    """The options that every experiment with a training has."""
    parser = argparse.ArgumentParser(prog=f"python -m {module}", description=doc,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="pairs and trainings; both go on after a stop")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    return parser


def checked_out() -> str:
    """The commit, and whether tracked files differ from it."""
    def git(*words: str) -> str:
        return subprocess.run(["git", *words], capture_output=True, text=True, check=True, cwd=HERE).stdout.strip()

    return git("rev-parse", "HEAD") + (" with changes" if git("status", "--porcelain", "-uno") else "")


COMMIT = checked_out()  # of the code as it was read, not of what is there when a long run ends


def provenance(options: argparse.Namespace) -> dict:
    """Command, commit, machine and seed, as they stand in every result."""
    shown = [Path(word).name if "/" in word else word for word in sys.argv[1:]]  # no path of a machine
    return {"command": " ".join([sys.argv[0], *shown]), "commit": COMMIT,
            "machine": f"{platform.machine()}, {torch.get_num_threads()} thread(s), torch {torch.__version__}",
            "seed": getattr(options, "seed", 0)}


def write_results(name: str, numbers: dict) -> Path:
    path = RESULTS / f"{name}.json"
    path.write_text(json.dumps(numbers, indent=2) + "\n")
    print(f"{path}")
    return path


def write_picture(name: str, image: Image.Image, folder: Path = PICTURES, lossless: bool = False) -> Path:
    """Of the documentation, as WebP: half of the bytes of a PNG in few colours."""
    path = folder / f"{name}.webp"
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as new:
        image.convert("RGB").save(new, quality=90, method=6, lossless=lossless)
    return path


def write_chart(name: str, figure: Figure) -> Path:
    """Lines on a plain ground are smaller without losses."""
    file = BytesIO()
    figure.savefig(file, format="png")
    return write_picture(name, Image.open(file), lossless=True)


SCHEMES = ("midpoint", "loop", "butterfly")


@cache
def loaded(model: str) -> neusub.Subdivider:
    return neusub.Subdivider.load(model)


def refined(mesh: neusub.Mesh, method: str, levels: int, kind: str = "on_surface") -> list[neusub.Mesh]:
    """Levels of a scheme or of a shipped model, which is told the kind of input where its card names weights for it."""
    if method in SCHEMES:
        return neusub.subdivide(mesh, method, levels)  # type: ignore[arg-type]
    model = loaded(method)
    given = kind if kind in model.card.get("companions", {}) else None
    return model.subdivide(mesh, levels, input=given)  # type: ignore[arg-type]


def training_scores(result: TrainingResult) -> dict:
    return {"epochs": result.epochs, "best_validation_loss": result.best_loss, "best_epoch": result.best_epoch,
            "seconds": round(result.seconds)}


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


def score(result: neusub.Mesh, reference: neusub.Mesh, seeds: Iterable[int] = range(1)) -> tuple[float, float]:
    """H and M in the reference's units, means over sampling seeds."""
    draws = [neusub.distance(result, reference, seed=seed) for seed in seeds]
    return float(np.mean([d.hausdorff for d in draws])), float(np.mean([d.mean for d in draws]))


def volume(mesh: neusub.Mesh) -> float:
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    return float((a * np.cross(b, c)).sum() / 6)
