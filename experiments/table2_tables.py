"""The tables of `table2.py` in docs/reproduction.md."""

from __future__ import annotations

from collections.abc import Callable

from experiments.cells import hm, label, markdown
from experiments.common import read_results
from experiments.measures import SCHEMES


def table2(part: str) -> str:
    data, kinds = read_results("table2"), {"on_surface": "on the surface", "decimated": "decimated"}
    free, bounded = data[part], data[f"{part}, bounded"]

    def row(name: str, of: Callable[[dict, str], dict], weight: str = "") -> list[str]:
        cells = [*(hm(of(free, m)) for m in SCHEMES), hm(of(free, "network")), hm(of(bounded, "network"))]
        return [f"{weight}{cell}{weight}" for cell in (name, *cells)]

    shapes = {name: row["shapes"] for name, row in free["on_surface"]["loop"]["categories"].items()}
    rows = [row(f"{name} ({count})", lambda part, m, name=name: part["on_surface"][m]["categories"][name])
            for name, count in shapes.items()]
    rows += [row(f"mean, {kinds[kind]}", lambda part, m, kind=kind: part[kind][m], "**" if kind == "on_surface" else "")
             for kind in kinds]
    rows.append(row("eight fixed inputs, on the surface", lambda part, m: part["fixed_inputs"]["on_surface"][m]))
    return markdown(["H / M", "midpoint", "Loop", "butterfly", "network", "network, bounded"], rows)


def table2_top() -> str:
    return table2("top")


def table2_bottom() -> str:
    return table2("bottom")


def trainings() -> str:
    """Trained otherwise: the network's shares, on-surface inputs."""
    data = read_results("table2")
    sizes = "surface, 350 to 450 vertices"
    names = {"": "the paper's: 150 to 300 vertices, squared loss, unbounded",
             "bounded": "the same weights, `--bounded`",
             "surface, bounded": "150 to 300 vertices, `--loss surface --bounded`, 150 epochs",
             "surface, 250 to 350 vertices, bounded": "250 to 350 vertices, `--loss surface --bounded`, 300 epochs",
             f"{sizes}, bounded": "350 to 450 vertices, `--loss surface --bounded`, 300 epochs",
             f"{sizes}, varied": "350 to 450 vertices, `--loss surface --varied --epochs 100`",
             f"{sizes}, varied, by area": "**the same, `--weighting areas`**",
             f"{sizes}, varied, by area, seed 1": "the same, `--seed 1`",
             f"{sizes}, varied, by area, seen": "`--seen`: on the training's own shapes"}

    def cells(part: str, name: str) -> list[str]:
        key = f"{part}, {name}" if name else part
        if key not in data:
            return ["", ""]
        h, m = (data[key]["ratios"]["on_surface"][measure] for measure in "HM")
        return [f"{m['butterfly']:.3f} / {m['loop']:.3f}", f"{h['butterfly']:.3f} / {h['loop']:.3f}"]

    rows = [[title, *cells("top", name), *cells("bottom", name)] for name, title in names.items()]
    paper = [f"{data[part]['ratios_of_the_paper'][measure]['butterfly']:.3f} / "
             f"{data[part]['ratios_of_the_paper'][measure]['loop']:.3f}" for part in ("top", "bottom")
             for measure in "MH"]
    return markdown(["training", "top: M, of butterfly's / Loop's", "H", "bottom: M", "H"],
                    [*rows, ["paper", *paper]])


def trainings_shapes() -> str:
    """The best of them, category by category."""
    known = read_results("table2")
    data = [known[f"{part}, surface, 350 to 450 vertices, varied, by area"] for part in ("top", "bottom")]
    methods = [(0, scheme) for scheme in SCHEMES] + [(0, "network"), (1, "network")]
    rows = []
    for category, entry in data[0]["on_surface"]["loop"]["categories"].items():
        found = [data[part]["on_surface"][method]["categories"].get(category) for part, method in methods]
        rows.append([f"{category} ({entry['shapes']})", *(hm(row) if row else "" for row in found)])
    for part, name in enumerate(("top", "bottom")):
        cells = [hm(data[part]["on_surface"][method]) if method != "network" or at == part else ""
                 for at, method in methods]
        rows.append([f"**{cell}**" if cell else "" for cell in (f"mean, {name}", *cells)])
    cells = [hm(data[part]["fixed_inputs"]["on_surface"][method]) for part, method in methods]
    rows.append(["eight fixed inputs, on the surface", *cells])
    return markdown(["on-surface inputs, H / M", *map(label, SCHEMES), "network, top", "network, bottom"], rows)


def shares(part: str) -> str:
    data = read_results("table2")
    free, bounded = (data[name]["ratios"]["on_surface"] for name in (part, f"{part}, bounded"))
    wanted = [(measure, scheme, data[part]["ratios_of_the_paper"][measure][scheme]) for measure in "MH"
              for scheme in ("butterfly", "loop")] + [("H", "midpoint", 1.0)]
    rows = []
    for measure, scheme, paper in wanted:
        here = [free[measure][scheme], bounded[measure][scheme]]
        reached = ", ".join("yes" if value <= paper else "no" for value in here)
        rows.append([f"{measure}, of {label(scheme)}'s", *(f"{value:.3f}" for value in here),
                     "at most 1 wanted" if scheme == "midpoint" else f"{paper:.3f}", reached])
    return markdown(["the network's share, on the surface", "here", "bounded", "paper", "reached"], rows)


def shares_top() -> str:
    return shares("top")


def shares_bottom() -> str:
    return shares("bottom")
