"""The eight fixed TOSCA inputs: every scheme and every shipped model, on vertices on the surface and decimated ones.

    python -m experiments fixed_inputs TOSCA --inputs tosca8_coarse.npz

Two levels; H and M in TOSCA's units, H as the mean of five draws of the samples.  Networks get each kind of input as
such where their card names weights for it.  Writes results/fixed_inputs.json.
"""

from __future__ import annotations

from pathlib import Path

from experiments.common import TOSCA, fixed_inputs, fixed_reference, parsed, parser_of, provenance, write_results
from experiments.measures import KINDS, SCHEMES, mean_of, refined, score

SHOWS = ("tab:quantitative",)
SEEDS = range(5)
MODELS = ("elephant", "bunny", "organic", "mechanical", "default")


def main() -> None:
    parser = parser_of("experiments fixed_inputs", __doc__, "two shapes")
    parser.add_argument("tosca", type=Path)
    parser.add_argument("--inputs", type=Path, required=True)
    options = parsed(parser)
    table: dict = {}
    for kind in KINDS:
        meshes = dict(list(fixed_inputs(options.inputs, kind).items())[: 2 if options.quick else None])
        references = {name: fixed_reference(options.tosca, name) for name in meshes}
        for method in (*SCHEMES, *MODELS):
            shapes = {name: dict(zip("HM", score(refined(mesh, method, 2, kind)[-1], references[name], SEEDS)))
                      for name, mesh in meshes.items()}
            means = mean_of(shapes)
            table.setdefault(kind, {})[method] = {**means, "shapes": shapes}
            print(f"{kind:12s}{method:12s}H {means['H']:.3f}  M {means['M']:.4f}", flush=True)
    write_results("fixed_inputs", {"citation": TOSCA, **provenance(options), **table}, options)


if __name__ == "__main__":
    main()
