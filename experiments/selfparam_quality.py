"""Quality of the self-parameterization: level-2 remeshes at 500 faces, as decimated and fitted (as `neusub.remesh` does
by default), and the coarse triangles of the default pairs.

    python -m experiments selfparam_quality ../shared/data

Beside each number stands the authors' later C++ (libigl; quadric, one run).  Writes results/selfparam_quality.json.
"""

from __future__ import annotations

import argparse
from itertools import product
from pathlib import Path

import numpy as np

import neusub
from experiments.common import TOSCA, provenance, write_results
from neusub import Mesh, PairConfig, decimate
from neusub.discretization import generator_of, in_unit_box, make_pair, summary
from neusub.selfparam.parameterization import refinement
from neusub.selfparam.report import map_report

FACES, LEVELS, DRAWS, POINTS = 500, 2, 5, 100_000
# flipped triangles in %, mean distance and Hausdorff distance of the level-2 remesh, of the diagonal
REFERENCE = {
    "organic/ns_bunny": (0.04, 0.00032, 0.0045),
    "organic/ns_bob": (0.04, 0.00020, 0.0023),
    "manmade/ns_rocker_arm": (0.06, 0.00036, 0.0048),
    "manmade/common_fandisk": (0.56, 0.00011, 0.011),
    "organic/oded_koala": (0.16, 0.00040, 0.0070),
    "organic/ns_horse": (0.14, 0.00031, 0.012),
    "organic/oded_armadillo": (1.1, 0.00065, 0.011),
    "organic/ns_fat_dragon": (2.0, 0.00074, 0.012),
    "manmade/oded_boot": (4.3, 0.00087, 0.015),
}
PAIRS = ("organic/ns_bunny", "organic/ddg_kitten")


def remesh_quality(mesh: Mesh, reference: tuple[float, float, float], strategy: str, fit: bool) -> dict:
    result = decimate(mesh, n_faces=FACES, strategy=strategy)
    if fit:
        result = result.fitted(LEVELS)
    refined = refinement(result.faces, len(result.decimated), LEVELS)
    fine = Mesh(result.points(*result.to_fine(refined.at, refined.barycentric)), refined.faces)
    draws = [neusub.distance(fine, mesh, seed=seed) for seed in range(DRAWS)]
    report = map_report(result, LEVELS)
    numbers = {
        "reached": result.reached,
        "flipped_percent": 100 * report.flipped,
        "degenerate_percent": 100 * report.degenerate,
        "mean": float(np.mean([d.mean for d in draws])) / draws[0].diagonal,
        "hausdorff": float(np.mean([d.hausdorff for d in draws])) / draws[0].diagonal,
        **vars(report.on_surface),
        "conformal_median": report.conformal_median,
        "conformal_high": report.conformal_high,
        **round_trip(result),
        "refusals": report.refusals,
    }
    names = ("flipped_percent", "mean", "hausdorff")
    return {**numbers, "reference": dict(zip(names, reference))}


def round_trip(result: neusub.SelfParameterization) -> dict:
    """Coarse -> fine -> coarse of random points, and whether fine points cover every coarse face."""
    rng = np.random.default_rng(0)
    faces, barycentric = rng.integers(0, len(result.faces), POINTS), rng.dirichlet([1, 1, 1], POINTS)
    back_faces, back = result.to_coarse(*result.to_fine(faces, barycentric))
    corners = result.decimated[result.faces]
    moved = (barycentric[:, :, None] * corners[faces]).sum(1) - (back[:, :, None] * corners[back_faces]).sum(1)
    error = np.linalg.norm(moved, axis=1) / np.linalg.norm(np.ptp(result.fine.vertices, axis=0))
    down, _ = result.to_coarse(rng.integers(0, len(result.fine.faces), POINTS), barycentric)
    return {"round_trip_99.9": float(np.percentile(error, 99.9)), "round_trip_worst": float(error.max()),
            "coarse_faces_covered": len(np.unique(down)) / len(result.faces)}


def pair_quality(mesh: Mesh, count: int = 40) -> dict:
    """The report of default pairs: the paper's sizes, two levels."""
    fine, config = in_unit_box(mesh), PairConfig(per_mesh=count)
    made = [make_pair(fine, config, generator_of(0, "train", "0", k)) for k in range(count)]
    reports = [vars(map_report(result, config.levels)) for _, result in made]
    return summary([pair for pair, _ in made], reports)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="the folder that holds meshes/ and tosca/")
    options = parser.parse_args()
    meshes = {name: neusub.load(options.data / "meshes" / f"{name}.ply") for name in {*REFERENCE, *PAIRS}}
    rows: dict = {}
    for strategy, fit in product(("quadric", "uniform"), (False, True)):
        kind = f"{strategy}, fitted" if fit else strategy
        rows[kind] = {}
        for name, reference in REFERENCE.items():
            rows[kind][name] = row = remesh_quality(meshes[name], reference, strategy, fit)
            print(kind, name, *(f"{row[key]:.5f} ({value})" for key, value in row["reference"].items()), flush=True)
    pairs = {name: pair_quality(meshes[name]) for name in PAIRS}
    centaur = np.load(options.data / "tosca" / "centaur.npz")
    pairs["tosca/centaur0"] = pair_quality(Mesh(centaur["V"][0].astype(np.float64), centaur["F"].astype(np.int64)))
    for name, numbers in pairs.items():
        print(name, numbers, flush=True)
    write_results("selfparam_quality", {
        **provenance(options),
        "settings": {"faces": FACES, "levels": LEVELS, "draws": DRAWS, "points": POINTS},
        "remesh": rows,
        "pairs": pairs,
        "pairs_of_the_authors_elephant": {"quality_low": 0.215, "quality_median": 0.77, "area_variation": 0.58},
        "citation": TOSCA,
    })


if __name__ == "__main__":
    main()
