"""The default weights: sixteen shapes of free licence, stretched and bent copies of them, sharp solids, and closed-form
surfaces, for both kinds of input.  Two levels; three on the finest of the shapes and on closed forms.

    python -m experiments default MESHES --input on_surface --ship
    python -m experiments default MESHES --input decimated --ship

MESHES is the folder that the files of recipes/default.json are relative to; the recipe names where each comes from and
its licence.  A training of two cycles is followed by a short one for smoothness: the normals of the faces count, and
closed surfaces over even grids are among the pairs.  --start MODEL takes a model in place of the first.  Writes
results/default-INPUT.json (with --start, smooth-INPUT.json) and, with --ship, the weights.  An interrupted run goes on.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import neusub
from experiments.analytic import analytic_pairs, even_pairs
from experiments.common import HERE, parsed, parser_of, provenance, ship, show, training_scores, write_results
from experiments.sources import bent, solid, stretched
from neusub import PRESETS, PairConfig, make_pairs, train
from neusub.generation import save_pairs

NAMES = {"on_surface": "default", "decimated": "default-decimated"}
DESCRIPTIONS = {
    "on_surface": "any mesh whose vertices lie on the shape: artists' models, scans; organic and man-made",
    "decimated": "meshes that an error-minimising decimation made, whose vertices lie off the surface",
}
SMOOTHING = {"epochs": 8, "cycles": 1, "learning_rate": 7e-4, "normals": 0.05}  # of the second training
LICENCE = "CC BY 3.0, CC BY 4.0 or CC0: see the recipe"


def sources_of(recipe: dict, meshes: Path, folder: Path) -> dict[str, list[Path]]:
    """The fine meshes as files: the recipe's with their altered copies, and the solids."""
    folder.mkdir(parents=True, exist_ok=True)
    files: dict[str, list[Path]] = {"shapes": [], "solids": [], "deep": []}
    for number, source in enumerate(recipe["sources"]):
        original = meshes / source["file"]
        kinds = ["shapes", "deep"] if source.get("deep") else ["shapes"]
        copies = [original]
        generator = np.random.default_rng([recipe["seed"], number])
        for copy in range(1, recipe["copies"]):
            path = folder / f"{original.stem}-{copy}.ply"
            mesh = stretched(neusub.load(original), generator)
            if source["file"].startswith("organic"):
                mesh = bent(mesh, generator)
            copies.append(written(mesh, path))
        for kind in kinds:
            files[kind] += copies
    for number in range(recipe["solids"]):
        files["solids"].append(written(solid(number, recipe["seed"]), folder / f"solid-{number}.ply"))
    return files


def written(mesh: neusub.Mesh, path: Path) -> Path:
    if not path.exists():
        neusub.save(mesh, path)
    return path


def pair_files(recipe: dict, meshes: Path, folder: Path) -> tuple[list[Path], list[Path]]:
    """Training and validation files: of every source by every strategy."""
    training, validation = [], []
    for kind, sources in sources_of(recipe, meshes, folder / "sources").items():
        plan = recipe["pairs"][kind]
        for strategy in recipe["strategies"]:
            config = PairConfig(plan["per_mesh"], validation=plan["validation"], vertices=tuple(plan["vertices"]),
                                levels=plan["levels"], strategy=strategy, seed=recipe["seed"])
            report = make_pairs(sources, folder / f"{kind}-{strategy}", config,
                                licence="MIT" if kind == "solids" else LICENCE)
            print(f"{kind}, {strategy}: {len(report.train)} files; failed: {report.failed}", flush=True)
            training += report.train
            validation += report.validation
    return training, validation


def closed_form_files(plans: list[dict], folder: Path, kind: str, pairs_of: Callable) -> list[Path]:
    """Pairs of surfaces of closed form; their coarse vertices lie on them, so they are for that kind of input only."""
    files = []
    for number, wanted in enumerate(plans):
        files.append(folder / f"{kind}-{number}-train.safetensors")
        save_pairs(pairs_of(wanted["pairs"], wanted["seed"], wanted["levels"]), files[-1],
                   {"split": "train", "source": "experiments/analytic.py", "licence": "MIT", "seed": wanted["seed"]})
    return files


def card_of(card: dict, recipe: dict, kind: str) -> dict:
    """A run's card with where its pairs come from: 16 sources instead of some 300 pair files."""
    made = [{"file": f"experiments/{file}", "licence": "MIT"} for file in ("sources.py", "analytic.py")]
    sources = [*recipe["sources"], *(made if kind == "on_surface" else made[:1])]
    return {**card, "training": without_files(card["training"]), "sources": sources,
            "companions": {other: name for other, name in NAMES.items() if other != kind}}


def without_files(training: dict) -> dict:
    """A card's training, and those before it, with the number of pairs in place of their files."""
    short = {key: value for key, value in training.items() if key != "data"}
    if "data" in training:
        short["pairs"] = sum(entry["count"] for entry in training["data"] if entry.get("split") == "train")
    if "start" in training:
        start = {key: value for key, value in training["start"].items() if key != "sources"}  # the same
        short["start"] = {**start, "training": without_files(start["training"])}
    return short


def main() -> None:
    parser = parser_of("experiments default", __doc__, "two shapes, an epoch each; not shipped", trains=True)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--input", choices=tuple(NAMES), default="on_surface")
    parser.add_argument("--epochs", type=int, default=PRESETS["default"].epochs)
    parser.add_argument("--cycles", type=int, default=PRESETS["default"].cycles, help="of the learning rate")
    parser.add_argument("--start", help="a model in place of that of the first training: its name or file")
    parser.add_argument("--ship", action="store_true", help="make the best weights a model of the package")
    options = parsed(parser)
    recipe = json.loads((HERE / "recipes" / "default.json").read_text())
    pairs = options.runs / f"default-pairs{'-quick' * options.quick}"
    smoothing = SMOOTHING
    if options.quick:
        recipe |= {"sources": sorted(recipe["sources"], key=lambda source: "deep" in source)[-2:], "copies": 1,
                   "solids": 1, **{key: recipe[key][:1] for key in ("closed_form", "even_grids")}}
        options.epochs, options.cycles, options.ship = 1, 1, False
        smoothing = SMOOTHING | {"epochs": 1}
    training, validation = pair_files(recipe, options.meshes, pairs)
    even = []
    if options.input == "on_surface":
        training += closed_form_files(recipe["closed_form"], pairs, "analytic", analytic_pairs)
        even = closed_form_files(recipe["even_grids"], pairs, "even", even_pairs)
    config = replace(PRESETS[NAMES[options.input]], epochs=options.epochs, cycles=options.cycles,
                     seed=options.seed, threads=options.threads)
    folder = options.runs / f"default-{options.input}-{options.seed}{'-quick' * options.quick}"
    start = neusub.Subdivider.load(options.start, device="cpu") if options.start else train(
        training, validation, folder, config, resume=True, on_epoch=show).model
    result = train([*training, *even], validation, folder.with_name(f"{folder.name}-smooth"),
                   replace(config, **smoothing), start=start, resume=True, on_epoch=show)
    origin = provenance(options)
    name = f"{'smooth' if options.start else 'default'}-{options.input}"
    write_results(name, {**origin, **training_scores(result), "start": start.card["scores"]}, options)
    if options.ship:
        result.model.card = card_of(result.model.card, recipe, options.input)
        ship(NAMES[options.input], origin["command"], DESCRIPTIONS[options.input], result)


if __name__ == "__main__":
    main()
