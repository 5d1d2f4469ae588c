"""What the commands share: the app, the line for each file, the checks of outputs."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import arg

if TYPE_CHECKING:
    from neusub.mesh import Mesh

__all__ = ["Output", "app", "check_free", "check_output", "for_each", "level_files", "loaded", "progress_bar",
           "say"]

NO_MEMORY = "out of memory", "allocate memory", "not enough memory"  # as torch says it
app = tyro.extras.SubcommandApp()
Output = Annotated[Path, arg(aliases=["-o"])]


def say(line: str, *, error: bool = False) -> None:
    (sys.stderr if error else sys.stdout).write(f"{line}\n")


def is_folder(inputs: tuple[Path, ...], output: Path) -> bool:
    """Whether the output is a folder: with several inputs, where it is one, and where its name has no extension."""
    return len(inputs) > 1 or output.is_dir() or not output.suffix


def check_output(inputs: tuple[Path, ...], output: Path) -> None:
    """Where the output is a folder it is made; two inputs never share a name there."""
    if not is_folder(inputs, output):
        return
    from neusub.errors import MeshFileError
    from neusub.io import KINDS, READ_ONLY

    if output.suffix.lower() in (*KINDS, *READ_ONLY) or output.is_file():
        raise MeshFileError(f"{output}: with several inputs, or no extension, the output is a folder. Give one with "
                            "-o.")
    names = [name_in_folder(path) for path in inputs]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise MeshFileError(f"{twice}: several inputs have this name and would overwrite each other in {output}.")
    output.mkdir(parents=True, exist_ok=True)


def name_in_folder(path: Path) -> str:
    """Of the output of one input: its own, but what is only read as glTF is written as GLB."""
    from neusub.io import READ_ONLY

    return path.with_suffix(".glb").name if path.suffix.lower() in READ_ONLY else path.name


def level_files(path: Path, inputs: tuple[Path, ...], output: Path, levels: int | None) -> list[Path]:
    """Where the results of one input go: one file, or NAME.level0 ... for each of so many levels."""
    target = output / name_in_folder(path) if is_folder(inputs, output) else output
    if levels is None:
        return [target]
    return [Path(f"{target.with_suffix('')}.level{k}{target.suffix}") for k in range(levels + 1)]


def loaded(path: Path) -> tuple[Mesh, list[str]]:
    """A mesh, and a line for each thing that reading it did; what `load` warns of is among them."""
    from neusub.io import load

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        mesh = load(path)
    return mesh, [f"{path}: {line}" for line in mesh.load_report]


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
        except BrokenPipeError:  # who reads has seen enough: no failure of this mesh
            raise
        except (NeusubError, ValueError, OSError) as error:
            failed += 1
            say(f"neusub: {path}: {type(error).__name__}: {error}", error=True)
        except (MemoryError, RuntimeError) as error:
            if not isinstance(error, MemoryError) and not any(words in str(error) for words in NO_MEMORY):
                raise
            failed += 1
            say(f"neusub: {path}: not enough memory for this. Take fewer levels, or smaller meshes.", error=True)
    if failed and len(paths) > 1:
        say(f"neusub: {failed} of {len(paths)} failed", error=True)
    return int(failed > 0)


@contextmanager
def progress_bar(unit: str):
    """A bar on the terminal with the time left; gives a function to call with what is done, of how many, and a note."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(unit), MofNCompleteColumn(), BarColumn(), TimeRemainingColumn(),
               TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("", total=None)
        yield lambda done, total, note="": progress.update(task, completed=done, total=total, description=note)
