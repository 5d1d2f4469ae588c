"""Quality of the self-parameterization: level-2 remeshes at 500 faces, as decimated and fitted (as `neusub.remesh` does
by default), and the coarse triangles of the default pairs.

    python -m experiments selfparam_quality DATA

DATA is the folder that holds meshes/ and tosca/.

Beside each number stands the authors' later C++ (libigl; quadric, one run).  Writes results/selfparam_quality.json.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np

import neusub
from experiments.common import TOSCA, parsed, parser_of, provenance, write_results
from experiments.measures import remeshed, round_trip
from neusub import Mesh, PairConfig, decimate
from neusub.discretization import generator_of, in_unit_box, make_pair, summary
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
    fine = remeshed(result, LEVELS)
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
        **came_back(result),
        "refusals": report.refusals,
    }
    names = ("flipped_percent", "mean", "hausdorff")
    return {**numbers, "reference": dict(zip(names, reference))}


def came_back(result: neusub.SelfParameterization) -> dict:
    """Coarse -> fine -> coarse of random points, and whether fine points cover every coarse face."""
    error, rng = round_trip(result, POINTS), np.random.default_rng(1)
    down, _ = result.to_coarse(rng.integers(0, len(result.fine.faces), POINTS), rng.dirichlet([1, 1, 1], POINTS))
    return {"round_trip_99.9": float(np.percentile(error, 99.9)), "round_trip_worst": float(error.max()),
            "coarse_faces_covered": len(np.unique(down)) / len(result.faces)}


def pair_quality(mesh: Mesh, count: int) -> dict:
    """The report of default pairs: the paper's sizes, two levels."""
    fine, config = in_unit_box(mesh), PairConfig(per_mesh=count)
    made = [make_pair(fine, config, generator_of(0, "train", "0", k)) for k in range(count)]
    reports = [vars(map_report(result, config.levels)) for _, result in made]
    return summary([pair for pair, _ in made], reports)


def main() -> None:
    parser = parser_of("experiments selfparam_quality", __doc__, "one shape, 4 pairs")
    parser.add_argument("data", type=Path, help="the folder that holds meshes/ and tosca/")
    options = parsed(parser)
    shapes, paired, count = REFERENCE, PAIRS, 40
    if options.quick:
        shapes, paired, count = dict(list(REFERENCE.items())[:1]), PAIRS[:1], 4
    meshes = {name: neusub.load(options.data / "meshes" / f"{name}.ply") for name in {*shapes, *paired}}
    rows: dict = {}
    for strategy, fit in product(("quadric", "uniform"), (False, True)):
        kind = f"{strategy}, fitted" if fit else strategy
        rows[kind] = {}
        for name, reference in shapes.items():
            rows[kind][name] = row = remesh_quality(meshes[name], reference, strategy, fit)
            print(kind, name, *(f"{row[key]:.5f} ({value})" for key, value in row["reference"].items()), flush=True)
    pairs = {name: pair_quality(meshes[name], count) for name in paired}
    centaur = np.load(options.data / "tosca" / "centaur.npz")
    pairs["tosca/centaur0"] = pair_quality(
        Mesh(centaur["V"][0].astype(np.float64), centaur["F"].astype(np.int64)), count)
    for name, numbers in pairs.items():
        print(name, numbers, flush=True)
    write_results("selfparam_quality", {
        **provenance(options),
        "settings": {"faces": FACES, "levels": LEVELS, "draws": DRAWS, "points": POINTS},
        "remesh": rows,
        "pairs": pairs,
        "pairs_of_the_authors_elephant": {"quality_low": 0.215, "quality_median": 0.77, "area_variation": 0.58},
        "citation": TOSCA,
    }, options)


if __name__ == "__main__":
    main()
