"""Training pairs: a coarse mesh, and for each vertex of its refinements the point on the fine surface it should reach.

A pair file is one safetensors file with the pairs of one source, one after the other, and a JSON header:

    faces          (sum nF, 3) uint16/32   coarse faces of each pair          face_offsets    (n + 1,) int64
    targets        (sum nV_L, 3) float32   points of the last level           target_offsets  (n + 1,) int64
    level_sizes    (n, L + 1) int32        vertices of levels 0 .. L; a level's targets are a prefix of the last's
    decimated      (sum nV_0, 3) float32   optional: the decimator's own positions of the coarse vertices

The numbering is that of `topology.py`; the authors' public pairs have the same.  Targets lie on the surface at every
level, 0 too: `input="on_surface"` starts from level 0's targets, `input="decimated"` from the decimator's positions.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np
import torch
from jaxtyping import Float, Float64, Int, Int64
from numpy import ndarray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from neusub import __version__, bounds
from neusub.configuration import Input
from neusub.creases import area_normals, unit_vectors
from neusub.errors import PairFileError
from neusub.files import content_of, replacing
from neusub.flaps import LevelFlaps, level_flaps
from neusub.topology import Topology, topology_levels

__all__ = ["Batch", "Pair", "batch_pairs", "load_pairs", "pair_files", "read_header", "save_pairs"]

FORMAT = "neusub-pairs-1"
SMOOTH = 1e-5  # distances well below this count squared in the loss "distance"; the unit box's side is 1
FORGIVEN = 0.5  # of the error along the surface, in the loss "surface"
SMOOTH_ANGLE = 0.05  # radians: errors of normals well below count squared
TINY = 1e-20  # a square of a double area in the unit box that is as good as none


@dataclass(frozen=True, eq=False)
class Pair:
    """One coarse mesh and its targets."""

    faces: Int64[ndarray, "nF 3"]
    targets: Float[ndarray, "nV_L 3"]
    level_sizes: tuple[int, ...]
    decimated: Float[ndarray, "nV_0 3"] | None = None
    name: str = ""

    @property
    def levels(self) -> int:
        return len(self.level_sizes) - 1

    @cached_property
    def topologies(self) -> list[Topology]:
        return topology_levels(self.faces, self.level_sizes[0], self.levels)[0]

    def positions(self, input: str) -> Float[ndarray, "nV_0 3"]:
        """The coarse vertices of one kind of input.  Raises PairFileError where the file has no such positions."""
        if input == "on_surface":
            return self.targets[: self.level_sizes[0]]
        if input != "decimated":
            raise PairFileError(f"input {input!r} is not a kind of input. Use one of {', '.join(get_args(Input))}.")
        if self.decimated is None:
            raise PairFileError(f"pair {self.name!r} has no decimated positions. Train with input='on_surface', "
                                "or make the pairs again with 'neusub pairs'.")
        return self.decimated


# --- files -------------------------------------------------------------------------------------------------------


def save_pairs(pairs: list[Pair], path: str | Path, header: dict) -> None:
    """Write pairs of equal depth as one file, whole or not at all; `header` is any JSON: source, licence, options."""
    if not pairs:
        raise PairFileError(f"there are no pairs to write to {path}.")
    small = max(pair.level_sizes[0] for pair in pairs) <= np.iinfo(np.uint16).max
    arrays = {
        "faces": np.concatenate([p.faces for p in pairs]).astype(np.uint16 if small else np.uint32),
        "face_offsets": np.cumsum([0] + [len(p.faces) for p in pairs], dtype=np.int64),
        "targets": np.concatenate([p.targets for p in pairs]).astype(np.float32),
        "target_offsets": np.cumsum([0] + [len(p.targets) for p in pairs], dtype=np.int64),
        "level_sizes": np.array([p.level_sizes for p in pairs], dtype=np.int32),
    }
    decimated = [pair.decimated for pair in pairs if pair.decimated is not None]
    if len(decimated) == len(pairs):
        arrays["decimated"] = np.concatenate(decimated).astype(np.float32)
    header = {"format": FORMAT, "version": __version__, "count": len(pairs), "levels": pairs[0].levels, **header}
    with replacing(path) as new:
        save_file(arrays, new, metadata={"neusub": json.dumps(header, sort_keys=True)})


def read_header(path: str | Path) -> dict:
    """The JSON header of a pair file.  Raises PairFileError."""
    if Path(path).is_dir():
        raise PairFileError(f"{path} is a folder. Give its files, as neusub.generation.pair_files finds them.")
    try:
        with safe_open(path, framework="numpy") as file:
            header = json.loads((file.metadata() or {}).get("neusub", "{}"))
    except FileNotFoundError:
        raise PairFileError(f"{path}: no such file. Make pair files with 'neusub pairs'.") from None
    except (SafetensorError, OSError, ValueError) as error:
        raise PairFileError(f"{path}: not a readable safetensors file ({error}). Make the pairs again.") from None
    if header.get("format") != FORMAT:
        raise PairFileError(f"{path}: the header's format is {header.get('format')!r}, not {FORMAT!r}.")
    return header


def load_pairs(path: str | Path) -> list[Pair]:
    """All pairs of a file.  Raises PairFileError where the file is missing, broken or contradicts itself."""
    read_header(path)
    with safe_open(path, framework="numpy") as file:
        arrays = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dict)
    absent = {"faces", "face_offsets", "targets", "target_offsets", "level_sizes"} - arrays.keys()
    if absent:
        raise PairFileError(f"{path}: lacks the arrays {', '.join(sorted(absent))}. Make the pairs again.")
    sizes = arrays["level_sizes"].astype(np.int64)
    face_at, target_at = arrays["face_offsets"], arrays["target_offsets"]
    coarse_at = np.concatenate([[0], np.cumsum(sizes[:, 0])])
    faces = arrays["faces"].astype(np.int64)
    decimated = arrays.get("decimated")
    pairs = [
        Pair(
            faces[face_at[k] : face_at[k + 1]],
            arrays["targets"][target_at[k] : target_at[k + 1]],
            tuple(int(n) for n in sizes[k]),
            None if decimated is None else decimated[coarse_at[k] : coarse_at[k + 1]],
            f"{Path(path).stem}[{k}]",
        )
        for k in range(len(sizes))
    ]
    for pair in pairs:
        check_pair(pair)
    return pairs


def check_pair(pair: Pair) -> None:
    """Raises PairFileError unless the pair's sizes, indices and positions agree with each other."""
    if pair.faces.size == 0 or pair.faces.min() < 0 or pair.faces.max() >= pair.level_sizes[0]:
        raise PairFileError(f"pair {pair.name!r}: a face's index is not one of its {pair.level_sizes[0]} vertices.")
    if not np.isfinite(pair.targets).all():
        raise PairFileError(f"pair {pair.name!r}: target {int(np.argwhere(~np.isfinite(pair.targets))[0, 0])} is "
                            "not finite.")
    if pair.decimated is not None and not (len(pair.decimated) == pair.level_sizes[0]
                                           and np.isfinite(pair.decimated).all()):
        raise PairFileError(f"pair {pair.name!r}: its decimated positions are not {pair.level_sizes[0]} finite rows.")
    sizes = [pair.level_sizes[0]]
    for topology in pair.topologies:
        sizes.append(sizes[-1] + len(topology.edges))
    if tuple(sizes) != pair.level_sizes or len(pair.targets) != sizes[-1]:
        raise PairFileError(f"pair {pair.name!r}: its faces refine to {sizes} vertices, its targets have "
                            f"{list(pair.level_sizes)} ({len(pair.targets)} rows).")


def pair_files(folder: str | Path) -> tuple[list[Path], list[Path]]:
    """Training and validation files of a folder that `make_pairs` or `import_pairs` wrote.  Raises: PairFileError."""
    folder = Path(folder)
    try:
        listing = json.loads((folder / "manifest.json").read_text())
        return tuple([folder / name for name in listing[split]] for split in ("train", "validation"))  # type: ignore
    except FileNotFoundError:
        train, validation = folder / "train.safetensors", folder / "validation.safetensors"
        if not train.exists():
            raise PairFileError(f"{folder}: neither manifest.json nor train.safetensors is there. Make pair files with "
                                "'neusub pairs' or 'neusub import-pairs'.") from None
        return [train], [validation] if validation.exists() else []
    except (ValueError, KeyError) as error:
        raise PairFileError(f"{folder / 'manifest.json'}: not a manifest ({error!r}). Make the pairs again.") from None


def file_hash(path: str | Path) -> str:
    """SHA-256 of a file, its first 16 digits.  Raises: MeshFileError."""
    return hashlib.sha256(content_of(path)).hexdigest()[:16]


# --- batches -----------------------------------------------------------------------------------------------------


class FaceTargets(NamedTuple):
    """A level's faces, for the error of their normals."""

    faces: Int[torch.Tensor, "nF 3"]
    normals: Float[torch.Tensor, "3 nF"]  # unit, of the targets
    weights: Float[torch.Tensor, " nF"]  # by the target's area: a third in all for each mesh

    def error(self, positions: Float[torch.Tensor, "nV 3"]) -> torch.Tensor:
        """Sum over the meshes of a third of the mean distance, in radians where it is small, between the unit normals
        of the faces and of their targets; smooth near zero."""
        normals = bounds.area_normals(self.faces, positions)
        unit = normals * (normals.square().sum(0) + TINY).rsqrt()
        distance = ((unit - self.normals).square().sum(0) + SMOOTH_ANGLE**2).sqrt() - SMOOTH_ANGLE
        return (distance * self.weights).sum()


@dataclass(frozen=True, eq=False)
class Batch:
    """A disjoint union of pairs, as the network takes it."""

    positions: Float[torch.Tensor, "nV_0 3"]
    levels: list[LevelFlaps]
    targets: Float[torch.Tensor, "nV_L 3"]
    weights: list[Float[torch.Tensor, "nV_l 1"]]  # of each vertex's error: a third in all for each mesh
    normals: Float[torch.Tensor, "nV_L 3"]  # of the targets, as vertices of the last level
    faces: list[FaceTargets]  # of levels 0 .. L, where the loss asks for their normals

    def loss(self, outputs: list[torch.Tensor], kind: str = "squared", normals: float = 0.0) -> torch.Tensor:
        """Sum over levels of a mesh's mean error, summed over the meshes.

        kind: "squared", of the coordinates (paper, section 4); "distance", a third of the distance, smooth near zero,
        which a few bad targets do not carry; "surface", the same where half of the error along the surface is forgiven,
        for that does not move the surface.  normals: so much of the faces' `error` is added on each level.
        """
        terms = []
        for out, weight in zip(outputs, self.weights):
            error = out - self.targets[: len(out)]
            squared = error.square()
            if kind != "squared":
                squared = squared.sum(1, keepdim=True)
                if kind == "surface":
                    across = (error * self.normals[: len(out)]).sum(1, keepdim=True).square()
                    squared = across + (1 - FORGIVEN) ** 2 * (squared - across).clamp(min=0)
                squared = (squared + SMOOTH**2).sqrt() - SMOOTH
            terms.append((squared * weight).sum())
        if normals:
            terms += [normals * level.error(out) for out, level in zip(outputs, self.faces)]
        return torch.stack(terms).sum()


def batch_pairs(pairs: list[Pair], input: str = "on_surface", device: torch.device | str = "cpu",
                dtype: torch.dtype = torch.float32, weighting: str = "vertices", normals: bool = False) -> Batch:
    """The disjoint union of pairs of equal depth; input and weighting as in `TrainingConfig`.  normals: whether the
    loss will ask for those of faces.

    The union is refined as one mesh, so its vertices are renumbered at every level; within a mesh their order stays,
    so the targets find their places by a stable sort of the mesh that each vertex belongs to.
    Raises PairFileError for no pairs, and for pairs of several depths.
    """
    depths = {pair.levels for pair in pairs}
    if len(depths) != 1:
        raise PairFileError(f"a batch of pairs of {sorted(depths) or 'no'} levels. Give pairs of one depth.")
    depth = depths.pop()
    starts = np.cumsum([0] + [pair.level_sizes[0] for pair in pairs])
    if len(pairs) == 1:
        topologies = pairs[0].topologies
    else:
        topologies, _ = topology_levels(np.concatenate([p.faces + s for p, s in zip(pairs, starts)]),
                                        int(starts[-1]), depth)
    faces = [*(topology.faces for topology in topologies), topologies[-1].refined_faces]
    owner = np.repeat(np.arange(len(pairs)), np.diff(starts))
    owners = [owner]
    for topology in topologies:
        owners.append(np.concatenate([owners[-1], owners[-1][topology.edges[:, 0]]]))
    targets = np.empty((len(owners[-1]), 3), dtype=np.float32)
    targets[np.argsort(owners[-1], kind="stable")] = np.concatenate([pair.targets for pair in pairs])
    weights = []
    for level, owner in enumerate(owners):
        share = np.ones(len(owner)) if weighting == "vertices" else vertex_areas(targets[: len(owner)], faces[level])
        weights.append(torch.as_tensor(shares(share, owner)[:, None], dtype=dtype, device=device))
    start = np.concatenate([pair.positions(input) for pair in pairs])
    return Batch(
        torch.as_tensor(start, dtype=dtype, device=device),
        [level_flaps(topology, device) for topology in topologies],
        torch.as_tensor(targets, dtype=dtype, device=device),
        weights,
        torch.as_tensor(vertex_normals(targets, faces[-1]), dtype=dtype, device=device),
        [face_targets(*level, targets, dtype, device) for level in zip(faces, owners)] if normals else [],
    )


def shares(amounts: Float64[ndarray, " n"], owner: Int64[ndarray, " n"]) -> Float64[ndarray, " n"]:
    """Amounts as parts of a third of all that their mesh has."""
    return amounts / (3 * np.bincount(owner, amounts)[owner])


def face_targets(faces: Int64[ndarray, "nF 3"], owner: Int64[ndarray, " nV"], targets: Float[ndarray, "nV_L 3"],
                 dtype: torch.dtype, device: torch.device | str) -> FaceTargets:
    """Owner: the mesh of each vertex."""
    normals = area_normals(faces, targets.astype(np.float64))
    areas = np.linalg.norm(normals, axis=1)
    unit = np.ascontiguousarray(unit_vectors(normals).T)
    return FaceTargets(torch.as_tensor(np.require(faces, requirements="W"), device=device),
                       torch.as_tensor(unit, dtype=dtype, device=device),
                       torch.as_tensor(shares(areas, owner[faces[:, 0]]), dtype=dtype, device=device))


def vertex_normals(positions: Float[ndarray, "nV 3"], faces: Int64[ndarray, "nF 3"]) -> Float[ndarray, "nV 3"]:
    """Unit normals of the vertices, weighted by area; zero where they cancel."""
    normals = area_normals(faces, positions.astype(np.float64))
    total = np.stack([np.bincount(faces.T.reshape(-1), np.tile(normals[:, k], 3), len(positions)) for k in range(3)], 1)
    return unit_vectors(total)


def vertex_areas(positions: Float[ndarray, "nV 3"], faces: Int64[ndarray, "nF 3"]) -> Float64[ndarray, " nV"]:
    """Twice the area of the faces at each vertex."""
    area = np.linalg.norm(area_normals(faces, positions.astype(np.float64)), axis=1)
    return np.bincount(faces.T.reshape(-1), np.tile(area, 3), len(positions))


def scaled(pair: Pair, factor: float) -> Pair:
    decimated = None if pair.decimated is None else (factor * pair.decimated).astype(np.float32)
    return replace(pair, targets=(factor * pair.targets).astype(np.float32), decimated=decimated)


def shortened(pair: Pair, levels: int) -> Pair:
    """The pair with its first `levels` levels only; the pair itself where it has no more."""
    if levels >= pair.levels:
        return pair
    sizes = pair.level_sizes[: levels + 1]
    return replace(pair, targets=pair.targets[: sizes[-1]], level_sizes=sizes)
