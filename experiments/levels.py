"""Levels beyond the trained ones: the network all the way, the network and then Loop, Loop, butterfly.

    python -m experiments levels TOSCA MESHES --inputs tosca8_coarse.npz [--quick]

TOSCA is the folder of <category>.npz, MESHES the one that holds INDEX.csv, for the picture.  The eight fixed inputs
with vertices on the surface, to levels 1 to 5.  `elephant` learned two, `default` three.  H and M are in TOSCA's units.
Angles are in degrees, between the normals of neighbouring faces.  Writes results/levels.json and
docs/reproduction/levels.webp; --quick takes two shapes to level 3, and writes nothing.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy import ndarray

import neusub
from experiments import measures
from experiments.common import TOSCA, fixed_inputs, fixed_reference, parsed, parser_of, provenance, write_results
from experiments.drawing import BACK, CLAY, UP, panel, titled, write_panels
from experiments.measures import FOLD, angles, mean_of, score
from neusub.map_pictures import View
from neusub.metrics import face_normals

SHOWS = ("fig:lim_beyondSubd",)
LEVELS = 5
MODELS, SCHEMES = ("elephant", "default"), ("loop", "butterfly")
METHODS = (*MODELS, *(f"{model}, then loop" for model in MODELS), *SCHEMES)
DRAWN, COARSE = "organic/oded_spot.ply", 402  # as many vertices as the fixed inputs have
HEAD = np.array([[0.28, 0.65, 0.0], [0.72, 0.91, 0.4]])  # of spot's box: the part that the close-ups show
LIGHT = (0.9, 0.5, 0.3)  # light from the side shows what is not smooth


def refined(mesh: neusub.Mesh, method: str, levels: int) -> list[neusub.Mesh]:
    """Levels 0 to `levels`."""
    name, _, then = method.partition(", ")
    if not then:
        return measures.refined(mesh, name, levels)
    model = measures.loaded(name)
    learned = min(model.network.plan.trained, levels)
    return model.subdivide(mesh, learned, levels - learned)


def numbers_of(mesh: neusub.Mesh, reference: neusub.Mesh) -> dict:
    """Twice finer triangles have half the angle on a smooth surface, and four times the edges: mean times the root of
    the number of edges stays the same there, and grows where a scheme makes the surface rough."""
    degrees = angles(mesh)
    h, m = score(mesh, reference)
    return {"H": h, "M": m, "mean_angle": float(degrees.mean()), "angle_99": float(np.percentile(degrees, 99)),
            "folds_percent": 100 * float((degrees > FOLD).mean()), "total_angle": float(degrees.sum()),
            "mean_angle_root_edges": float(degrees.mean() * np.sqrt(len(degrees))),
            "angle_99_root_edges": float(np.percentile(degrees, 99) * np.sqrt(len(degrees)))}


def table(options: argparse.Namespace, levels: int) -> dict:
    """Of each method and level, the means over the shapes."""
    rows: dict = {method: {level: [] for level in range(1, levels + 1)} for method in METHODS}
    meshes = fixed_inputs(options.inputs, "on_surface")
    for name in list(meshes)[:2] if options.quick else meshes:
        reference = fixed_reference(options.tosca, name)
        for method in METHODS:
            for level, mesh in enumerate(refined(meshes[name], method, levels)[1:], start=1):
                rows[method][level].append(numbers_of(mesh, reference))
        print(name, *(f"{method} {rows[method][levels][-1]['M']:.3f}" for method in METHODS), flush=True)
    return {method: {f"level {level}": mean_of(shapes) for level, shapes in by_level.items()}
            for method, by_level in rows.items()}


# --- the picture -------------------------------------------------------------------------------------------------


def flat(mesh: neusub.Mesh, view: View) -> ndarray:
    """Each face in one shade, darker where it turns from the light."""
    cosine = face_normals(mesh) @ (np.array(LIGHT) / np.linalg.norm(LIGHT))
    return panel(mesh, view, (0.4 + 0.6 * (1 + cosine[:, None]) / 2) * np.array(CLAY))


def draw(folder: Path) -> Path:
    """fig:lim_beyondSubd, on a shape whose licence is free."""
    fine = neusub.load(folder / DRAWN)
    coarse = neusub.decimate(fine, n_vertices=COARSE).on_surface
    low, size = coarse.vertices.min(axis=0), np.ptp(coarse.vertices, axis=0)
    corners = low + size * np.array([[x, y, z] for x in HEAD[:, 0] for y in HEAD[:, 1] for z in HEAD[:, 2]])
    box = neusub.Mesh(corners, np.array([[0, 1, 2], [3, 2, 1], [4, 5, 6], [7, 6, 5]]))  # two sides have all corners
    view = View(box, (280, 225), BACK, UP)
    rows = []
    for method in ("elephant", "elephant, then loop", "default", "loop"):
        meshes = refined(coarse, method, LEVELS)
        rows.append([titled(flat(meshes[level], view), f"{method}, level {level}") for level in range(2, LEVELS + 1)])
    return write_panels("levels", rows)


def main() -> None:
    parser = parser_of("experiments levels", __doc__, "two shapes to level 3")
    parser.add_argument("tosca", type=Path)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--inputs", type=Path, required=True, help="tosca8_coarse.npz, the eight fixed inputs")
    options = parsed(parser)
    rows = table(options, 3 if options.quick else LEVELS)
    for method, levels in rows.items():
        for level, row in levels.items():
            print(f"{method:22s}{level}  H {row['H']:.3f}  M {row['M']:.4f}  mean angle {row['mean_angle']:.2f}  "
                  f"99 % {row['angle_99']:.1f}  times root {row['mean_angle_root_edges']:.0f}")
    if not options.quick:
        print(draw(options.meshes))
    settings = {"inputs": "on_surface", "levels": LEVELS}
    write_results("levels", {"citation": TOSCA, **provenance(options), "settings": settings, "methods": rows}, options)


if __name__ == "__main__":
    main()
