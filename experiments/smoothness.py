"""How smooth the demo's refined meshes are: angles between neighbouring faces, folds, distances where there is a truth.

    python -m experiments smoothness

Two levels of each scheme and of the shipped weights.  A fold is an edge whose faces turn by more than 120 degrees; the
coarse meshes have some.  The ring is a torus, for which the third level is there, too: its own angles are given for
the refinement's vertices moved onto it, how far from those the refinement's are (root mean square), and how far the
faces' normals are from its own, in degrees.
Writes results/smoothness.json.
"""

from __future__ import annotations

import sys

import numpy as np

import neusub
from experiments.common import HERE, parsed, parser_of, provenance, write_results
from experiments.measures import FOLD, SCHEMES, angles, refined, score
from neusub.metrics import face_normals

TUBE = 0.4  # of the demo's ring, whose larger radius is 1


def torus_at(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the torus that the ring was cut from: its points nearest to some, and its unit normals there."""
    around = points * [1, 1, 0]
    centre = around / np.linalg.norm(around, axis=1, keepdims=True)
    normals = (points - centre) / np.linalg.norm(points - centre, axis=1, keepdims=True)
    return centre + TUBE * normals, normals


def on_torus(mesh: neusub.Mesh) -> neusub.Mesh:
    """The same faces, their vertices moved to the torus."""
    return mesh.replace_vertices(torus_at(mesh.vertices)[0])


def numbers_of(mesh: neusub.Mesh, name: str, truth: neusub.Mesh | None) -> dict:
    degrees = angles(mesh)
    numbers = {"mean": float(degrees.mean()), "median": float(np.median(degrees)), "folds": int((degrees > FOLD).sum())}
    if name == "ring":
        exact = on_torus(mesh)
        own = angles(exact)
        wanted = torus_at(mesh.vertices[mesh.faces].mean(axis=1))[1]
        cosine = (face_normals(mesh) * wanted).sum(axis=1).clip(-1, 1)
        numbers |= {"normals_off_the_torus": float(np.degrees(np.arccos(cosine)).mean()),
                    "mean_on_the_torus": float(own.mean()),
                    "deviation_from_the_torus": float(np.sqrt(((degrees - own) ** 2).mean())),
                    "distance_to_the_torus": float(np.linalg.norm(mesh.vertices - exact.vertices, axis=1).mean())}
    if truth is not None:
        numbers["H"], numbers["M"] = score(mesh, truth)
    return numbers


def main() -> None:
    options = parsed(parser_of("experiments smoothness", __doc__, "two of the meshes, and the ring at level 3"))
    sys.path.insert(0, str(HERE.parent / "examples"))
    import demo

    fine = demo.blob()
    meshes = {**demo.low_poly_models(), "blob": demo.decimated_on_surface(fine, 400), "ring": demo.textured_ring()}
    rows: dict = {}
    for name, levels in [(name, 2) for name in meshes][: 2 if options.quick else None] + [("ring", 3)]:
        mesh, truth = meshes[name], fine if name == "blob" else None
        results = {method: refined(mesh, method, levels)[-1] for method in (*SCHEMES, "elephant", "default")}
        row = name if levels == 2 else f"{name}, level {levels}"
        rows[row] = {} if levels > 2 else {"coarse": numbers_of(mesh, "", None)}
        rows[row] |= {method: numbers_of(result, name, truth) for method, result in results.items()}
        for method, numbers in rows[row].items():
            print(f"{row:15s}{method:10s}", *(f"{key} {value:.4g}" for key, value in numbers.items()), flush=True)
    write_results("smoothness", {**provenance(options), "meshes": rows}, options)


if __name__ == "__main__":
    main()
