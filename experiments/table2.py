"""Table 2: train on one category of TOSCA (top) or on three (bottom), subdivide shapes of all the others.

    python -m experiments table2 TOSCA --inputs tosca8_coarse.npz
    python -m experiments table2 TOSCA --inputs tosca8_coarse.npz --part bottom
    python -m experiments table2 TOSCA --inputs tosca8_coarse.npz --loss surface

TOSCA is the folder of <category>.npz.  The paper's protocol (app:experiments): 200 discretizations of 150 to 300
vertices in total, two levels, 700 epochs of one mesh a step.  Test inputs come from `decimate(strategy="quadric")` down
to 350 to 450 vertices, default criteria, seeded by category and pose; once with their vertices on the surface, once
where the decimation put them.  Adds a part to results/table2.json; the numbers are in TOSCA's units.

--epochs stops the training sooner (its rate is constant).  --loss surface is not the paper's: the same network and
pairs, the distance to the target with half of the error along the surface forgiven, batches of two and a cosine
schedule (or --cycles of them), 150 epochs; its part is named with the loss.  --vertices 250:350 makes the training's
coarse meshes as large as those of the authors' public elephant pairs are (251 to 350), whatever the paper says; its
part is named with them.  --varied: the poses and three copies of each, stretched and bent at random, half of the
discretizations by the strategy of the test inputs, still 200 in total; its part is named so.  --weighting areas: errors
count by the area around their vertex, as in M; its part is named so.  As in the paper, no displacement is bounded, but
with --bounded, which changes the scores alone.  --seen scores the very shapes of the training, and with --varied nearly
its discretizations: what is left when nothing has to generalize.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import neusub
from experiments.common import (
    TOSCA,
    add_result,
    fixed_inputs,
    fixed_reference,
    parsed,
    parser_of,
    provenance,
    seeded,
    show,
    tosca_poses,
    training_scores,
)
from experiments.measures import KINDS, SCHEMES, angles, mean_of, refined, score
from experiments.sources import bent, stretched
from neusub import PRESETS, PairConfig, make_pairs, train
from neusub.generation import load_pairs, read_header
from neusub.metrics import triangle_quality
from neusub.training import TrainingResult

SHOWS = ("tab:quantitative",)
VERTICES = 150, 300  # the paper's
COPIES = 3  # of each pose, where they are varied
PARTS = {"top": ("centaur",), "bottom": ("centaur", "david", "horse")}
CATEGORIES = ("cat", "centaur", "david", "dog", "gorilla", "horse", "michael", "victoria", "wolf")
METHODS = (*SCHEMES, "network")
# The paper's means' ratios, in the third digit rounded up: of two digits, they are not exact to it (0.8051, 0.7500)
PAPER = {"top": {"M": {"butterfly": 0.806, "loop": 0.274}, "H": {"butterfly": 0.866, "loop": 0.623}},
         "bottom": {"M": {"butterfly": 0.751, "loop": 0.261}, "H": {"butterfly": 0.886, "loop": 0.623}}}


def sources_of(part: str, options: argparse.Namespace) -> list[Path]:
    """The poses of one part's categories as files; with their copies, in any order, if they are to be `varied`."""
    meshes = options.runs / "table2" / (f"meshes-{options.seed}" if options.varied else "meshes")
    meshes.mkdir(parents=True, exist_ok=True)
    sources = []
    for category in PARTS[part]:
        for pose, mesh in tosca_poses(options.tosca, category).items():
            generator = np.random.default_rng([options.seed, CATEGORIES.index(category), pose])
            for copy in range(1 + COPIES * options.varied):
                shape = bent(stretched(mesh, generator), generator) if copy else mesh
                sources.append(meshes / f"{category}{pose}{f'-{copy}' if copy else ''}.ply")
                if not sources[-1].exists():
                    neusub.save(shape, sources[-1])
    if options.varied:  # the first ones have a pair more, and the few that are held out
        np.random.default_rng(options.seed).shuffle(sources)  # type: ignore[arg-type]
    return sources


def trained(part: str, options: argparse.Namespace) -> tuple[TrainingResult, dict, list[Path]]:
    """The paper's training on one part's categories, what its pairs look like, and the files of those held out."""
    quick, strategies = options.quick, ("random", "quadric") if options.varied else ("random",)
    training, validation = (20, 6) if quick else (200, 20)
    sizes = "" if options.vertices == VERTICES else "-{}-{}".format(*options.vertices)
    name = seeded(f"{part}{sizes}{'-varied' * options.varied}", options)
    folder = options.runs / "table2" / f"{name}{'-quick' * quick}"
    sources, reports = sources_of(part, options), []
    for strategy in strategies:
        config = PairConfig(total=training // len(strategies), validation=validation // len(strategies),
                            seed=options.seed, vertices=options.vertices, strategy=strategy)
        reports.append(make_pairs(sources, folder.with_name(f"{folder.name}-{strategy}"), config,
                                  strict=True, licence=TOSCA))
    train_files = [file for report in reports for file in report.train]
    validation_files = [file for report in reports for file in report.validation]
    files = [read_header(file)["report"] for file in train_files]
    settings = replace(PRESETS["paper"], seed=options.seed, threads=options.threads, epochs=options.epochs or 700,
                       weighting=options.weighting)
    if not options.bounded:
        settings = replace(settings, bound=None)
    if options.loss == "surface":
        settings = replace(settings, loss="surface", batch=2, schedule="cosine", epochs=options.epochs or 150,
                           cycles=options.cycles)
        folder = folder.with_name(f"{folder.name}-surface")
    if options.weighting != "vertices":
        folder = folder.with_name(f"{folder.name}-{options.weighting}")
    result = train(train_files, validation_files, Path(f"{folder}-run"), settings, resume=True, on_epoch=show)
    return result, {key: float(np.mean([file[key] for file in files])) for key in files[0]}, validation_files


def test_inputs(options: argparse.Namespace, category: str) -> Iterator[tuple[neusub.Mesh, dict[str, neusub.Mesh]]]:
    """Each pose of a category, and its coarse meshes of both kinds."""
    poses = tosca_poses(options.tosca, category)
    for pose in list(poses)[:1] if options.quick else poses:
        generator = np.random.default_rng([options.seed, CATEGORIES.index(category), pose])
        size = int(generator.integers(350, 451))
        result = neusub.decimate(poses[pose], n_vertices=size, strategy="quadric", seed=options.seed)
        yield poses[pose], {"on_surface": result.on_surface, "decimated": result.coarse}


def table(options: argparse.Namespace, categories: list[str], model: neusub.Subdivider) -> dict:
    """H and M of each kind and method: the categories' means over their shapes, and the mean of those."""
    rows: dict = {kind: {method: {} for method in METHODS} for kind in KINDS}
    for category in categories:
        scores: dict = {(kind, method): [] for kind in KINDS for method in METHODS}
        for reference, inputs in test_inputs(options, category):
            for kind, method in scores:
                scores[kind, method].append(score(by(method, model, inputs[kind]), reference))
        for (kind, method), values in scores.items():
            h, m = np.mean(values, axis=0)
            rows[kind][method][category] = {"H": float(h), "M": float(m), "shapes": len(values)}
        print(category, *(f"{method} {rows['on_surface'][method][category]['H']:.2f}/"
                          f"{rows['on_surface'][method][category]['M']:.3f}" for method in METHODS), flush=True)
    return {kind: {method: averaged(rows[kind][method]) for method in METHODS} for kind in KINDS}


def by(method: str, model: neusub.Subdivider, mesh: neusub.Mesh) -> neusub.Mesh:
    return refined(mesh, model if method == "network" else method)[-1]


def carriers(model: neusub.Subdivider, files: Sequence[Path]) -> dict:
    """Which vertices carry the squared validation loss of level 1: those of sharp edges, of thin triangles, the worst;
    each kind's share of the new vertices and of the loss, in percent.  For closed meshes."""
    kinds: dict[str, list[np.ndarray]] = {name: [] for name in ("edges over 60 degrees", "triangles under 0.3",
                                                                "worst 1 %")}
    errors = []
    for pair in (pair for file in files for pair in load_pairs(file)):
        mesh = neusub.Mesh(pair.positions("on_surface").astype(float), pair.faces)
        middle = slice(*pair.level_sizes[:2])  # the new vertices, one an edge
        result = model.subdivide(mesh, 1, scale="none")[-1].vertices[middle]
        errors.append(((result - pair.targets[middle]) ** 2).sum(axis=1))
        quality = triangle_quality(mesh.vertices, mesh.faces)[mesh.topology.edge_halfedges // 3].min(axis=1)
        kinds["edges over 60 degrees"].append(angles(mesh) > 60)
        kinds["triangles under 0.3"].append(quality < 0.3)
        kinds["worst 1 %"].append(errors[-1] > np.quantile(errors[-1], 0.99))
    loss = np.concatenate(errors)
    return {name: {"vertices": 100 * float(is_in.mean()), "loss": 100 * float(loss[is_in].sum() / loss.sum())}
            for name, is_in in ((name, np.concatenate(found)) for name, found in kinds.items())}


def averaged(categories: dict[str, dict]) -> dict:
    means = mean_of(categories)
    return {"H": means["H"], "M": means["M"], "categories": categories}


def fixed_table(options: argparse.Namespace, model: neusub.Subdivider) -> dict:
    """The same on the eight fixed inputs; H over five seeds of the sampling."""
    out: dict = {}
    for kind in KINDS:
        rows: dict = {method: {} for method in METHODS}
        for name, mesh in fixed_inputs(options.inputs, kind).items():
            reference = fixed_reference(options.tosca, name)
            for method in METHODS:
                h, m = score(by(method, model, mesh), reference, range(5))
                rows[method][name] = {"H": h, "M": m}
        out[kind] = {method: averaged(rows[method]) for method in METHODS}
    return out


def ratios(rows: dict) -> dict:
    """The network's share of each scheme's error."""
    return {key: {method: rows["network"][key] / rows[method][key] for method in METHODS[:-1]} for key in ("H", "M")}


def fewest_and_most(text: str) -> tuple[int, int]:
    fewest, most = map(int, text.split(":"))
    return fewest, most


def name_of(options: argparse.Namespace) -> str:
    """Of the part of the results: what is not the paper's."""
    name = options.part if options.loss == "squared" else f"{options.part}, {options.loss}"
    if options.vertices != VERTICES:
        name += ", {} to {} vertices".format(*options.vertices)
    name += ", varied" * options.varied + ", by area" * (options.weighting == "areas")
    return name + ", bounded" * options.bounded + ", seen" * options.seen


def main() -> None:
    parser = parser_of("experiments table2", __doc__, "20 pairs, 5 epochs, one pose a category", trains=True)
    parser.add_argument("tosca", type=Path)
    parser.add_argument("--inputs", type=Path, help="tosca8_coarse.npz, the eight fixed inputs")
    parser.add_argument("--part", choices=tuple(PARTS), default="top")
    parser.add_argument("--epochs", type=int, help="700, or 150 of --loss surface")
    parser.add_argument("--cycles", type=int, default=1, help="a run can go on for more of the same length")
    parser.add_argument("--loss", choices=("squared", "surface"), default="squared")
    parser.add_argument("--vertices", type=fewest_and_most, default=VERTICES, metavar="FEWEST:MOST",
                        help="of the training's coarse meshes; 150:300")
    parser.add_argument("--varied", action="store_true", help="stretched and bent copies, two strategies")
    parser.add_argument("--weighting", choices=("vertices", "areas"), default="vertices", help="of errors in the loss")
    parser.add_argument("--bounded", action="store_true", help="displacements as in use; the paper bounds none")
    parser.add_argument("--seen", action="store_true", help="score the categories of the training, not the others")
    options = parsed(parser)
    if options.quick:
        options.epochs = 5
    result, pairs, held_out = trained(options.part, options)
    rows = table(options, [name for name in CATEGORIES if (name in PARTS[options.part]) == options.seen], result.model)
    part = {**provenance(options), "training": training_scores(result), "bound": result.model.network.plan.bound,
            "pairs": pairs, "carriers_of_the_loss": carriers(result.model, held_out), **rows,
            "ratios": {kind: ratios(rows[kind]) for kind in KINDS}, "ratios_of_the_paper": PAPER[options.part]}
    if options.inputs:
        part["fixed_inputs"] = fixed_table(options, result.model)
    print(json.dumps({"ratios": part["ratios"], "paper": PAPER[options.part]}, indent=1))
    add_result("table2", [name_of(options)], part, options)


if __name__ == "__main__":
    main()
