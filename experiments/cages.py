"""Artists' cages: does a scheme turn triangles over, or push the surface through itself?

    python -m experiments cages MESHES

MESHES holds INDEX.csv; taken are the manifold meshes of its group `lowpoly`, one of the two of spot's cage, two levels.
Turned: level-2 triangles whose normal is more than 90 degrees from that of the cage's face that they come from.
Crossing: pairs of the cage's faces of which pieces cross (exactly, by CGAL) that no pieces of the midpoint refinement
cross of.
Writes results/cages.json and, of each cage and its refinement by `default` with uncross,
docs/reproduction/cages.webp.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

import neusub
from experiments.common import parsed, parser_of, provenance, write_results
from experiments.drawing import BLUE, GREY, blank, shaded, titled, upright, write_panels
from experiments.measures import SCHEMES, is_turned, refined
from neusub.crossing import crossing_pairs, uncrossed

LEVELS = 2
AGAIN = "spot_control_mesh_uv"  # the same vertices as oded_spot_control_mesh
UNCROSS = ", uncross"
METHODS = (*SCHEMES[1:], "elephant", "default", "default" + UNCROSS)
COLUMNS, PANEL = 4, (170, 150)


def cages(folder: Path) -> dict[str, neusub.Mesh]:
    with (folder / "INDEX.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file)
                if row["group"] == "lowpoly" and row["manifold"] == "True" and row["name"] != AGAIN]
    return {row["name"]: neusub.load(folder / row["file"]) for row in rows}


def crossing(mesh: neusub.Mesh, n_faces: int) -> set[tuple[int, int]]:
    """Pairs of the n_faces that the mesh was refined from, of which pieces cross."""
    parents = np.sort(crossing_pairs(mesh.vertices, mesh.faces) % n_faces, axis=1)
    return {(a, b) for a, b in parents.tolist()}


def numbers_of(cage: neusub.Mesh, method: str, allowed: set[tuple[int, int]]) -> dict[str, int]:
    levels = refined(cage, method.removesuffix(UNCROSS), LEVELS)
    if method.endswith(UNCROSS):
        levels = uncrossed(cage, levels)
    return {"turned": int(is_turned(levels[-1], cage).sum()),
            "crossing": len(crossing(levels[-1], len(cage.faces)) - allowed)}


def rows_of(cage: neusub.Mesh) -> dict[str, dict[str, int]]:
    allowed = crossing(refined(cage, "midpoint", LEVELS)[-1], len(cage.faces))
    return {method: numbers_of(cage, method, allowed) for method in METHODS}


def title_of(name: str) -> str:
    """Without the collection that a mesh is from."""
    return " ".join(word for word in name.split("_")[1:] if word not in ("coarse", "control", "mesh"))


def draw(meshes: dict[str, neusub.Mesh]) -> Path:
    panels = []
    for name, cage in meshes.items():
        bare = upright(cage, name)
        fine = uncrossed(bare, refined(bare, "default", LEVELS))[-1]
        pair = [shaded(bare, GREY, PANEL, edges=True), shaded(fine, BLUE, PANEL, frame=bare)]
        panels.append(titled(np.concatenate(pair, axis=1), title_of(name)))
    panels += [blank(panels[0].shape[1::-1])] * (-len(panels) % COLUMNS)
    return write_panels("cages", [panels[k : k + COLUMNS] for k in range(0, len(panels), COLUMNS)])


def main() -> None:
    parser = parser_of("experiments cages", __doc__, "three cages")
    parser.add_argument("meshes", type=Path)
    options = parsed(parser)
    meshes = cages(options.meshes)
    if options.quick:
        meshes = dict(list(meshes.items())[:3])
    rows = {name: rows_of(mesh) for name, mesh in meshes.items()}
    for name, row in rows.items():
        print(f"{name:28s}", *(f"{method} {n['turned']}/{n['crossing']}" for method, n in row.items()))
    if not options.quick:
        print(draw(meshes))
    write_results("cages", {**provenance(options), "levels": LEVELS, "cages": rows}, options)


if __name__ == "__main__":
    main()
