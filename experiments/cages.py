"""Artists' cages: does a scheme turn triangles over, or push the surface through itself?

    pip install pymeshlab
    python -m experiments cages MESHES

MESHES holds INDEX.csv; taken are the manifold meshes of its group `lowpoly`, two levels.  Turned: level-2 triangles
whose normal is more than 90 degrees from that of the cage's face that they come from.  Crossing: faces of the cage that
pymeshlab does not find to cross another one, but one of their pieces at level 2.  It reports neighbours in one plane,
too (some of midpoint's pieces on every cage), so flat places count too many.
Writes results/cages.json and, of each cage and its refinement by `default`, docs/reproduction/cages.png.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy import ndarray

import neusub
from experiments.common import SCHEMES, parser_of, provenance, refined, write_results
from experiments.gallery_pictures import BLUE, GREY, shaded
from experiments.parameterization_pictures import titled, write
from experiments.robustness import turned

LEVELS = 2
METHODS = (*SCHEMES[1:], "elephant", "default")
COLUMNS, PANEL = 4, (170, 150)


def cages(folder: Path) -> dict[str, neusub.Mesh]:
    with (folder / "INDEX.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["group"] == "lowpoly" and row["manifold"] == "True"]
    return {row["name"]: neusub.load(folder / row["file"]) for row in rows}


def crossing(mesh: neusub.Mesh, n_faces: int) -> ndarray:
    """Which of the n_faces that the mesh was refined from have a piece that crosses another one (n_faces,)."""
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces))
    meshes.compute_selection_by_self_intersections_per_face()
    return meshes.current_mesh().face_selection_array().reshape(-1, n_faces).any(axis=0)


def numbers_of(cage: neusub.Mesh, method: str) -> dict[str, int]:
    n_faces = len(cage.faces)
    levels = refined(cage, method, LEVELS)
    share = turned([cage, *levels[1:]])[-1]
    crosses = crossing(levels[-1], n_faces) & ~crossing(cage, n_faces)
    return {"turned": round(share / 100 * len(levels[-1].faces)), "crossing": int(crosses.sum())}


def draw(meshes: dict[str, neusub.Mesh]) -> Path:
    panels = []
    for name, cage in meshes.items():
        bare = neusub.Mesh(cage.vertices, cage.faces)
        fine = refined(bare, "default", LEVELS)[-1]
        pair = [shaded(bare, GREY, PANEL, edges=True), shaded(fine, BLUE, PANEL, frame=bare)]
        panels.append(titled(np.concatenate(pair, axis=1), name))
    blank = np.full_like(panels[0], 255)
    panels += [blank] * (-len(panels) % COLUMNS)
    return write("cages", [panels[k : k + COLUMNS] for k in range(0, len(panels), COLUMNS)])


def main() -> None:
    parser = parser_of("experiments cages", __doc__)
    parser.add_argument("meshes", type=Path)
    options = parser.parse_args()
    meshes = cages(options.meshes)
    rows = {name: {method: numbers_of(mesh, method) for method in METHODS} for name, mesh in meshes.items()}
    for name, row in rows.items():
        print(f"{name:28s}", *(f"{method} {n['turned']}/{n['crossing']}" for method, n in row.items()))
    worse = {key: [name for name, row in rows.items() if row["default"][key]] for key in ("turned", "crossing")}
    print(draw(meshes), worse)
    write_results("cages", {**provenance(options), "levels": LEVELS, "default_not_zero": worse, "cages": rows})


if __name__ == "__main__":
    main()
