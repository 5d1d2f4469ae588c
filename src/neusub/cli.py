"""The command line: each command is a thin layer over a public function, imported when it runs."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import Positional, arg

from neusub.configuration import PRESETS, TrainingConfig

app = tyro.extras.SubcommandApp()
Output = Annotated[Path, arg(aliases=["-o"])]


@app.command(name="subdivide")
def subdivide_command(
    inputs: Positional[tuple[Path, ...]],
    /,
    output: Output,
    *,
    scheme: Literal["neural", "loop", "butterfly", "midpoint"] = "neural",
    model: str | None = None,
    levels: int = 2,
    limit_levels: int = 0,
    scale: Literal["edge", "box", "none"] = "edge",
    crease_angle: float | None = None,
    all_levels: bool = False,
    device: str = "auto",
    overwrite: bool = False,
) -> int:
    """Refine meshes with a trained network or a classical scheme.

    Args:
        inputs: Mesh files: OBJ, PLY, STL, OFF, GLB.
        output: A file; with several inputs, a folder.
        scheme: The network, or a classical scheme.
        model: A model's name (see 'neusub models') or its file.
        levels: How often each triangle is split into four.
        limit_levels: Levels of classic Loop after the network's.
        scale: What is brought to the training's scale: each part's mean edge, the whole box, or nothing.
        crease_angle: Loop and butterfly keep edges sharper than this (degrees).
        all_levels: Write each level, as NAME.level0, NAME.level1, ...
        device: auto, cpu, cuda, ...
        overwrite: Replace files that exist.
    """
    check_output(inputs, output)

    def work(path: Path) -> list[str]:
        target = output / path.name if len(inputs) > 1 or output.is_dir() else output
        stem = target.with_suffix("")
        targets = [Path(f"{stem}.level{k}{target.suffix}") for k in range(levels + limit_levels + 1)]
        targets = targets if all_levels else [target]
        from neusub.io import KINDS, load, save

        check_free(targets, overwrite, KINDS)

        mesh = load(path)
        notes = [f"{path}: {line}" for line in mesh.load_report]
        from neusub.subdivider import DEFAULT_MODEL, subdivide

        results = subdivide(mesh, scheme, levels, model=model or DEFAULT_MODEL, limit_levels=limit_levels,
                            scale=scale, device=device, crease_angle=crease_angle)
        for level, place in zip(results[-len(targets) :], targets):
            save(level, place, overwrite=overwrite)
        return [*notes, f"{path}: {len(mesh.faces):,} -> {len(results[-1].faces):,} faces: {targets[-1]}"]

    return for_each(inputs, work)


@app.command(name="info")
def info_command(meshes: Positional[tuple[Path, ...]], /) -> int:
    """Print sizes, components, genus, boundary, quality and every problem of meshes.

    Args:
        meshes: Mesh files.
    """
    def work(path: Path) -> list[str]:
        from neusub.io import read
        from neusub.repair import info

        raw = read(path)
        return [f"{path}", *raw.report, str(info(raw))]

    return for_each(meshes, work)


@app.command(name="repair")
def repair_command(
    mesh: Positional[Path],
    /,
    output: Output,
    *,
    split_edges: bool = False,
    split_vertices: bool = False,
    overwrite: bool = False,
) -> int:
    """Fix what can be fixed without guessing, and say what was changed.

    Args:
        mesh: A mesh file.
        output: The repaired file.
        split_edges: Also take edges with three or more faces apart.
        split_vertices: Also give each fan of faces at a vertex its own vertex.
        overwrite: Replace a file that exists.
    """
    def work(path: Path) -> list[str]:
        from neusub.io import KINDS, read, save
        from neusub.repair import repair

        check_free([output], overwrite, KINDS)
        repaired, report = repair(read(path), split_edges=split_edges, split_vertices=split_vertices)
        save(repaired, output, overwrite=overwrite)
        return [*(report or ["nothing to repair"]), f"{path} -> {output}"]

    return for_each((mesh,), work)


@app.command(name="evaluate")
def evaluate_command(
    result: Positional[Path], reference: Positional[Path], /, *, samples: int = 20_000, seed: int = 0
) -> int:
    """Distances between two surfaces: Hausdorff, mean, normals, flipped and degenerate triangles.

    Args:
        result: The mesh to be judged.
        reference: The mesh it should be.
        samples: Points on each surface.
        seed: Of the samples.
    """
    def work(path: Path) -> list[str]:
        from neusub.io import load
        from neusub.metrics import distance

        return [str(distance(load(path), load(reference), samples=samples, seed=seed))]

    return for_each((result,), work)


@app.command(name="render")
def render_command(
    meshes: Positional[tuple[Path, ...]],
    /,
    output: Output,
    *,
    smooth: bool = False,
    wireframe: bool = False,
    reference: Path | None = None,
    titles: tuple[str, ...] = (),
    overwrite: bool = False,
) -> int:
    """Draw meshes side by side into a PNG, off-screen.

    Args:
        meshes: Mesh files.
        output: The PNG.
        smooth: Smooth shading instead of flat.
        wireframe: Draw the edges.
        reference: Colour by the distance to this mesh.
        titles: One for each mesh; the file names by default.
        overwrite: Replace a file that exists.
    """
    def work(path: Path) -> list[str]:
        check_free([output], overwrite, (".png",))
        from neusub.io import load
        from neusub.pictures import render

        render([load(mesh) for mesh in meshes], output, titles=list(titles) or [mesh.stem for mesh in meshes],
               smooth=smooth, wireframe=wireframe, reference=load(reference) if reference else None)
        return [f"{path}"]

    return for_each((output,), work)


@app.command(name="import-pairs")
def import_pairs_command(source: Positional[Path], /, output: Output, *, licence: str = "not stated") -> int:
    """Read the authors' training pairs (npz, or folders subd0, subd1, ... of OBJ files) into pair files.

    Args:
        source: The npz file or the folder.
        output: The folder for train.safetensors and validation.safetensors.
        licence: Of the source, for the files' headers and the cards of models.
    """
    def work(path: Path) -> list[str]:
        from neusub.generation import import_pairs, read_header

        return [f"{file}: {read_header(file)['count']} pairs" for file in import_pairs(path, output, licence=licence)]

    return for_each((source,), work)


@app.command(name="train")
def train_command(
    pairs: Positional[tuple[Path, ...]],
    /,
    out: Output,
    *,
    validation: tuple[Path, ...] = (),
    preset: Literal["paper", "fast"] = "paper",
    epochs: int | None = None,
    batch: int | None = None,
    learning_rate: float | None = None,
    levels: int | None = None,
    input: Literal["on_surface", "decimated"] | None = None,
    seed: int | None = None,
    device: str | None = None,
    threads: int | None = None,
    resume: bool = False,
) -> int:
    """Train a network from pair files; the best weights go to OUT/model.safetensors.

    Args:
        pairs: Pair files, or a folder with train.safetensors and validation.safetensors.
        out: Folder for the model, checkpoint.safetensors, log.csv and TensorBoard events.
        validation: Pair files to choose the best epoch by.
        preset: paper: one mesh a step, Adam 2e-3, 700 epochs; fast: four a step, cosine schedule, 400 epochs.
        epochs: Instead of the preset's; so are the following.
        batch: Meshes a step.
        learning_rate: Of Adam.
        levels: Levels of the network.
        input: Where the coarse vertices lie.
        seed: Of weights and order.
        device: auto, cpu, cuda, ...
        threads: CPU threads.
        resume: Go on with the run in OUT.
    """
    given = {"epochs": epochs, "batch": batch, "learning_rate": learning_rate, "levels": levels, "input": input,
             "seed": seed, "device": device, "threads": threads}
    training, held_out = list(pairs), list(validation)
    for folder in [path for path in pairs if path.is_dir()]:
        at = training.index(folder)
        training[at] = folder / "train.safetensors"
        if (folder / "validation.safetensors").exists() and not validation:
            held_out.append(folder / "validation.safetensors")

    def work(_: Path) -> list[str]:
        config = replace(PRESETS[preset], **{key: value for key, value in given.items() if value is not None})
        result = train_with_progress(training, held_out, out, config, resume)
        return [f"best validation loss {result.best_loss:.6e} in epoch {result.best_epoch} of {result.epochs}, "
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


# --- shared ------------------------------------------------------------------------------------------------------


def train_with_progress(training: list, held_out: list, out: Path, config: TrainingConfig, resume: bool):
    """`training.train` with a bar that shows the losses and the time left."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from neusub.training import train

    columns = (TextColumn("epoch"), MofNCompleteColumn(), BarColumn(), TimeRemainingColumn(),
               TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("", total=config.epochs)

        def on_epoch(row: dict) -> None:
            progress.update(task, completed=row["epoch"], description=f"validation {row['validation_loss']:.3e}, "
                            f"best {row['best_loss']:.3e} (epoch {row['best_epoch']})")

        return train(training, held_out, out, config, resume=resume, on_epoch=on_epoch)


def say(line: str, *, error: bool = False) -> None:
    (sys.stderr if error else sys.stdout).write(f"{line}\n")


def check_output(inputs: tuple[Path, ...], output: Path) -> None:
    """With several inputs the output is a folder, which is made; two inputs never share a name there."""
    if len(inputs) <= 1:
        return
    from neusub.errors import MeshFileError
    from neusub.io import KINDS

    if output.suffix.lower() in KINDS or output.is_file():
        raise MeshFileError(f"{output}: with {len(inputs)} inputs the output is a folder. Give one with -o.")
    names = [path.name for path in inputs]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise MeshFileError(f"{twice}: several inputs have this name and would overwrite each other in {output}.")
    output.mkdir(parents=True, exist_ok=True)


def check_free(paths: list[Path], overwrite: bool, suffixes: tuple[str, ...]) -> None:
    """No output may exist unless it is to be overwritten; its folder must, and its kind be one that can be written."""
    from neusub.errors import MeshFileError

    for path in paths:
        if path.suffix.lower() not in suffixes:
            raise MeshFileError(f"{path} has the extension {path.suffix!r}. Known are: {', '.join(suffixes)}.")
        if path.exists() and not overwrite:
            raise MeshFileError(f"{path} exists. Pass --overwrite to replace it.")
        if not path.parent.is_dir():
            raise MeshFileError(f"{path}: the folder {path.parent} does not exist. Make it first.")


def for_each(paths: tuple[Path, ...], work: Callable[[Path], list[str]]) -> int:
    """Do the work for each path, say a line for each that fails; the exit status: 1 if any failed."""
    from rich.progress import track

    from neusub.errors import NeusubError

    if not paths:
        say("neusub: give at least one file", error=True)
        return 2
    failed = 0
    for path in track(paths, transient=True) if len(paths) > 1 and sys.stderr.isatty() else paths:
        try:
            for line in work(path):
                say(line)
        except (NeusubError, ValueError, OSError) as error:
            failed += 1
            say(f"neusub: {path}: {type(error).__name__}: {error}", error=True)
    if failed and len(paths) > 1:
        say(f"neusub: {failed} of {len(paths)} failed", error=True)
    return int(failed > 0)


def main() -> None:
    """Entry point of the command `neusub`."""
    from neusub.errors import NeusubError

    warnings.showwarning = lambda message, *_: say(f"neusub: {message}", error=True)
    try:
        status = app.cli(prog="neusub", description="Data-driven subdivision of triangle meshes.")
    except NeusubError as error:
        say(f"neusub: {type(error).__name__}: {error}", error=True)
        status = 1
    except KeyboardInterrupt:
        say("neusub: interrupted", error=True)
        status = 130
    sys.exit(status)
