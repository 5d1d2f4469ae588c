"""Ablation: what each choice in the network, in its inputs and in its loss does to convergence.

    python -m experiments ablation cartoon_elephant.npz                            # 200 pairs, 200 epochs, 3 seeds
    python -m experiments ablation cartoon_elephant.npz --epochs 700 --seeds 1
    python -m experiments ablation cartoon_elephant.npz --pairs 16 --epochs 40     # a quarter of an hour
    python -m experiments ablation cartoon_elephant.npz --device cuda              # steps recorded as CUDA graphs

The source is the authors' public pairs, or a fine mesh of which pairs are made.  Each training (variant, seed, epochs,
pairs) is one entry of results/ablation.json, written when it is done; what is there is skipped, and a training that was
stopped goes on where it was when the command is repeated.  The pictures, docs/reproduction/ablation_<epochs>.webp,
are of the settings with the most pairs that all studies have.  "Relative" variants measure lengths in units of each
half-flap's mean edge.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
import torch

import neusub
from experiments.common import RESULTS, parsed, parser_of, provenance
from experiments.drawing import write_chart
from experiments.variants import NETWORKS, Fit, LastLevel, fit
from neusub import PairConfig, TrainingConfig, import_pairs
from neusub.files import replacing
from neusub.generation import Batch, Pair, batch_pairs, load_pairs, pair_files, save_pairs

SHOWS = ("app:ablation",)
PAPER, LAST = "paper", "loss on the last level"
STUDIES = {  # of the paper's insets: the variants beside the paper's choice, and the level whose error is drawn
    "differential coordinates": (("no differential coordinates",), None),
    "levels in the loss": ((LAST,), 1),
    "start of the displacement": (("from Loop",), None),
    "vertex steps": (("2 vertex steps", "3 vertex steps"), None),
    "inputs": (("MeshCNN features", "MeshCNN features, relative", "relative lengths"), None),
}
VARIANTS = (PAPER, *(name for names, _ in STUDIES.values() for name in names))
POINTS = 60  # of a curve that is kept
RESULT = RESULTS / "ablation.json"


# --- trainings ---------------------------------------------------------------------------------------------------


def pairs_of(options: argparse.Namespace) -> tuple[list[Pair], list[Pair]]:
    """The authors' pairs, or pairs of a mesh, the same for all seeds; as many as are asked for, and 10 held out."""
    if options.source.suffix == ".npz":
        folder = options.runs / "ablation" / "elephant"
        if not (folder / "train.safetensors").exists():
            import_pairs(options.source, folder, licence="MPL-2.0")
        train, validation = pair_files(folder)
    else:
        config = PairConfig(total=options.pairs, validation=10)
        folder = options.runs / "ablation" / f"{options.source.stem}-{options.pairs}"
        report = neusub.make_pairs([options.source], folder, config, workers=options.threads)
        train, validation = report.train, report.validation
    return load_pairs(train[0])[: options.pairs], load_pairs(validation[0])[: 2 if options.quick else 10]


def trained(variant: str, seed: int, batches: tuple[list[Batch], list[Batch]], options: argparse.Namespace) -> Fit:
    if variant == LAST:
        batches = tuple([LastLevel(**vars(batch)) for batch in group] for group in batches)  # type: ignore[assignment]
    config = TrainingConfig(epochs=options.epochs, seed=seed, threads=options.threads)
    name = f"{options.source.stem}-{options.pairs}-{options.epochs}-{variant.replace(' ', '-')}-{seed}.pt"
    checkpoint = None if options.quick else options.runs / "ablation" / name
    return fit(NETWORKS[PAPER if variant == LAST else variant], *batches, config, checkpoint)


def check_against_train(pairs: list[Pair], threads: int) -> None:
    """The loop here gives the losses of `neusub.train`, bit for bit; raises RuntimeError where it does not."""
    pairs, config, rows = pairs[:3], TrainingConfig(epochs=2, threads=threads, device="cpu"), []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "pairs.safetensors"
        save_pairs(pairs, file, {})
        neusub.train([file], [file], Path(folder) / "run", config, on_epoch=rows.append)
    batches = [batch_pairs([pair]) for pair in pairs]
    here = fit(NETWORKS[PAPER], batches, batches, config).losses
    if [row["validation_loss"] for row in rows] != here.tolist():
        raise RuntimeError(f"losses {here.tolist()} are not those of neusub.train.")


def device_name(device: torch.device) -> str:
    return torch.cuda.get_device_name(device) if device.type == "cuda" else device.type


def entry_of(variant: str, seed: int, result: Fit, options: argparse.Namespace) -> dict:
    """What is kept of a training: errors of each level in the best epoch, and curves of a few points."""
    epochs = np.unique(np.linspace(1, options.epochs, min(POINTS, options.epochs)).round().astype(int))
    levels = {f"level {k}": [float(f"{value:.4g}") for value in column[epochs - 1]]
              for k, column in enumerate(result.errors.T)}
    return {"variant": variant, "seed": seed, "pairs": options.pairs, "epochs": options.epochs,
            "source": options.source.name, "device": device_name(options.device), "cpu_seconds": round(result.seconds),
            "best_epoch": result.best_epoch,
            "best_errors": [float(f"{value:.6g}") for value in result.errors[result.best_epoch - 1]],
            "curve": {"epoch": epochs.tolist(), **levels},
            **{key: value for key, value in provenance(options).items() if key != "seed"}}


# --- entries -----------------------------------------------------------------------------------------------------


def entries() -> list[dict]:
    return json.loads(RESULT.read_text())["entries"] if RESULT.exists() else []


def key_of(entry: dict) -> tuple:
    return entry["source"], entry["pairs"], entry["epochs"], entry["variant"], entry["seed"]


def keep(entry: dict) -> None:
    """Add an entry to the file, whole or not at all: one line each."""
    known = sorted([*entries(), entry], key=key_of)
    summary = {name: json.dumps(rows) for name, rows in summaries(known).items()}
    text = '{"summary": {\n' + ",\n".join(f"{json.dumps(name)}: {rows}" for name, rows in summary.items())
    text += '\n},\n"entries": [\n' + ",\n".join(map(json.dumps, known)) + "\n]}\n"
    with replacing(RESULT) as new:
        new.write_text(text)


def settings(known: list[dict]) -> list[tuple]:
    return sorted({key_of(entry)[:3] for entry in known}, key=lambda setting: setting[1] * setting[2])


def variants_of(known: list[dict], setting: tuple) -> set[str]:
    return {entry["variant"] for entry in known if key_of(entry)[:3] == setting}


def summaries(known: list[dict]) -> dict[str, dict]:
    """Of each setting and variant: means over the seeds of the best epoch's errors, of their sum, and its spread."""
    out: dict = {}
    for setting in settings(known):
        source, pairs, epochs = setting
        rows = out[f"{source}, {pairs} pairs, {epochs} epochs"] = {}
        for variant in VARIANTS:
            chosen = [entry for entry in known if key_of(entry)[:4] == (*setting, variant)]
            if chosen:
                errors = np.array([entry["best_errors"] for entry in chosen])
                cpu = [entry["cpu_seconds"] for entry in chosen if entry.get("device", "cpu") == "cpu"]
                rows[variant] = {"seeds": len(chosen), "levels": errors.mean(axis=0).tolist(),
                                 "sum": float(errors.sum(axis=1).mean()), "deviation": float(errors.sum(axis=1).std()),
                                 "cpu_seconds": float(np.mean(cpu)) if cpu else None}
    return out


# --- picture -----------------------------------------------------------------------------------------------------


def curves(known: list[dict], setting: tuple, variant: str, level: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Epochs, and of each seed the error of a level, or of all together."""
    chosen = [entry["curve"] for entry in known if key_of(entry)[:4] == (*setting, variant)]
    rows = []
    for curve in chosen:
        keys = [key for key in curve if key.startswith("level")] if level is None else [f"level {level}"]
        rows.append(np.sum([curve[key] for key in keys], axis=0))
    return np.array(chosen[0]["epoch"]), np.array(rows)


def draw(known: list[dict]) -> list[Path]:
    """A picture for each number of epochs at the largest size of which every study has something."""
    groups = [{PAPER}, *(set(names) for names, _ in STUDIES.values())]
    whole = [setting for setting in settings(known) if all(names & variants_of(known, setting) for names in groups)]
    most = max((setting[1] for setting in whole), default=0)
    return [draw_setting(known, setting) for setting in whole if setting[1] == most]


def draw_setting(known: list[dict], setting: tuple) -> Path:
    """Validation error against epochs, a panel a study: mean over the seeds, and their range."""
    from matplotlib.figure import Figure

    _, pairs, epochs = setting
    done = variants_of(known, setting)
    figure = Figure(figsize=(10.5, 6), dpi=100, layout="constrained")
    panels = figure.subplots(2, 3).reshape(-1)
    for axes, (study, (names, level)) in zip(panels, STUDIES.items()):
        for variant in (name for name in (PAPER, *names) if name in done):
            at, rows = curves(known, setting, variant, level)
            title = "the paper's network" if variant == PAPER else variant
            line, = axes.semilogy(at, rows.mean(axis=0), label=f"{title} ({len(rows)})")
            axes.fill_between(at, rows.min(axis=0), rows.max(axis=0), alpha=0.2, color=line.get_color(), lw=0)
        axes.set(title=study, xlabel="epoch", ylabel=f"error of {'all levels' if level is None else f'level {level}'}")
        axes.grid(alpha=0.3, which="both")
        axes.margins(y=0.2)  # room for the legend
        axes.legend(fontsize=8)
    panels[-1].axis("off")
    note = ("Error: mean square of a coordinate\non 10 held out pairs.\n"
            "Line: mean over the seeds (their number\nin brackets); band: range.")
    panels[-1].text(0, 0.5, f"{pairs} pairs, {epochs} epochs.\n{note}", va="center")
    return write_chart(f"ablation_{epochs}", figure)


def main() -> None:
    parser = parser_of("experiments ablation", __doc__, "6 pairs, 3 epochs, one seed", trains=True)
    parser.add_argument("source", type=Path, help="cartoon_elephant.npz, the authors' public pairs; or a fine mesh")
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--epochs", type=int, default=200)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", nargs="+", choices=VARIANTS, default=VARIANTS, help="variants; all by default")
    parser.add_argument("--device", type=torch.device, default="cpu", help="where to train: cpu or cuda")
    options = parsed(parser)
    if options.quick:
        options.pairs, options.epochs, options.seeds = 6, 3, 1
    train, validation = pairs_of(options)
    options.pairs = len(train)
    check_against_train(train, options.threads)
    batches = tuple([batch_pairs([pair], device=options.device) for pair in group] for group in (train, validation))
    for seed in range(options.seed, options.seed + options.seeds):
        for variant in options.only:
            key = options.source.name, options.pairs, options.epochs, variant, seed
            if not options.quick and key in map(key_of, entries()):
                continue
            entry = entry_of(variant, seed, trained(variant, seed, batches, options), options)
            print(f"{variant:30s} seed {seed}: {sum(entry['best_errors']):.4e} in epoch {entry['best_epoch']}, "
                  f"levels {entry['best_errors']}, {entry['cpu_seconds']} s", flush=True)
            if not options.quick:
                keep(entry)
    if not options.quick:
        print(*draw(entries()))


if __name__ == "__main__":
    main()
