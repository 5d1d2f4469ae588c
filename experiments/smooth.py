"""The default weights, `smooth`: the elephant pairs beside pairs on closed-form surfaces, a cosine schedule.

    python experiments/smooth.py cartoon_elephant.npz --runs runs --ship

The elephants teach what an organic shape is, the others what is flat, straight and thin (`analytic.py`).  Writes
results/smooth.json and, with --ship, src/neusub/weights/smooth.safetensors.  An interrupted run goes on.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from analytic import analytic_pairs
from elephant import parser_of, ship, write_scores

from neusub.configuration import PRESETS
from neusub.generation import batch_pairs, import_pairs, load_pairs, save_pairs
from neusub.training import TrainingResult, train, validate

SPLITS = {"train": (120, 1), "validation": (10, 2)}  # closed-form pairs: how many, seed
DESCRIPTION = ("smooth shapes, organic and man-made, in even or thin triangles; trained on the cartoon elephant of the "
               "paper's authors' public pairs and on closed-form surfaces")


def pair_files(source: Path, folder: Path) -> dict[str, list[Path]]:
    """Files of each split: the elephants', then the closed-form surfaces'."""
    if not (folder / "validation.safetensors").exists():
        import_pairs(source, folder, licence="MPL-2.0")
    files = {}
    for split, (count, seed) in SPLITS.items():
        made = folder / f"analytic-{split}.safetensors"
        save_pairs(analytic_pairs(count, seed), made,
                   {"split": split, "source": "experiments/analytic.py", "licence": "MIT", "seed": seed})
        files[split] = [folder / f"{split}.safetensors", made]
    return files


def score(result: TrainingResult, files: list[Path]) -> dict[str, float]:
    """The validation loss of each kind, of the shipped model with its bound."""
    losses = {}
    for kind, path in zip(("elephants", "closed_form"), files):
        losses[kind] = validate(result.model.network, [batch_pairs([pair]) for pair in load_pairs(path)])
    return losses


def main() -> None:
    options = parser_of(__doc__).parse_args()
    files = pair_files(options.source, options.runs / "pairs")
    config = replace(PRESETS["fast"], seed=options.seed, threads=options.threads)
    result = train(files["train"], files["validation"], options.runs / f"smooth-{options.seed}", config, resume=True,
                   on_epoch=lambda row: print(row, flush=True))
    command = f"python experiments/smooth.py cartoon_elephant.npz --runs runs --seed {options.seed} --ship"
    write_scores("smooth", command, options, result,
                 {"validation_loss_with_the_bound": score(result, files["validation"])})
    if options.ship:
        ship("smooth", command, DESCRIPTION, result)


if __name__ == "__main__":
    main()
