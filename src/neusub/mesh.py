"""The mesh that everything works on: checked once, here, and frozen.

`Mesh` is an oriented 2-manifold of triangles, with or without boundary, of any number of components.  Zero-area faces
are allowed.  Data lie on vertices (`colors`), on corners (`uv_faces` into `uv`, so that seams stay seams) and on faces
(`face_data`; the key "material" indexes `materials`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64
from numpy import ndarray

from neusub.errors import IndexRangeError, NonFiniteError, ShapeError
from neusub.problems import as_floats, as_indices, iterate_problems, listed_row, more_of, non_finite_problems
from neusub.topology import Topology, build_topology, refine_corners

__all__ = ["Material", "Mesh", "check_is_mesh"]


@dataclass(frozen=True)
class Material:
    """How a group of faces looks.  Texture files are kept as they came, undecoded.

    color: linear factors r, g, b, a in [0, 1].  textures: (role, file name, bytes), the role being the word of an MTL
    file ("map_Kd" is the base colour), with its options ("map_Kd -s 2 2 1").  extra: further lines of the MTL file,
    word by word.
    """

    name: str = "material"
    color: tuple[float, float, float, float] | None = None
    textures: tuple[tuple[str, str, bytes], ...] = ()
    extra: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Mesh:
    """An oriented manifold triangle mesh, checked on construction; its arrays are copies and read-only.

    vertices (nV, 3): positions, any length unit.  faces (nF, 3): counter-clockwise seen from outside.
    uv (nT, 2) and uv_faces (nF, 3): texture coordinates, v upwards, and each corner's index into them.
    colors (nV, 3 or 4): RGB or RGBA in [0, 1]; integer input counts as 0 .. 255.
    face_data: name -> (nF, ...), which follows its faces through refinement.
    Raises: the `MeshError` of the first kind that `problems.py` finds; `ShapeError` for arrays that do not fit.
    """

    vertices: Float64[ndarray, "nV 3"]
    faces: Int64[ndarray, "nF 3"]
    uv: Float64[ndarray, "nT 2"] | None = None
    uv_faces: Int64[ndarray, "nF 3"] | None = None
    colors: Float64[ndarray, "nV C"] | None = None
    face_data: Mapping[str, ndarray] = field(default_factory=dict)
    materials: tuple[Material, ...] = ()
    load_report: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        vertices = as_floats(self.vertices, "vertices", (3,))
        faces = as_indices(self.faces, "faces")
        for problem in iterate_problems(vertices, faces):
            raise problem
        uv, uv_faces = checked_uv(self.uv, self.uv_faces, len(faces))
        self._fill(
            vertices=vertices,
            faces=faces,
            uv=uv,
            uv_faces=uv_faces,
            colors=checked_colors(self.colors, len(vertices)),
            face_data=checked_face_data(self.face_data, len(faces), len(self.materials)),
            materials=tuple(self.materials),
            load_report=tuple(self.load_report),
        )

    @classmethod
    def _trusted(cls, **values: Any) -> Mesh:
        """A mesh from fields that are known to be right, unchecked and uncopied."""
        mesh = object.__new__(cls)
        defaults = {"uv": None, "uv_faces": None, "colors": None, "face_data": {}, "materials": (), "load_report": ()}
        mesh._fill(**{**defaults, **values})
        return mesh

    def _fill(self, **values: Any) -> None:
        for array in [*values.values(), *values["face_data"].values()]:
            if isinstance(array, ndarray):
                array.flags.writeable = False
        if not isinstance(values["face_data"], MappingProxyType):
            values["face_data"] = MappingProxyType(values["face_data"])
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "face_data": dict(self.face_data)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Frozen again: arrays come writable out of a pickle or a copy."""
        self._fill(**state)

    @cached_property
    def topology(self) -> Topology:
        """Edges and half-edges, built on first use."""
        return build_topology(self.faces, len(self.vertices))

    def replace_vertices(self, vertices: Float64[ndarray, "nV 3"]) -> Mesh:
        """The same mesh with every vertex elsewhere.  Raises: ShapeError, NonFiniteError."""
        vertices = as_floats(vertices, "vertices", (3,))
        if len(vertices) != len(self.vertices):
            raise ShapeError(f"{len(vertices)} positions for {len(self.vertices)} vertices: give one for each.")
        for problem in non_finite_problems(vertices):
            raise problem
        mesh = Mesh._trusted(**{**self._values(), "vertices": vertices})
        if "topology" in self.__dict__:  # the connectivity is the same one
            mesh.__dict__["topology"] = self.topology
        return mesh

    def replace_materials(self, materials: tuple[Material, ...]) -> Mesh:
        """The same mesh with other materials, as many.  Raises: ShapeError."""
        if len(materials) != len(self.materials):
            raise ShapeError(f"{len(materials)} materials for {len(self.materials)}: give one for each.")
        return Mesh._trusted(**{**self._values(), "materials": tuple(materials)})

    def refined(
        self,
        vertices: Float64[ndarray, "nV_fine 3"],
        faces: Int64[ndarray, "4*nF 3"] | None = None,
        colors: Float64[ndarray, "nV_fine C"] | None = None,
    ) -> Mesh:
        """One midpoint refinement, with positions (and colours) of the old vertices and then of the edges' midpoints.

        faces: the topology's `refined_faces`, for a caller who has them; shared, and read-only from then on.  UVs go
        linearly along each corner edge, face data to the four children of their face.  Nothing is checked again:
        refinement keeps a manifold.
        """
        uv, uv_faces = self.uv, self.uv_faces
        if uv is not None and uv_faces is not None:
            chart = build_topology(uv_faces, len(uv))
            uv = np.concatenate([uv, uv[chart.edges].mean(axis=1)])
            uv_faces = refine_corners(uv_faces, chart.face_edges + chart.n_vertices)
        return Mesh._trusted(
            vertices=np.array(vertices, dtype=np.float64),
            faces=self.topology.refined_faces if faces is None else faces,
            uv=uv,
            uv_faces=uv_faces,
            colors=None if colors is None else np.array(colors, dtype=np.float64),
            face_data={name: np.concatenate([values] * 4) for name, values in self.face_data.items()},
            materials=self.materials,
            load_report=self.load_report,
        )

    def _values(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}


def check_is_mesh(mesh: Any, name: str = "mesh") -> None:
    """Raises TypeError."""
    if not isinstance(mesh, Mesh):
        raise TypeError(f"{name} is a {type(mesh).__name__}: load a file with neusub.load, or build a neusub.Mesh.")


def checked_uv(uv: Any, uv_faces: Any, n_faces: int) -> tuple[ndarray | None, ndarray | None]:
    if (uv is None) != (uv_faces is None):
        raise ShapeError("uv and uv_faces come together: give both, or neither.")
    if uv is None:
        return None, None
    uv, uv_faces = as_floats(uv, "uv", (2,)), as_indices(uv_faces, "uv_faces")
    if len(uv_faces) != n_faces:
        raise ShapeError(f"uv_faces has {len(uv_faces)} rows for {n_faces} faces: give one for each.")
    bad = ~np.isfinite(uv).all(axis=1)
    if bad.any():
        raise NonFiniteError(f"uv {int(np.argmax(bad))} is {listed_row(uv[np.argmax(bad)])}. Give finite coordinates.")
    bad = ((uv_faces < 0) | (uv_faces >= len(uv))).any(axis=1)
    if bad.any():
        f = int(np.argmax(bad))
        raise IndexRangeError(f"uv_faces {f} is {listed_row(uv_faces[f])}, but there are {len(uv)} rows of uv.")
    return uv, uv_faces


def checked_colors(colors: Any, n_vertices: int) -> Float64[ndarray, "nV C"] | None:
    if colors is None:
        return None
    is_integer = np.asarray(colors).dtype.kind in "iu"
    array = as_floats(colors, "colors", (3, 4))
    if len(array) != n_vertices:
        raise ShapeError(f"colors has {len(array)} rows for {n_vertices} vertices: give one for each.")
    if not np.isfinite(array).all():
        raise NonFiniteError("colors has a value that is not finite. Give values in [0, 1].")
    array = array / 255.0 if is_integer else array
    bad = ((array < -1e-6) | (array > 1 + 1e-6)).any(axis=1)  # rounding is forgiven
    if bad.any():
        v = int(np.argmax(bad))
        raise IndexRangeError(f"the color of vertex {v} is {listed_row(np.asarray(colors)[v])}"
                              f"{more_of(bad.sum(), 'vertex')}. Give values in [0, 1], or integers from 0 to 255.")
    return array.clip(0, 1)


def checked_face_data(face_data: Mapping[str, Any] | None, n_faces: int, n_materials: int) -> dict[str, ndarray]:
    checked = {name: np.array(values) for name, values in (face_data or {}).items()}
    for name, values in checked.items():
        if values.ndim == 0 or len(values) != n_faces:
            raise ShapeError(f"face_data[{name!r}] has shape {values.shape} for {n_faces} faces: give a row for each.")
    material = checked.get("material")
    if n_materials and material is not None and (material.min() < -1 or material.max() >= n_materials):
        raise IndexRangeError(f"face_data['material'] goes to {material.max()}, but there are {n_materials} materials.")
    return checked
