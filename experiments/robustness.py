"""Every manifold mesh of a folder, as it is and decimated to 500 vertices, levels 1 to 4: nothing may explode.

    python -m experiments robustness MESHES

MESHES holds INDEX.csv and the files that it lists.  For each level: vertices that are not finite, vertices further from
the coarse surface than the longest edge around the nearest coarse vertex, and flipped triangles beside Loop's (a
triangle is flipped where its normal turns by more than 90 degrees from the coarse face that it comes from).
Writes results/robustness.json.
"""

from __future__ import annotations

import csv
from pathlib import Path

import igl
import numpy as np

import neusub
from experiments.common import parsed, parser_of, provenance, write_results
from experiments.measures import is_turned
from neusub import NeusubError

SIZE, LEVELS = 500, 4


def coarse_meshes(folder: Path, row: dict, most_faces: int) -> dict[str, neusub.Mesh]:
    """A mesh as it is, where it is small enough, and decimated, in both kinds of position."""
    mesh = neusub.load(folder / row["file"])
    meshes = {"as it is": mesh} if len(mesh.faces) <= most_faces else {}
    if len(mesh.vertices) > SIZE:
        result = neusub.decimate(mesh, n_vertices=SIZE)
        meshes |= {"on_surface": result.on_surface, "decimated": result.coarse}
    return meshes


def far(coarse: neusub.Mesh, mesh: neusub.Mesh) -> int:
    """How many vertices are further from the coarse surface than the longest edge around the nearest coarse vertex."""
    squared, face, _ = igl.point_mesh_squared_distance(mesh.vertices, coarse.vertices, coarse.faces)
    edges = coarse.topology.edges
    length = np.linalg.norm(np.diff(coarse.vertices[edges], axis=1)[:, 0], axis=1)
    longest = np.zeros(len(coarse.vertices))
    for column in edges.T:
        np.maximum.at(longest, column, length)
    return int((np.sqrt(squared) > longest[coarse.faces[face]].max(axis=1)).sum())


def check(coarse: neusub.Mesh, model: neusub.Subdivider, kind: str, levels: int) -> dict:
    ours = [coarse, *model.subdivide(coarse, levels, input="decimated" if kind == "decimated" else "on_surface")[1:]]
    loop = neusub.subdivide(coarse, "loop", levels)
    turned = [100 * float(is_turned(a, coarse).mean() - is_turned(b, coarse).mean()) for a, b in zip(ours, loop)]
    return {"not_finite": int(sum((~np.isfinite(mesh.vertices)).sum() for mesh in ours)),
            "far": [far(coarse, mesh) for mesh in ours[1:]],
            "turned": [round(share, 4) for share in turned[1:]]}


def main() -> None:
    parser = parser_of("experiments robustness", __doc__, "ten meshes, two levels")
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--levels", type=int, default=LEVELS)
    parser.add_argument("--model", default="default", help="a name or a file")
    parser.add_argument("--most-faces", type=int, default=5000, help="meshes with more are refined decimated only")
    options = parsed(parser)
    model, rows, refused = neusub.Subdivider.load(options.model), {}, {}
    with (options.meshes / "INDEX.csv").open(newline="") as file:
        entries = [row for row in csv.DictReader(file) if row["manifold"] == "True"]
    if options.quick:
        entries, options.levels = entries[:: max(1, len(entries) // 10)][:10], 2
    for row in entries:
        try:
            meshes = coarse_meshes(options.meshes, row, options.most_faces)
        except NeusubError as error:
            refused[row["name"]] = f"{type(error).__name__}: {error}"
            continue
        for kind, mesh in meshes.items():
            rows[f"{row['name']}, {kind}"] = numbers = check(mesh, model, kind, options.levels)
            print(f"{row['name']:32s}{kind:12s}{numbers}", flush=True)
    worst = {"not_finite": sum(n["not_finite"] for n in rows.values()),
             "far": sum(sum(n["far"]) for n in rows.values()),
             "turned_more_than_loop": max(max(n["turned"]) for n in rows.values())}
    write_results("robustness", {**provenance(options), "levels": options.levels, "worst": worst, "meshes": rows,
                                 "refused": refused}, options)


if __name__ == "__main__":
    main()
