"""Fine meshes -> training pairs by the thousand: each source is decimated at random, refined, and mapped back.

    make_pairs      many pairs of many sources into files: parallel, resumable, the same bytes for the same seed
    PairStream      pairs made on the fly beside a training

The paper's protocol (appendix "Data Generation from Random Collapses"): unit box, semi-random collapses down to 150 to
300 vertices, two levels.  In files a pair depends on the source's content, the seed and its number alone; in a stream
on the source's place in the list instead of its content.
"""

from __future__ import annotations

import json
import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from torch.utils.data import IterableDataset, get_worker_info

from neusub.configuration import PairConfig
from neusub.errors import DecimationError, MeshFileError, NeusubError, PairFileError
from neusub.files import replacing
from neusub.generation import Pair, file_hash, load_pairs, read_header, save_pairs
from neusub.io import load
from neusub.mesh import Mesh
from neusub.metrics import triangle_quality
from neusub.selfparam import SelfParameterization, decimate
from neusub.selfparam.criteria import refusals
from neusub.selfparam.parameterization import refinement
from neusub.selfparam.report import map_report, triangle_report

__all__ = ["PairReport", "PairStream", "generator_of", "in_unit_box", "make_pair", "make_pairs", "summary"]

BLOCK = 10  # pairs of one task: what an interruption loses at most, a worker
SPLITS = ("train", "validation")
STALE = 60  # seconds, after which a file that is being written no longer is


@dataclass(frozen=True)
class PairReport:
    """What `make_pairs` wrote: the manifest's path, the files of each split, and each source that failed, with why."""

    manifest: Path
    train: tuple[Path, ...]
    validation: tuple[Path, ...]
    failed: dict[str, str]


# --- one pair ----------------------------------------------------------------------------------------------------


def make_pair(fine: Mesh, config: PairConfig, generator: np.random.Generator,
              name: str = "") -> tuple[Pair, SelfParameterization]:
    """Decimate a mesh that lies in the unit box to a random size; the pair, and the map that it came through.

    Raises: DecimationError where the size cannot be reached, with the criteria that stopped it.
    """
    low, high = config.vertices
    size = int(generator.integers(low, high + 1))
    result = decimate(fine, n_vertices=size, strategy=config.strategy, seed=int(generator.integers(2**32)))
    if not result.reached:
        raise DecimationError(f"{len(result.decimated)} vertices are left of {len(fine.vertices)}, {size} were asked "
                              f"for; refused: {refusals(result.counts)}. Ask for more vertices.")
    refined = refinement(result.faces, size, config.levels)
    targets = result.points(*result.to_fine(refined.at, refined.barycentric))
    pair = Pair(result.faces, targets.astype(np.float32), refined.sizes, result.decimated.astype(np.float32), name)
    return pair, result


def in_unit_box(mesh: Mesh) -> Mesh:
    """The bare surface, its box's longest side 1 and its lowest corner at the origin."""
    low = mesh.vertices.min(axis=0)
    return Mesh((mesh.vertices - low) / np.ptp(mesh.vertices, axis=0).max(), mesh.faces)


def generator_of(seed: int, split: str, source_hash: str, number: int) -> np.random.Generator:
    """The random numbers of one pair: of the seed, its half of the data, its source and its number there alone."""
    return np.random.default_rng([seed, SPLITS.index(split), int(source_hash, 16), number])


# --- many pairs --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Task:
    """Some pairs of one source, kept as one part file until the source's file is whole."""

    source: Path
    source_hash: str
    split: str
    first: int
    last: int
    total: int  # pairs of this source and split
    part: Path


def make_pairs(
    sources: Sequence[str | Path],
    folder: str | Path,
    config: PairConfig | None = None,
    *,
    workers: int | None = None,
    strict: bool = False,
    licence: str = "not stated",
    on_task: Callable[[int, int], None] | None = None,
) -> PairReport:
    """Make pairs of every source: `NAME.train.safetensors`, `NAME.validation.safetensors` and `manifest.json`.

    config: how many, which sizes, seed.  workers: threads (all cores by default); within `joblib.parallel_config` any
    other backend, processes and clusters too.  strict: the first source that fails ends it all; otherwise the others
    go on and the report says why it failed.  on_task is called with the number of tasks done, and of all.
    An interrupted call, repeated, goes on where it was and ends with the same files; with another licence their headers
    change, with more sources the numbers of pairs that `total` gives each.
    Raises: PairFileError for no sources, two of one name, or a folder with other options; strict: the source's error.
    """
    config, folder = config or PairConfig(per_mesh=1), Path(folder)
    paths = checked_sources(sources)
    folder.mkdir(parents=True, exist_ok=True)
    options = checked_folder(folder, config)
    hashes, failed = {}, {}
    for path in paths:
        try:
            hashes[path] = file_hash(path)
        except MeshFileError as error:
            if strict:
                raise
            failed[path.name] = f"{type(error).__name__}: {error}"
    counts = config.counts(len(paths))
    tasks = [task for split in SPLITS for path, count in zip(paths, counts[split]) if path in hashes
             for task in tasks_of(path, hashes[path], split, count, folder)]
    parts = folder / ".parts"
    for done, (task, error) in enumerate(run_tasks(tasks, config, options, workers), start=1):
        if error is not None and strict:
            raise error
        if error is not None:
            failed.setdefault(task.source.name, f"{type(error).__name__}: {error}")
        if on_task:
            on_task(done, len(tasks))
    files = merge_all(tasks, failed, options, licence)
    manifest = folder / "manifest.json"
    listing = {"options": options, "failed": failed,
               **{split: [path.name for path in files[split]] for split in SPLITS}}
    with replacing(manifest) as new:
        new.write_text(json.dumps(listing, indent=2, sort_keys=True) + "\n")
    clear(parts, tasks)
    return PairReport(manifest, tuple(files["train"]), tuple(files["validation"]), failed)


def clear(parts: Path, tasks: list[_Task]) -> None:
    """Remove the parts, and what killed calls were writing; another call may be at work here, and keeps its own."""
    for task in tasks:
        task.part.unlink(missing_ok=True)
    for part in [*parts.parent.glob(".*.part*"), *parts.glob(".*.part*")]:
        with suppress(FileNotFoundError):
            if time.time() - part.stat().st_mtime > STALE:
                part.unlink()
    with suppress(OSError):  # it is not empty
        parts.rmdir()


def checked_sources(sources: Sequence[str | Path]) -> list[Path]:
    if isinstance(sources, (str, Path)):
        raise PairFileError(f"the sources are a single {type(sources).__name__}. Give a list of mesh files.")
    paths = [Path(source) for source in sources]
    if not paths:
        raise PairFileError("there are no sources. Give at least one fine mesh.")
    stems = [path.stem for path in paths]
    twice = next((stem for stem in stems if stems.count(stem) > 1), None)
    if twice:
        raise PairFileError(f"{twice}: several sources have this name, and would share a file. Rename one.")
    return paths


def checked_folder(folder: Path, config: PairConfig) -> dict[str, Any]:
    """The options as JSON, which must be those that the folder was begun with."""
    options = json.loads(json.dumps(asdict(config)))
    for path in [*folder.glob("[!.]*.safetensors"), *folder.glob(".parts/[!.]*.safetensors")]:
        was = read_header(path).get("options")
        if was != options:
            raise PairFileError(f"{path} was made with the options {was}, not {options}. Choose another folder.")
    return options


def tasks_of(source: Path, source_hash: str, split: str, count: int, folder: Path) -> list[_Task]:
    return [_Task(source, source_hash, split, first, min(first + BLOCK, count), count,
                  folder / ".parts" / f"{source.stem}.{split}.{first:06d}.safetensors")
            for first in range(0, count, BLOCK)]


def final_file(task: _Task) -> Path:
    return task.part.parent.parent / f"{task.source.stem}.{task.split}.safetensors"


def is_done(path: Path, task: _Task) -> bool:
    """Whether a file is there, of this very source, with as many pairs: those of a task, or all."""
    if not path.exists():
        return False
    header = read_header(path)
    wanted = task.last - task.first if path == task.part else task.total
    return (header.get("source_hash"), header.get("count")) == (task.source_hash, wanted)


def run_tasks(tasks: list[_Task], config: PairConfig, options: dict,
              workers: int | None) -> Iterator[tuple[_Task, Exception | None]]:
    """Each task as it ends, with the error that it ended with."""
    from joblib import Parallel, delayed

    done = {task for task in tasks if is_done(final_file(task), task) or is_done(task.part, task)}
    yield from ((task, None) for task in done)
    parallel = Parallel(n_jobs=workers or os.cpu_count() or 1, prefer="threads", return_as="generator_unordered")
    yield from parallel(delayed(run_task)(task, config, options) for task in tasks if task not in done)  # type: ignore


def run_task(task: _Task, config: PairConfig, options: dict) -> tuple[_Task, Exception | None]:
    """Make the pairs of a task and write its part file."""
    try:
        fine = in_unit_box(load(task.source))
        pairs, reports = [], []
        for number in range(task.first, task.last):
            pair, result = make_pair(fine, config, generator_of(config.seed, task.split, task.source_hash, number))
            pairs.append(pair)
            reports.append(asdict(map_report(result, config.levels)))
    except NeusubError as error:
        return task, error
    task.part.parent.mkdir(exist_ok=True)  # another call may have removed it when it was done
    save_pairs(pairs, task.part, {"source_hash": task.source_hash, "options": options, "reports": reports})
    return task, None


def merge_all(tasks: list[_Task], failed: dict[str, str], options: dict, licence: str) -> dict[str, list[Path]]:
    """Join the parts of each source and split into its file; the files of each split."""
    files: dict[str, list[Path]] = {split: [] for split in SPLITS}
    by_file: dict[Path, list[_Task]] = {}
    for task in tasks:
        if task.source.name not in failed:
            by_file.setdefault(final_file(task), []).append(task)
    for path, group in by_file.items():
        first = group[0]
        files[first.split].append(path)
        if is_done(path, first):
            header = read_header(path)
            if header["licence"] != licence:
                save_pairs(load_pairs(path), path, {**header, "licence": licence})
            continue
        pairs = [pair for task in group for pair in load_pairs(task.part)]
        reports = [report for task in group for report in read_header(task.part)["reports"]]
        save_pairs(pairs, path, {
            "split": first.split, "source": first.source.name, "source_hash": first.source_hash, "licence": licence,
            "options": options, "report": summary(pairs, reports),
        })
    return files


def summary(pairs: list[Pair], reports: list[dict]) -> dict[str, float]:
    """What to know of a file's pairs: shape of the coarse triangles (on the surface), distortion and flips of the maps.

    The authors' public elephant pairs have quality_low 0.215, quality_median 0.77, area_variation 0.58.
    """
    coarse = [(pair.targets[: pair.level_sizes[0]].astype(np.float64), pair.faces) for pair in pairs]
    quality = np.concatenate([triangle_quality(vertices, faces) for vertices, faces in coarse])
    values = {
        "quality_low": np.percentile(quality, 1),
        "quality_median": np.median(quality),
        "area_variation": np.mean([triangle_report(vertices, faces).area_variation for vertices, faces in coarse]),
        "conformal_median": np.median([report["conformal_median"] for report in reports]),
        "conformal_high": np.median([report["conformal_high"] for report in reports]),
        "conformal_worst": max(report["conformal_worst"] for report in reports),
        "flipped": np.mean([report["flipped"] for report in reports]),
        "degenerate": np.mean([report["degenerate"] for report in reports]),
    }
    return {name: float(f"{value:.6g}") for name, value in values.items()}


# --- on the fly --------------------------------------------------------------------------------------------------


class PairStream(IterableDataset):
    """Endless pairs of some fine meshes, made in the background while the training step before runs.

    sources: meshes, or files.  Pair k is of source k mod n; for the same seed the pairs are the same, in the same
    order, whatever the number of workers, and of those of a DataLoader (batch_size=None), which share them.  ahead:
    pairs that are kept ready.  Sources that fail end the iteration with their error.
    """

    def __init__(self, sources: Sequence[Mesh | str | Path], config: PairConfig | None = None, *,
                 workers: int | None = None, ahead: int = 8):
        super().__init__()
        if ahead < 1:
            raise ValueError(f"ahead = {ahead}: keep at least one pair ready.")
        meshes = [source if isinstance(source, Mesh) else load(source) for source in sources]
        if not meshes:
            raise PairFileError("there are no sources. Give at least one fine mesh.")
        self.meshes = [in_unit_box(mesh) for mesh in meshes]
        self.config = config or PairConfig(per_mesh=1)
        self.workers, self.ahead = workers or os.cpu_count() or 1, ahead

    def make(self, number: int) -> Pair:
        source = number % len(self.meshes)
        generator = np.random.default_rng([self.config.seed, source, number])
        return make_pair(self.meshes[source], self.config, generator, f"{source}[{number}]")[0]

    def __iter__(self) -> Iterator[Pair]:
        loader = get_worker_info()
        numbers = count(0) if loader is None else count(loader.id, loader.num_workers)
        with ThreadPoolExecutor(self.workers) as pool:
            ready = deque(pool.submit(self.make, next(numbers)) for _ in range(self.ahead))
            try:
                while True:
                    yield ready.popleft().result()
                    ready.append(pool.submit(self.make, next(numbers)))
            finally:
                for future in ready:
                    future.cancel()
