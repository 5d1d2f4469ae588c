"""Commands for those who train: pairs, import-pairs, train, models."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from neusub.cli_shared import Output, app, for_each, progress_bar, say
from neusub.configuration import PRESETS, Input, Loss, PairConfig, TrainingConfig, Weighting
from neusub.errors import PairFileError

__all__: list[str] = []


@app.command(name="import-pairs")
def import_pairs_command(source: Positional[Path], /, output: Output, *, licence: str = "not stated") -> int:
    """Read the authors' training pairs (npz, or folders subd0, subd1, ... of OBJ files) into pair files.

    Args:
        source: The npz file or the folder.
        output: The folder for train.safetensors and validation.safetensors.
        licence: Of the source, for the files' headers and the cards of models.
    """
    def work(path: Path) -> list[str]:
        from neusub.generation import read_header
        from neusub.importing import import_pairs

        return [f"{file}: {read_header(file)['count']} pairs" for file in import_pairs(path, output, licence=licence)]

    return for_each((source,), work)


@app.command(name="pairs")
def pairs_command(
    sources: Positional[tuple[Path, ...]],
    /,
    output: Output,
    *,
    per_mesh: int | None = None,
    total: int | None = None,
    validation: int = 0,
    vertices: str = "150:300",
    levels: int = 2,
    strategy: str = "random",
    seed: int = 0,
    workers: int | None = None,
    licence: str = "not stated",
    strict: bool = False,
) -> int:
    """Make training pairs from fine meshes: random decimations, and the map back for every new vertex.

    Args:
        sources: Fine meshes.
        output: The folder; a call that was interrupted goes on there.
        per_mesh: Training pairs of each source; or
        total: Training pairs of all sources together, spread evenly (200 by default, as in the paper).
        validation: Pairs held out, of all sources together.
        vertices: Of the coarse meshes, FEWEST:MOST.
        levels: Levels of refinement.
        strategy: Which edge collapses next (see 'neusub decimate').
        seed: Of everything random; the same seed gives the same files.
        workers: Threads; all cores by default.
        licence: Of the sources, for the files' headers and the cards of models.
        strict: Stop at the first source that fails, instead of going on with the others.
    """
    def work(folder: Path) -> list[str]:
        from neusub.discretization import make_pairs
        from neusub.generation import read_header

        low, _, high = vertices.partition(":")
        if not (low.isdigit() and (high or low).isdigit()):
            raise ValueError(f"vertices = {vertices!r}: write FEWEST:MOST, such as 150:300.")
        config = PairConfig(per_mesh, 200 if per_mesh is None and total is None else total, validation,
                            (int(low), int(high or low)), levels, strategy, seed)
        with progress_bar("blocks of pairs") as update:
            report = make_pairs(sources, folder, config, workers=workers, strict=strict, licence=licence,
                                on_task=update)
        for path in (*report.train, *report.validation):
            header = read_header(path)
            numbers = ", ".join(f"{key} {value:.4g}" for key, value in header["report"].items())
            say(f"{path}: {header['count']} pairs; {numbers}")
        if report.failed:
            reasons = "; ".join(f"{name}: {reason}" for name, reason in report.failed.items())
            raise PairFileError(f"{len(report.failed)} of {len(sources)} sources failed. {reasons}")
        return [f"{report.manifest}"]

    return for_each((output,), work)


@app.command(name="train")
def train_command(
    pairs: Positional[tuple[Path, ...]],
    /,
    out: Output,
    *,
    validation: tuple[Path, ...] = (),
    preset: Literal["paper", "fast", "default", "default-decimated"] = "paper",
    start: str | None = None,
    epochs: int | None = None,
    cycles: int | None = None,
    batch: int | None = None,
    learning_rate: float | None = None,
    levels: int | None = None,
    input: Input | None = None,
    loss: Loss | None = None,
    weighting: Weighting | None = None,
    normals: float | None = None,
    seed: int | None = None,
    device: str | None = None,
    threads: int | None = None,
    resume: bool = False,
) -> int:
    """Train a network from pair files; the best weights go to OUT/model.safetensors.

    Args:
        pairs: Pair files, or folders that 'neusub pairs' or 'neusub import-pairs' wrote.
        out: Folder for the model, checkpoint.safetensors, log.csv and TensorBoard events.
        validation: Pair files, or folders of them, to choose the best epoch by.
        preset: paper: one mesh a step, Adam 2e-3, 700 epochs (the model's displacements are bounded, the paper's and
            the training's are not); fast: four a step, cosine schedule, 400 epochs; default:
            the network that 'neusub subdivide' uses, which knows no scale and has bounds; default-decimated: the same
            for decimated vertices.
        start: A model (name or file) whose weights the run begins with, in place of random ones: fine-tuning. Its
            network is the preset's.
        epochs: Instead of the preset's; so are the following.
        cycles: How often the learning rate of a cosine schedule goes down and starts anew; a divisor of the epochs. A
            run goes on for another: so many times the epochs and the cycles, with --resume.
        batch: Meshes a step.
        learning_rate: Of Adam.
        levels: Levels of the network.
        input: Where the coarse vertices lie.
        loss: Squared errors as in the paper; distances, which a few bad targets do not carry; or distances to the
            surface, with less weight along it.
        weighting: Each vertex's error counts the same, or by the area around it.
        normals: Weight of the error of the faces' normals beside that of positions, for smoothness: 0 or, say, 0.03.
        seed: Of weights and order.
        device: auto, cpu, cuda, ...
        threads: CPU threads.
        resume: Go on with the run in OUT.
    """
    given = {"epochs": epochs, "cycles": cycles, "batch": batch, "learning_rate": learning_rate, "levels": levels,
             "input": input, "loss": loss, "weighting": weighting, "normals": normals, "seed": seed,
             "device": device, "threads": threads}

    def work(_: Path) -> list[str]:
        training, held_out = chosen_files(pairs, validation)
        config = replace(PRESETS[preset], **{key: value for key, value in given.items() if value is not None})
        result = train_with_progress(training, held_out, out, config, start, resume)
        kind, bounded = ("training", "") if result.loss_in_use is None else (
            "validation", f"(of the model with its bounds: {result.loss_in_use:.6e}) ")
        return [f"best {kind} loss {result.best_loss:.6e} {bounded}in epoch {result.best_epoch} of {result.epochs}, "
                f"{result.seconds:.0f} s: {out / 'model.safetensors'}"]

    return for_each((out,), work)


@app.command(name="models")
def models_command() -> int:
    """List the models that come with neusub, and what each is for."""
    from neusub.subdivider import Subdivider, model_names

    for name in model_names():
        card = Subdivider.load(name, device="cpu").card
        say(f"{name}: {card.get('description', '')} [input: {card['input']}; licence: {card.get('licence', '')}]")
    return 0


def chosen_files(pairs: tuple[Path, ...], validation: tuple[Path, ...]) -> tuple[list[Path], list[Path]]:
    """Files to learn from, and those held out: of the folders of `pairs`, or else of `validation`."""
    from neusub.generation import pair_files

    training, held_out = [], []
    for path in pairs:
        files = pair_files(path) if path.is_dir() else ([path], [])
        training += files[0]
        held_out += [] if validation else files[1]
    for path in validation:
        files = pair_files(path) if path.is_dir() else ([], [path])
        held_out += files[1] or files[0]
    return training, held_out


def train_with_progress(training: list, held_out: list, out: Path, config: TrainingConfig, start: str | None,
                        resume: bool):
    """`training.train` with a bar that shows the losses and the time left."""
    from neusub.subdivider import Subdivider
    from neusub.training import train

    model = Subdivider.load(start, device="cpu") if start else None

    with progress_bar("epoch") as update:
        def on_epoch(row: dict) -> None:
            update(row["epoch"], config.epochs, f"validation {row['validation_loss']:.3e}, best {row['best_loss']:.3e} "
                   f"(epoch {row['best_epoch']})")

        return train(training, held_out, out, config, start=model, resume=resume, on_epoch=on_epoch)
