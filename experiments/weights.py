"""The paper's network as weights to ship: one shape, several smooth ones, several sharp ones.

    python -m experiments weights MESHES organic --ship

The paper's network and loss, 200 discretizations of 150 to 300 vertices in total, two levels; but 250 epochs with a
cosine schedule and two meshes a step, for time.  MESHES is the folder that the recipe's files are relative to.  An
interrupted run goes on.  Writes results/weights-NAME.json and, with --ship, the weights.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import neusub
from experiments.common import HERE, parsed, parser_of, provenance, seeded, ship, show, training_scores, write_results
from experiments.sources import solid
from neusub import PRESETS, PairConfig

SOLIDS = 8
MODELS = {  # description, and the sources: names in recipes/default.json, or a file with its terms
    "bunny": ("one shape, as in the paper's teaser; research, non-commercial: a Stanford scan",
              [{"file": "organic/oded_bunny_hr.ply", "repository": "odedstein/meshes",
                "path": "objects/bunny/bunny_hr.obj", "author": "Stanford University Computer Graphics Laboratory",
                "url": "https://graphics.stanford.edu/data/3Dscanrep/",
                "licence": "Stanford terms: research, non-commercial"}]),
    "organic": ("smooth organic shapes; the paper's network, trained on eight of them",
                ["cat", "fish", "hand", "human_man", "koala", "penguin", "spot", "blub"]),
    "mechanical": ("man-made shapes with sharp edges; the paper's network, trained on twelve of them",
                   ["boat", "hammer", "wingnut", "plane", "solids"]),
}


def sources_of(name: str, meshes: Path, folder: Path) -> tuple[list[Path], list[dict]]:
    """Files of a model's sources, and what its card says of them."""
    recipe = json.loads((HERE / "recipes" / "default.json").read_text())["sources"]
    files, entries = [], []
    for word in MODELS[name][1]:
        if word == "solids":
            for number in range(SOLIDS):
                files.append(folder / f"solid-{number}.ply")
                neusub.save(solid(number), files[-1], overwrite=True)
            entries.append({"file": "experiments/sources.py", "licence": "MIT"})
            continue
        entry = word if isinstance(word, dict) else next(e for e in recipe if f"_{word}" in e["file"])
        files.append(meshes / entry["file"])
        entries.append(entry)
    return files, entries


def main() -> None:
    parser = parser_of("experiments weights", __doc__, "16 pairs, two epochs; not shipped", trains=True)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("name", choices=tuple(MODELS))
    parser.add_argument("--ship", action="store_true", help="make the best weights a model of the package")
    options = parsed(parser)
    folder = options.runs / "weights" / seeded(f"{options.name}{'-quick' * options.quick}", options)
    total, validation, epochs = (16, 2, 2) if options.quick else (200, 24, 250)
    (folder / "sources").mkdir(parents=True, exist_ok=True)
    files, entries = sources_of(options.name, options.meshes, folder / "sources")
    licence = "; ".join(sorted({entry["licence"] for entry in entries}))
    plan = PairConfig(total=total, validation=validation, seed=options.seed)
    report = neusub.make_pairs(files, folder / "pairs", plan, workers=options.threads, strict=True, licence=licence)
    config = replace(PRESETS["paper"], batch=2, schedule="cosine", epochs=epochs, seed=options.seed,
                     threads=options.threads)
    result = neusub.train(report.train, report.validation, folder / "run", config, resume=True, on_epoch=show)
    origin = provenance(options)
    write_results(f"weights-{options.name}", {**origin, **training_scores(result)}, options)
    if options.ship and not options.quick:
        result.model.card["sources"] = entries
        ship(options.name, origin["command"], MODELS[options.name][0], result)


if __name__ == "__main__":
    main()
