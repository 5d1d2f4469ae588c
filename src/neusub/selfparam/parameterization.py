"""`SelfParameterization`: a coarse mesh, the fine one it came from, and the bijective map between them."""

from __future__ import annotations

import json
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy import ndarray

from neusub import __version__
from neusub.errors import ParameterizationError
from neusub.files import replacing
from neusub.memory import check_fits
from neusub.mesh import Mesh
from neusub.selfparam.mapping import Charts, fault_of, go_down, go_up
from neusub.topology import counting_order, topology_levels

if TYPE_CHECKING:
    from neusub.selfparam.report import MapReport

__all__ = ["Refinement", "SelfParameterization", "refinement"]

FORMAT = "neusub-map-1"
CHUNK = 4096  # points a thread takes at a time


@dataclass(frozen=True, eq=False)
class SelfParameterization:
    """What `decimate` gives.

    fine: the input.  faces (nF0, 3), decimated (nV0, 3): the coarse mesh, at the decimator's own positions; of a fitted
    map at the vertices' images.
    reached: whether the target was met.  counts: collapses ("legal") and refusals by reason.
    A point is a face's index and barycentric coordinates; its image under the map is one, too.
    """

    fine: Mesh
    faces: Int64[ndarray, "nF0 3"]
    decimated: Float64[ndarray, "nV0 3"]
    versions: ndarray  # (nF0,) int32: of each coarse face (`mapping.py`)
    charts: Charts
    reached: bool
    counts: dict[str, int]
    strategy: str = "quadric"
    seed: int = 0

    @cached_property
    def coarse(self) -> Mesh:
        """The coarse mesh with its vertices where the decimation put them; of a fitted map, at their images."""
        return Mesh(self.decimated, self.faces)

    @cached_property
    def on_surface(self) -> Mesh:
        """The coarse mesh with its vertices where the map puts them on the fine surface."""
        return Mesh(self.points(*self.to_fine(*corner_points(self.faces, len(self.decimated)))), self.faces)

    def to_fine(
        self, faces: Int64[ndarray, " n"], barycentric: Float64[ndarray, "n 3"]
    ) -> tuple[Int64[ndarray, " n"], Float64[ndarray, "n 3"]]:
        """Points of the coarse mesh -> points of the fine one.  Raises: ParameterizationError for a bad point."""
        faces, points = checked_points(faces, barycentric, len(self.faces))
        versions = self.versions[faces]
        in_parallel(go_up, self.charts, versions, points)
        return versions.astype(np.int64), points

    def to_coarse(
        self, faces: Int64[ndarray, " n"], barycentric: Float64[ndarray, "n 3"]
    ) -> tuple[Int64[ndarray, " n"], Float64[ndarray, "n 3"]]:
        """Points of the fine mesh -> points of the coarse one.  Raises: ParameterizationError for a bad point."""
        faces, points = checked_points(faces, barycentric, len(self.fine.faces))
        versions = faces.astype(np.int32)
        in_parallel(go_down, self.charts, versions, points)
        return self._face_of_version[versions], points

    @cached_property
    def _face_of_version(self) -> Int64[ndarray, " versions"]:
        face = np.full(int(self.charts.used[1]), -1, dtype=np.int64)
        face[self.versions] = np.arange(len(self.versions))
        return face

    def points(self, faces: Int64[ndarray, " n"], barycentric: Float64[ndarray, "n 3"]) -> Float64[ndarray, "n 3"]:
        """Positions of points of the fine mesh.  Raises: ParameterizationError for a face that is not there."""
        check_faces(np.asarray(faces), len(self.fine.faces))
        return weighted(self.fine.vertices, self.fine.faces[faces], barycentric)

    # --- signals ---

    def transfer(self, values: ndarray, levels: int = 0) -> ndarray:
        """A signal on the fine vertices (nV, ...) -> on the vertices of the coarse mesh's `levels`-th refinement.

        Linear in each fine face, through the map.  Raises: ParameterizationError for another number of rows.
        """
        values = np.asarray(values, dtype=np.float64)
        if len(values) != len(self.fine.vertices):
            raise ParameterizationError(f"values has {len(values)} rows for {len(self.fine.vertices)} fine vertices: "
                                        "give one for each.")
        refined = refinement(self.faces, len(self.decimated), levels)
        faces, barycentric = self.to_fine(refined.at, refined.barycentric)
        return weighted(values, self.fine.faces[faces], barycentric)

    def transfer_corners(
        self, uv: Float64[ndarray, "nT k"], uv_faces: Int64[ndarray, "nF 3"], levels: int = 0
    ) -> tuple[Float64[ndarray, "nT_L k"], Int64[ndarray, "nF_L 3"], Bool[ndarray, " nF_L"]]:
        """A signal on the fine corners -> on the refinement's corners; see `signals.transfer_corners`."""
        from neusub.selfparam.signals import transfer_corners

        return transfer_corners(self, uv, uv_faces, levels)

    def bake(
        self, texture: ndarray | bytes, levels: int = 0, *, density: float = 1.0
    ) -> tuple[ndarray, Float64[ndarray, "nT_L 2"], Int64[ndarray, "nF_L 3"]]:
        """The fine mesh's texture, resampled where faces of the refinement cross a seam; see `baking.bake`."""
        from neusub.selfparam.baking import bake

        return bake(self, texture, levels, density=density)

    def fitted(self, levels: int = 2, passes: int = 5) -> SelfParameterization:
        """The map with coarse vertices slid along the surface where that brings refinements closer to it.

        The refinement at `levels` is compared with the fine mesh, in some passes over all vertices.  Not in the paper.
        `decimated` becomes the vertices' images.  Vertices on a boundary stay.
        Raises: ParameterizationError for levels or passes out of range.
        """
        from neusub.selfparam.fitting import fitted

        return fitted(self, levels, passes)

    def report(self, levels: int = 2) -> MapReport:
        """Distortion, flips, refusals and the coarse triangles in numbers; see `report.map_report`."""
        from neusub.selfparam.report import map_report

        return map_report(self, levels)

    # --- files ---

    def save(self, path: str | Path) -> None:
        """Write coarse mesh, map and fine mesh as one safetensors file, whole or not at all.

        Of the fine mesh positions, faces, UVs and colours are kept.
        """
        from safetensors.numpy import save_file

        arrays = {f"charts.{name}": array for name, array in self.charts._asdict().items()}
        arrays |= {"faces": self.faces, "decimated": self.decimated, "versions": self.versions}
        for name in ("vertices", "faces", "uv", "uv_faces", "colors"):
            if getattr(self.fine, name) is not None:
                arrays[f"fine.{name}"] = getattr(self.fine, name)
        header = {"format": FORMAT, "version": __version__, "reached": self.reached, "counts": self.counts,
                  "strategy": self.strategy, "seed": self.seed}
        with replacing(path) as new:
            save_file({k: np.ascontiguousarray(v) for k, v in arrays.items()}, new,
                      metadata={"neusub": json.dumps(header)})

    @classmethod
    def load(cls, path: str | Path) -> SelfParameterization:
        """Read what `save` wrote.  Raises: ParameterizationError."""
        from safetensors import SafetensorError, safe_open

        try:
            with safe_open(path, framework="numpy") as file:
                header: dict[str, Any] = json.loads((file.metadata() or {}).get("neusub", "{}"))
                arrays = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dict)
        except (SafetensorError, OSError, ValueError) as error:
            raise ParameterizationError(f"{path}: not a readable safetensors file ({error}).") from None
        if header.get("format") != FORMAT:
            raise ParameterizationError(f"{path}: the header's format is {header.get('format')!r}, not {FORMAT!r}.")
        needed = ["faces", "decimated", "versions", "fine.vertices", "fine.faces"]
        missing = [name for name in needed + [f"charts.{name}" for name in Charts._fields] if name not in arrays]
        if missing:
            raise ParameterizationError(f"{path}: it lacks {', '.join(missing)}. Save the map again.")
        lacking = [name for name in ("reached", "counts", "strategy", "seed") if name not in header]
        if lacking:
            raise ParameterizationError(f"{path}: its header lacks {', '.join(lacking)}. Save the map again.")
        fine = Mesh(**{key[5:]: array for key, array in arrays.items() if key.startswith("fine.")})
        charts = Charts(*(arrays[f"charts.{name}"] for name in Charts._fields))
        faces, decimated, versions = (arrays[name] for name in ("faces", "decimated", "versions"))
        if not (faces.dtype.kind == versions.dtype.kind == "i" and decimated.dtype == np.float64
                and faces.shape == (len(versions), 3) and decimated.shape[1:] == (3,) and versions.ndim == 1
                and faces.min(initial=0) >= 0 and faces.max(initial=0) < len(decimated)):
            raise ParameterizationError(f"{path}: faces {faces.shape}, decimated {decimated.shape} and versions "
                                        f"{versions.shape} are not those of one mesh. Save the map again.")
        fault = fault_of(charts, len(fine.faces), versions)
        if fault:
            raise ParameterizationError(f"{path}: {fault}. Save the map again.")
        return cls(fine, arrays["faces"], arrays["decimated"], arrays["versions"], charts, header["reached"],
                   header["counts"], header["strategy"], header["seed"])


# --- points ------------------------------------------------------------------------------------------------------


def check_faces(faces: ndarray, n_faces: int) -> None:
    bad = (faces < 0) | (faces >= n_faces)
    if bad.any():
        at = int(np.argmax(bad))
        raise ParameterizationError(f"point {at} lies in face {faces[at]}, but there are {n_faces} faces.")


def checked_points(faces: Any, barycentric: Any, n_faces: int) -> tuple[ndarray, ndarray]:
    """Copies, checked: indices in range, coordinates finite, not negative, of sum one (up to rounding)."""
    faces = np.array(faces)
    points = np.array(barycentric, dtype=np.float64, order="C")
    if faces.dtype.kind not in "iu" or faces.ndim != 1 or points.shape != (len(faces), 3):
        raise ParameterizationError(f"faces {faces.shape} and barycentric {points.shape}: give n indices and (n, 3) "
                                    "coordinates.")
    check_faces(faces, n_faces)
    sums = points.sum(axis=1)
    bad = ~((points.min(axis=1, initial=1.0) >= -1e-9) & (np.abs(sums - 1) <= 1e-6))
    if bad.any():
        at = int(np.argmax(bad))
        raise ParameterizationError(f"point {at} has barycentric coordinates {points[at].tolist()}: they must not be "
                                    "negative and sum to 1.")
    return faces, np.maximum(points, 0) / np.maximum(points, 0).sum(axis=1, keepdims=True)


def in_parallel(kernel: Any, charts: Charts, versions: ndarray, points: ndarray) -> None:
    """Take points through the charts, in place: neighbours one after the other, so that charts stay in the cache."""
    n = len(versions)
    if n <= CHUNK:
        kernel(charts, versions, points, 0, n)
        return
    order = counting_order(versions, int(charts.used[1]))
    sorted_versions, sorted_points = versions[order], points[order]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for task in [pool.submit(kernel, charts, sorted_versions, sorted_points, a, min(a + CHUNK, n))
                     for a in range(0, n, CHUNK)]:
            task.result()
    versions[order], points[order] = sorted_versions, sorted_points


def weighted(values: ndarray, corners: Int64[ndarray, "n 3"], barycentric: Float64[ndarray, "n 3"]) -> ndarray:
    """Sum of the values at each point's corners, by its barycentric coordinates."""
    return np.einsum("nk,nk...->n...", barycentric, values[corners])


def corner_points(faces: Int64[ndarray, "nF 3"], n_vertices: int) -> tuple[ndarray, ndarray]:
    """Each vertex as a point of the first face that has it."""
    corner = np.empty(n_vertices, dtype=np.int64)
    flat = faces.reshape(-1)
    corner[flat[::-1]] = np.arange(len(flat))[::-1]
    return corner // 3, np.eye(3)[corner % 3]


class Refinement(NamedTuple):
    """A midpoint refinement as points of the coarse faces; numbered as `topology.py` says, coordinates exact."""

    at: ndarray  # (nV_L,) int64: a coarse face that has the vertex
    barycentric: ndarray  # (nV_L, 3) float64: the vertex in that face
    sizes: tuple[int, ...]  # vertices at each level
    faces: ndarray  # (nF_L, 3) int64: the refined faces' vertices
    owner: ndarray  # (nF_L,) int64: the coarse face that each lies in
    corners: ndarray  # (nF_L, 3, 3) float64: barycentric coordinates in the owner, of each corner


def refinement(faces: Int64[ndarray, "nF 3"], n_vertices: int, levels: int) -> Refinement:
    """The `levels`-th midpoint refinement; each coordinate is a sum of halves, quarters, ...: exact.

    Raises: ParameterizationError for a negative level; TooLargeError for more levels than fit into memory.
    """
    if levels < 0:
        raise ParameterizationError(f"levels = {levels}: take 0 or more.")
    check_fits(len(faces), levels)
    at, barycentric = corner_points(faces, n_vertices)
    topologies, refined = topology_levels(faces, n_vertices, levels)
    sizes = [n_vertices]
    owner = np.arange(len(faces))
    corners = np.broadcast_to(np.eye(3), (len(faces), 3, 3))
    for topology in topologies:
        halfedge = topology.edge_halfedges.max(axis=1)
        face, k = halfedge // 3, halfedge % 3
        at = np.concatenate([at, owner[face]])
        barycentric = np.concatenate([barycentric, (corners[face, k] + corners[face, (k + 1) % 3]) / 2])
        sizes.append(len(at))
        a, b, c = corners.transpose(1, 0, 2)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        corners = np.concatenate([np.stack(block, axis=1) for block in
                                  ((a, ab, ca), (b, bc, ab), (c, ca, bc), (bc, ca, ab))])
        owner = np.concatenate([owner] * 4)
    return Refinement(at, barycentric, tuple(sizes), refined, owner, corners)
