"""Man-made shapes that no training saw: distances, normals, and whether straight sharp edges stay straight.

    python -m experiments manmade MESHES

MESHES holds INDEX.csv and its files; taken are the manifold meshes of the group `manmade` that recipes/default.json
does not train on and that go down to 500 vertices; two levels, both kinds of input.  M in % of the diagonal, normals in
degrees.

A straight sharp edge is a coarse edge along which the fine surface itself, by the map, turns by more than 40 degrees
and bends by less than half a degree: the four pieces of its refinement should not leave the line between its ends by
more than a degree.  Only for vertices on the surface; decimated ones are not on the edge.
Writes results/manmade.json.
"""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np

import neusub
from experiments.common import HERE, parsed, parser_of, provenance, write_results
from experiments.measures import SCHEMES, refined
from neusub.creases import crease_edges

SIZE, LEVELS = 500, 2
METHODS = (*SCHEMES, "elephant", "mechanical", "default")
SHARP, STRAIGHT, KEPT = 40.0, 0.5, 1.0  # degrees


def along_edges(levels: list[neusub.Mesh]) -> np.ndarray:
    """Vertices of the second level along each coarse edge (nE, 5)."""
    coarse, first = levels[0].topology, levels[1].topology
    middle = coarse.n_vertices + np.arange(len(coarse.edges))
    key = first.edges @ [first.n_vertices, 1]
    halves = [first.n_vertices + np.searchsorted(key, end * first.n_vertices + middle) for end in coarse.edges.T]
    return np.stack([coarse.edges[:, 0], halves[0], middle, halves[1], coarse.edges[:, 1]], axis=1)


def bends(vertices: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """The largest angle between a piece of each line and the way from its first to its last vertex, in degrees."""
    points = vertices[lines]
    pieces, whole = np.diff(points, axis=1), points[:, -1:] - points[:, :1]
    across = np.linalg.norm(np.cross(pieces, whole), axis=2)
    return np.degrees(np.arctan2(across, (pieces * whole).sum(axis=2))).max(axis=1)


def straight_sharp(result: neusub.SelfParameterization, levels: list[neusub.Mesh]) -> np.ndarray:
    """The lines that should stay straight."""
    truth = levels[-1].replace_vertices(result.transfer(result.fine.vertices, LEVELS))
    lines = along_edges(levels)
    sharp = crease_edges(truth.topology, truth.vertices, SHARP)
    key, n = truth.topology.edges @ [len(truth.vertices), 1], len(truth.vertices)
    pieces = np.sort(np.stack([lines[:, :-1], lines[:, 1:]], axis=2), axis=2)
    found = sharp[np.searchsorted(key, pieces[..., 0] * n + pieces[..., 1])]
    return lines[found.all(axis=1) & (bends(truth.vertices, lines) < STRAIGHT)]


def rows_of(result: neusub.SelfParameterization) -> dict:
    mesh, rows = result.fine, {}
    for kind, coarse in (("on_surface", result.on_surface), ("decimated", result.coarse)):
        for method in METHODS:
            levels = refined(coarse, method, LEVELS, kind)
            d = neusub.distance(levels[-1], mesh)
            row = {"M": d.percent(d.mean), "normal": d.normal_angle}
            if kind == "on_surface":
                lines = straight_sharp(result, levels)
                bend = bends(levels[-1].vertices, lines)
                row |= {"lines": len(lines), "straight": float((bend < KEPT).mean()) if len(lines) else None,
                        "bend_95": float(np.percentile(bend, 95)) if len(lines) else None}
            rows.setdefault(kind, {})[method] = row
    return rows


def main() -> None:
    parser = parser_of("experiments manmade", __doc__, "three shapes")
    parser.add_argument("meshes", type=Path)
    options = parsed(parser)
    recipe = json.loads((HERE / "recipes" / "default.json").read_text())
    seen = {source["file"] for source in recipe["sources"]}
    shapes: dict = {}
    with (options.meshes / "INDEX.csv").open(newline="") as file:
        entries = [row for row in csv.DictReader(file) if row["group"] == "manmade" and row["manifold"] == "True"]
    for entry in entries:
        if entry["file"] in seen or (options.quick and len(shapes) == 3):
            continue
        mesh = neusub.load(options.meshes / entry["file"])
        result = neusub.decimate(mesh, n_vertices=SIZE) if int(entry["nV"]) > SIZE else None
        if result is None or not result.reached:
            print(f"{entry['name']}: left out, it does not go down to {SIZE} vertices", flush=True)
            continue
        shapes[entry["name"]] = rows_of(result)
        for kind, rows in shapes[entry["name"]].items():
            print(f"{entry['name']:20s}{kind:12s}", *(shown(name, row) for name, row in rows.items()), flush=True)
    write_results("manmade", {**provenance(options), "shapes": shapes}, options)


def shown(name: str, row: dict) -> str:
    straight = row.get("straight")
    return f"{name} {row['M']:.4f}/{row['normal']:.2f}" + ("" if straight is None else f"/{straight:.2f}")


if __name__ == "__main__":
    main()
