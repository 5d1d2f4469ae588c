"""Remeshing to subdivision connectivity: a coarse mesh whose refinements lie on the original surface, vertex by vertex.

The base is decimated, and each vertex of its midpoint refinements goes to its image under the map (Lee et al. 1998,
section 4.1, through successive self-parameterization).  Such meshes are what networks on subdivision connectivity
read, for example SubdivNet (Hu et al. 2022): 400 to 600 base faces, 3 levels.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from neusub.errors import DecimationError
from neusub.memory import check_fits
from neusub.mesh import Mesh, check_is_mesh
from neusub.selfparam import SelfParameterization, decimate
from neusub.selfparam.criteria import refusals
from neusub.selfparam.decimation import checked_targets
from neusub.selfparam.parameterization import Refinement, refinement

__all__ = ["remesh", "with_signals"]

FINEST = 3  # level to fit: each further one costs four times more, and the base has no more vertices to slide


def remesh(
    mesh: Mesh,
    *,
    n_vertices: int | None = None,
    n_faces: int | None = None,
    levels: int = 2,
    strategy: str | Any = "uniform",
    seed: int = 0,
    fit: bool = True,
) -> list[Mesh]:
    """Levels 0 .. levels over a coarse base, every vertex on the original surface.

    n_vertices or n_faces: of the base, exactly one.  strategy, seed: as in `decimate`; "uniform" gives even triangles.
    fit: slide the base's vertices along the surface where that brings the refinement closer to it (see
    `SelfParameterization.fitted`); triangles and map become a little less even.
    Face data follow from the face under each new face's centre; "original_face" is that face's index, for labels.
    UVs follow in one chart of the texture each; the load report says how many faces lie across a seam (for them,
    `SelfParameterization.bake`).  Colours are interpolated.
    Raises: DecimationError where the base cannot get so small, with the criteria that stopped it, and as `decimate`.
    """
    if levels < 0:
        raise DecimationError(f"levels = {levels}: take 0 or more.")
    check_is_mesh(mesh)
    _, faces = checked_targets(mesh, n_vertices, n_faces)
    check_fits(faces or 2 * (n_vertices or 0), levels)
    result = decimate(mesh, n_vertices=n_vertices, n_faces=n_faces, strategy=strategy, seed=seed)
    if not result.reached:
        asked = f"{n_vertices} vertices" if n_vertices else f"{n_faces} faces"
        raise DecimationError(f"the base stopped at {len(result.decimated)} vertices and {len(result.faces)} faces, "
                              f"{asked} were asked for. Refused: {refusals(result.counts)}. Ask for more.")
    if fit:
        result = result.fitted(min(levels, FINEST))
    return [with_signals(result, level) for level in range(levels + 1)]


def with_signals(result: SelfParameterization, level: int = 0) -> Mesh:
    """One level of the coarse mesh's refinement on the original surface, with the original's signals."""
    fine = result.fine
    refined: Refinement = refinement(result.faces, len(result.decimated), level)
    under, _ = result.to_fine(refined.owner, refined.corners.mean(axis=1))
    uv = uv_faces = None
    report: tuple[str, ...] = ()
    if fine.uv is not None and fine.uv_faces is not None:
        uv, uv_faces, crosses = result.transfer_corners(fine.uv, fine.uv_faces, level)
        if crosses.any():
            report = (f"{int(crosses.sum())} of {len(crosses)} faces lie across a seam of the texture, the first is "
                      f"face {int(np.argmax(crosses))}",)
    return Mesh(
        result.points(*result.to_fine(refined.at, refined.barycentric)),
        refined.faces,
        uv=uv,
        uv_faces=uv_faces,
        colors=None if fine.colors is None else result.transfer(fine.colors, level),
        face_data={**{name: values[under] for name, values in fine.face_data.items()}, "original_face": under},
        materials=fine.materials,
        load_report=report,
    )
