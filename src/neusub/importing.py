"""Training pairs in the layouts of the paper's authors, read into pair files (`generation.py`)."""

from __future__ import annotations

from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from jaxtyping import Int64
from numpy import ndarray

from neusub.errors import PairFileError
from neusub.generation import Pair, check_pair, file_hash, save_pairs
from neusub.topology import topology_levels

__all__ = ["import_pairs"]


def import_pairs(source: str | Path, folder: str | Path, *, licence: str = "not stated") -> list[Path]:
    """Read the authors' pairs into pair files: `train.safetensors`, and `validation.safetensors` where there are any.

    source: an npz with {train,valid}_V2, _nV, _F0, _nF0; or a folder with subd0/, subd1/, ... of OBJ files of equal
    names (or with train/ and valid/ folders of that kind).  Returns the paths written.  Raises PairFileError.
    """
    source, folder = Path(source), Path(folder)
    if source.is_file() and source.suffix == ".npz":
        try:
            splits = _read_npz(source)
        except KeyError as error:
            raise PairFileError(f"{source}: {error.args[0]}. An npz of pairs has {{train,valid}}_V2, _nV, _F0, _nF0.") \
                from None
        except (OSError, EOFError, ValueError, BadZipFile) as error:
            raise PairFileError(f"{source}: not a readable npz of pairs ({error}). Get it again.") from None
        origin = {"source": source.name, "source_hash": file_hash(source), "licence": licence}
    elif source.is_dir():
        roots = {"train": source} if (source / "subd0").is_dir() else {"train": source / "train",
                                                                      "validation": source / "valid"}
        splits = {split: _read_obj_levels(root) for split, root in roots.items() if (root / "subd0").is_dir()}
        origin = {"source": source.name, "licence": licence}
    else:
        splits, origin = {}, {}
    if not splits:
        raise PairFileError(f"{source}: neither an npz with train_V2 nor a folder with subd0, subd1, ...")
    if (folder / "manifest.json").exists():
        raise PairFileError(f"{folder} holds pairs of other meshes already (manifest.json). Choose another folder.")
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for split, pairs in splits.items():
        for pair in pairs:
            check_pair(pair)
        paths.append(folder / f"{split}.safetensors")
        save_pairs(pairs, paths[-1], {"split": split, **origin})
    return paths


def _read_npz(source: Path) -> dict[str, list[Pair]]:
    splits = {}
    with np.load(source, allow_pickle=False) as data:
        for key, split in (("train", "train"), ("valid", "validation")):
            if f"{key}_V2" not in data:
                continue
            sizes, faces = data[f"{key}_nV"], data[f"{key}_F0"].astype(np.int64)
            targets = np.split(data[f"{key}_V2"], np.cumsum(sizes[:, -1])[:-1])
            faces = np.split(faces, np.cumsum(data[f"{key}_nF0"])[:-1])
            splits[split] = [Pair(f, t, tuple(int(n) for n in s), name=f"{split}[{k}]")
                             for k, (f, t, s) in enumerate(zip(faces, targets, sizes))]
    return splits


def _read_obj_levels(root: Path) -> list[Pair]:
    from neusub.io import read

    folders = sorted((path for path in root.glob("subd*") if path.name[4:].isdigit()),
                     key=lambda path: int(path.name[4:]))
    pairs = []
    for coarse in sorted((root / "subd0").glob("*.obj")):
        meshes = [read(folder / coarse.name) for folder in folders]
        for folder, mesh in zip(folders, meshes):
            last, step = meshes[-1].vertices[: len(mesh.vertices)], 1e-4 * np.ptp(mesh.vertices)
            if len(last) < len(mesh.vertices) or not np.allclose(last, mesh.vertices, atol=step):
                raise PairFileError(f"{folder.name}/{coarse.name}: its vertices are not the first ones of the last "
                                    "level. Write all levels with the vertices of the levels before them in front.")
        pairs.append(_numbered_pair(meshes, [f"{folder.name}/{coarse.name}" for folder in folders]))
    return pairs


def _numbered_pair(meshes: list, names: list[str]) -> Pair:
    """A pair of the levels of one mesh, whatever the order of each level's new vertices, of which there is one an edge.
    Raises PairFileError where a level is not the one before with each face split into four."""
    sizes = tuple(len(mesh.vertices) for mesh in meshes)
    topologies, _ = topology_levels(meshes[0].faces, sizes[0], len(meshes) - 1)
    place = np.arange(sizes[0])  # in the file, of each of the pair's vertices
    for topology, mesh, name in zip(topologies, meshes[1:], names[1:]):
        old, n_edges = topology.n_vertices, len(topology.edges)
        fault = PairFileError(f"{name}: it is not the level before with each face split into four. Subdivide without "
                              "changing the mesh otherwise.")
        if (len(mesh.vertices), len(mesh.faces)) != (old + n_edges, 4 * len(topology.faces)):
            raise fault
        number = np.empty(old, dtype=np.int64)
        number[place] = np.arange(old)
        sides = mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        sides = np.sort(sides[(sides < old).sum(axis=1) == 1], axis=1)  # between an old vertex and a new one
        sides = np.unique(sides[:, ::-1], axis=0)  # by the new one
        if len(sides) != 2 * n_edges or (sides[::2, 0] != sides[1::2, 0]).any():
            raise fault
        ends = np.sort(number[sides[:, 1]].reshape(-1, 2), axis=1)
        order = np.lexsort(ends.T[::-1])
        if not np.array_equal(ends[order], topology.edges):
            raise fault
        place = np.concatenate([place, sides[::2, 0][order]])
        number = np.empty(len(place), dtype=np.int64)
        number[place] = np.arange(len(place))
        if not np.array_equal(_as_set(number[mesh.faces]), _as_set(topology.refined_faces)):
            raise fault
    return Pair(meshes[0].faces, meshes[-1].vertices[place].astype(np.float32), sizes, name=Path(names[0]).stem)


def _as_set(faces: Int64[ndarray, "nF 3"]) -> Int64[ndarray, "nF 3"]:
    """Oriented faces in one order, each beginning with its least vertex."""
    rolled = np.take_along_axis(faces, (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    return rolled[np.lexsort(rolled.T[::-1])]
