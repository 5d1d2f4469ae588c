"""Styles: the paper's network trained on one shape or a few, smooth or sharp, and used on others.

    python -m experiments styles MESHES
    python -m experiments styles MESHES --tosca TOSCA --only pose
    python -m experiments styles MESHES --epochs 200 --only spot wingnut

MESHES is the folder of INDEX.csv, TOSCA that of <category>.npz.  A training takes --pairs discretizations of 150 to 300
vertices in all, evenly from its shapes, and --epochs epochs of one mesh a step; the learning rate goes down as a cosine
(the paper's is constant, with 200 and 700).  It is scored on shapes that no training has seen, decimated to 350
vertices on the surface, after two levels, with displacements bounded as in use and unbounded as in the paper.  Each
training adds its row to results/styles.json, with its own size and commit; the classical schemes are scored in a call
without --only.  Pictures are of the trainings of the call's size that are there.  An interrupted call goes on where it
was.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy import ndarray

import neusub
from experiments.common import (
    TOSCA,
    add_result,
    draws,
    parsed,
    parser_of,
    provenance,
    read_results,
    seeded,
    tosca_poses,
    training_scores,
)
from experiments.measures import SCHEMES, angles, mean_of, percents
from experiments.measures import refined as levels_of
from experiments.sources import solid
from neusub import PRESETS, PairConfig
from neusub.network import NeuralSubdivision

SHOWS = ("fig:singleShape", "fig:poses", "fig:dataDriven", "fig:lim_sharp", "fig:mechE_vs_smooth", "fig:moreShapes")
SPOT, FISH, HAND = "organic/oded_spot.ply", "organic/oded_fish.ply", "organic/oded_hand_closed.ply"
BLUB, WINGNUT = "textured/cino_blub_triangulated.ply", "manmade/oded_wingnut.ply"
HAMMER, BOAT, SWORD = "manmade/oded_hammer.ply", "manmade/oded_boat.ply", "manmade/oded_sword.ply"
TRAININGS = {
    "spot": (SPOT,),
    "wingnut": (WINGNUT,),
    "two": (SPOT, WINGNUT),
    "four": (SPOT, WINGNUT, FISH, HAMMER),
    "organic": (SPOT, FISH, HAND, BLUB),
    "mechanical": (WINGNUT, HAMMER, BOAT, SWORD),
    "pose": ("centaur0",),
}
HELD_OUT = {
    "organic": ("organic/oded_cat_low_resolution.ply", "organic/oded_human_man.ply", "organic/oded_penguin_hr.ply",
                "organic/oded_skull_low_resolution.ply"),
    "man-made": ("manmade/common_fandisk.ply", "manmade/mlab_casting.ply", "manmade/ns_rocker_arm.ply",
                 "manmade/oded_plane.ply"),
}
COARSE, LEVELS, VALIDATION = 350, 2, 5
CREASE = 50  # degrees between two faces of the coarse mesh, above which their edge counts as sharp


# --- training ----------------------------------------------------------------------------------------------------


def files_of(name: str, options: Namespace) -> list[Path]:
    """The training shapes as files; a pose of TOSCA is written first."""
    if name != "pose":
        return [options.meshes / shape for shape in TRAININGS[name]]
    file = options.runs / "styles" / "meshes" / "centaur0.ply"
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        neusub.save(tosca_poses(options.tosca, "centaur")[0], file)
    return [file]


def folder_of(name: str, options: Namespace) -> Path:
    return options.runs / "styles" / seeded(f"{name}-{options.pairs}", options) / f"{options.epochs}-epochs"


def trained(name: str, options: Namespace) -> tuple[neusub.Subdivider, dict]:
    """A network of the paper's kind, and how its training went."""
    licence = TOSCA if name == "pose" else "CC BY 3.0, CC BY 4.0 or CC0"
    plan = PairConfig(total=options.pairs, validation=VALIDATION, seed=options.seed)
    folder = folder_of(name, options)
    pairs = neusub.make_pairs(files_of(name, options), folder.parent / "pairs", plan, workers=options.threads,
                              strict=True, licence=licence)
    config = replace(PRESETS["paper"], schedule="cosine", epochs=options.epochs, seed=options.seed,
                     threads=options.threads)
    result = neusub.train(pairs.train, pairs.validation, folder, config, resume=True)
    shapes = [Path(shape).stem for shape in TRAININGS[name]]
    return result.model, {"shapes": shapes, "pairs": options.pairs, **training_scores(result)}


def unbounded(model: neusub.Subdivider) -> neusub.Subdivider:
    """The same weights with displacements as the paper has them."""
    network = NeuralSubdivision(replace(model.network.plan, bound=None))
    network.load_state_dict(model.network.state_dict())
    return neusub.Subdivider(network.eval(), model.card)


# --- scores ------------------------------------------------------------------------------------------------------


@cache
def held_out(folder: Path, name: str) -> tuple[neusub.Mesh, neusub.Mesh]:
    """A fine mesh and its coarse version, whose vertices lie on it."""
    fine = neusub.load(folder / name)
    return fine, neusub.decimate(fine, n_vertices=COARSE, strategy="quadric").on_surface


@cache
def sharp_coarse() -> dict[str, neusub.Mesh]:
    """Coarse meshes with sharp edges: a cube of 192 faces, and decimated solids of `sources.py`."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    cube = neusub.Mesh(corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))
    meshes = {"cube": neusub.subdivide(cube, "midpoint", 2)[-1]}
    for number in (2, 3, 5):
        meshes[f"solid {number}"] = neusub.decimate(solid(number), n_vertices=150, strategy="quadric").on_surface
    return meshes


def refined(mesh: neusub.Mesh, method: str | neusub.Subdivider) -> neusub.Mesh:
    return levels_of(mesh, method, LEVELS)[-1]


def crease_kept(coarse: neusub.Mesh, fine: neusub.Mesh) -> float:
    """Percent of the angle at the coarse mesh's sharp edges that is left at the edges they became.

    Midpoint subdivision keeps 100; a scheme that rounds an edge spreads its angle over the faces beside it.
    """
    edges = coarse.topology.edges[angles(coarse) > CREASE]
    before = angles(coarse)[angles(coarse) > CREASE].mean()
    mesh = coarse
    for _ in range(LEVELS):
        at = len(mesh.vertices) + edge_numbers(mesh, edges)
        edges = np.concatenate([np.stack([edges[:, 0], at], axis=1), np.stack([edges[:, 1], at], axis=1)])
        mesh = neusub.subdivide(mesh, "midpoint", 1)[-1]
    return float(100 * angles(fine)[edge_numbers(fine, edges)].mean() / before)


def edge_numbers(mesh: neusub.Mesh, pairs: ndarray) -> ndarray:
    """Which of the mesh's edges, sorted as `topology.py` says, each pair of vertices is."""
    size = len(mesh.vertices)
    keys = mesh.topology.edges @ [size, 1]
    return np.searchsorted(keys, np.sort(pairs, axis=1) @ [size, 1])


def scores(method: str | neusub.Subdivider, options: Namespace) -> dict:
    """Of each group of held-out shapes, with its mean; and what is left of sharp edges."""
    rows: dict = {}
    for group, names in HELD_OUT.items():
        shapes = {}
        for name in names[:1] if options.quick else names:
            fine, coarse = held_out(options.meshes, name)
            shapes[Path(name).stem] = percents(refined(coarse, method), fine)
        rows[group] = {**mean_of(shapes), "shapes": shapes}
    kept = {name: crease_kept(mesh, refined(mesh, method)) for name, mesh in sharp_coarse().items()}
    return {**rows, "crease_kept_percent": {"mean": float(np.mean(list(kept.values()))), **kept}}


def unseen_poses(options: Namespace) -> Iterator[tuple[str, neusub.Mesh, neusub.Mesh]]:
    """Poses of the centaur but the first, as `held_out`."""
    for pose, fine in list(tosca_poses(options.tosca, "centaur").items())[1 : 2 if options.quick else None]:
        yield f"centaur{pose}", fine, neusub.decimate(fine, n_vertices=400, strategy="quadric").on_surface


def pose_scores(methods: dict, options: Namespace) -> dict:
    """fig:poses: each method on each unseen pose."""
    rows: dict = {name: {} for name in methods}
    for pose, fine, coarse in unseen_poses(options):
        for name, method in methods.items():
            rows[name][pose] = percents(refined(coarse, method), fine)
    return {name: {**mean_of(poses), "poses": poses} for name, poses in rows.items()}


# --- the whole ---------------------------------------------------------------------------------------------------


def earlier_models(rows: dict, options: Namespace) -> dict[str, neusub.Subdivider]:
    """Those of finished trainings of the same size."""
    size = options.pairs, options.epochs
    files = {name: folder_of(name, options) / "model.safetensors" for name, row in rows.items()
             if (row["pairs"], row["epochs"]) == size}
    return {name: neusub.Subdivider.load(file) for name, file in files.items() if file.exists()}


def main() -> None:
    parser = parser_of("experiments styles", __doc__, "8 pairs, 5 epochs, fewer shapes", trains=True)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--tosca", type=Path, help="for the training `pose`")
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--epochs", type=int, default=700)
    parser.add_argument("--only", nargs="+", choices=tuple(TRAININGS), help="trainings; all by default")
    options = parsed(parser)
    if options.quick:
        options.pairs, options.epochs = 8, 5
    names = options.only or [name for name in TRAININGS if name != "pose" or options.tosca]
    models = {}
    if not options.quick and not options.only:
        schemes = {**provenance(options), **{scheme: scores(scheme, options) for scheme in SCHEMES}}
        add_result("styles", ["baselines"], schemes, options)
    for name in names:
        models[name], how = trained(name, options)
        row = {**provenance(options), **how, "held_out": scores(models[name], options),
               "held_out_unbounded": scores(unbounded(models[name]), options)}
        if name == "pose":
            row["unseen_poses"] = pose_scores({**{scheme: scheme for scheme in SCHEMES}, "network": models[name]},
                                              options)
        show(name, row)
        add_result("styles", ["trainings", name], row, options)
    if draws(options):
        from experiments.styles_pictures import draw

        draw(models | earlier_models(read_results("styles")["trainings"], options), options)


def show(name: str, row: dict) -> None:
    held = row["held_out"]
    print(f"{name:12s}best {row['best_validation_loss']:.3e}, {row['seconds']} s;",
          *(f"{group} H {held[group]['H']:.2f} M {held[group]['M']:.4f} normals {held[group]['normals']:.1f};"
            for group in HELD_OUT), f"creases {held['crease_kept_percent']['mean']:.0f} %", flush=True)


if __name__ == "__main__":
    main()
