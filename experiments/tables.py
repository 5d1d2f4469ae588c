"""Tables of the documentation, written anew from the results that lie beside the experiments.

    python -m experiments tables

In README.md and docs/, what stands between the lines `<!-- table NAME -->` and `<!-- end -->` is the return value of
the function NAME here or in `table2_tables.py`.  After an experiment ran again, this puts its numbers where they are
read.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from experiments.cells import ALL, LABELS, hm, hmn, label, markdown
from experiments.common import HERE, read_results
from experiments.measures import KINDS, SCHEMES
from experiments.table2_tables import shares_bottom, shares_top, table2_bottom, table2_top, trainings, trainings_shapes

ROOT = HERE.parent
MARKED = re.compile(r"(<!-- table (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def fixed_inputs() -> str:
    data = read_results("fixed_inputs")
    names = {"butterfly": "modified butterfly", "default": "`default`, told the kind of input"}
    rows = [[names.get(method, LABELS.get(method, method if method in ALL else f"`{method}`")),
             *(hm(data[kind][method]) for kind in KINDS)] for method in data["on_surface"]]
    authors = read_results("authors")
    rows.insert(list(data["on_surface"]).index("butterfly") + 1,
                ["the authors' released weights", *(hm(authors[kind]) for kind in KINDS)])
    return markdown(["eight shapes of TOSCA, two levels, H / M", "coarse vertices on the surface", "decimated"], rows)


def teaser() -> str:
    data = read_results("gallery")["fig:teaser"]
    methods = tuple(data["on_surface"])
    rows = [["vertices on the surface", *(hm(data["on_surface"][m]) for m in methods)]]
    for shape in data["on_surface"]["loop"]["shapes"]:
        name = {"oded_bunny_hr": "bunny", "ns_rocker_arm": "rocker arm"}.get(shape, shape.split("_")[-1])
        rows.append([name, *(hm(data["on_surface"][m]["shapes"][shape]) for m in methods)])
    rows.append(["decimated vertices", *(hm(data["decimated"][m]) for m in methods)])
    return markdown(["H / M, mean of six", *map(label, methods)], rows)


def all_levels() -> str:
    data = read_results("gallery")["fig:allLevels"]
    names = {"ns_rocker_arm": "rocker arm", "oded_cat_low_resolution": "cat"}
    seen = {("oded_cat_low_resolution", "default"): " (it has seen this cat)"}
    rows = [[f"{names[shape]}, {label(method)}{seen.get((shape, method), '')}", *map(hm, levels.values())]
            for shape, methods in data.items() for method, levels in methods.items()]
    return markdown(["H / M", *next(iter(data["ns_rocker_arm"].values()))], rows)


def fit() -> str:
    data = read_results("selfparam_quality")["remesh"]

    def row(shape: str) -> list[str]:
        numbers = [data[kind][shape] for kind in data]
        numbers.insert(0, data["quadric"][shape]["reference"])
        name = shape.split("_", 1)[1].replace("_", " ")
        return [name, *(f"{100 * n['mean']:.3f} / {100 * n['hausdorff']:.2f}" for n in numbers)]

    def evenness(kind: str) -> str:
        rows = data[kind].values()
        return " / ".join(f"{np.mean([row[key] for row in rows]):.2f}" for key in ("quality_median", "area_variation"))

    rows = [row(shape) for shape in data["quadric"]]
    rows.append(["triangles, mean: quality / areas vary", "", *map(evenness, data)])
    names = (f"`{kind}`".replace(", fitted`", "`, fitted") for kind in data)
    return markdown(["mean / Hausdorff, %", "the authors' C++", *names], rows)


def artists() -> str:
    names = {"quat_cow": "cow", "quat_wolf": "wolf", "quat_pig": "pig", "kenney_cloud": "cloud",
             "oded_penguin_control_mesh": "penguin, cage", "oded_spot_control_mesh": "spot, cage",
             "oded_fish_control_mesh": "fish, cage", "ns_coarse_rockerArm": "rocker arm, the authors' coarse one"}
    rows = [[names[shape], str(data["coarse_folds"]),
             *(f"{data[m]['mean_angle']:.1f} / {data[m]['folds']} / {data[m]['volume_percent_of_coarse']:.0f}"
               for m in ALL[1:])] for shape, data in read_results("gallery")["fig:subdivScene"].items()]
    return markdown(["angle / folds / volume", "coarse folds", *map(label, ALL[1:])], rows)


def texture() -> str:
    data = read_results("gallery")["fig:texture"]
    rows = []
    for kind, name in (("decimated", "decimated"), ("cage", "the artist's cage")):
        rows += [[f"{name}, H / M", *(hm(data[kind][m]) for m in ALL)],
                 [f"{name}, colour", *(f"{data[kind][m]['color_difference_percent']:.2f}" for m in ALL)]]
    return markdown(["", *map(label, ALL)], rows)


def semantic() -> str:
    methods = ("coarse", "elephant", "default", "remesh")
    rows = [[f"{count} vertices", *(f"{data[m]['M']:.3f}" for m in methods)]
            for count, data in read_results("gallery")["fig:lim_semantic"].items()]
    return markdown(["M", *map(label, methods)], rows)


def modeling() -> str:
    changes = read_results("gallery")["fig:modeling"]
    rows = [[change, *(hm(data[m]) for m in ALL[1:])] for change, data in changes.items()]
    return markdown(["H / M", *map(label, ALL[1:])], rows)


LEVELS = {"elephant": "`elephant`", "elephant, then loop": "`elephant`, Loop after level 2", "default": "`default`",
          "default, then loop": "`default`, Loop after level 3", "loop": "Loop", "butterfly": "butterfly"}


def levels_distance() -> str:
    data = read_results("levels")["methods"]
    rows = [[name, *map(hm, data[m].values())] for m, name in LEVELS.items()]
    return markdown(["H / M, at level", "1", "2", "3", "4", "5"], rows)


def levels_angle() -> str:
    data = read_results("levels")["methods"]

    def shown(entry: dict) -> str:
        return f"{entry['mean_angle']:.1f} / {entry['angle_99']:.0f}, {entry['mean_angle_root_edges'] / 100:.0f}"

    rows = [[name, *(shown(data[m][f"level {k}"]) for k in range(2, 6))] for m, name in LEVELS.items()]
    return markdown(["angle, mean / 99 %, and rough, at level", "2", "3", "4", "5"], rows)


def upsampling() -> str:
    data = read_results("upsampling")["methods"]
    names = {"default": "`default`, two levels", "elephant": "`elephant`, two levels",
             "butterfly": "butterfly, two levels", "coarse vertices": "the coarse vertices",
             "coarse vertices, true normals": "the coarse vertices, the mesh's normals",
             "5000 uniform points": "5000 uniform points of the coarse mesh",
             "5000 farthest points": "5000 farthest points"}

    def short(value: float) -> str:
        return np.format_float_positional(float(f"{value:.2g}"), trim="-")

    rows = [[name, *(f"{data[m][key]:#.3g}" for key in "HM"),
             *(short(data[m][key]) for key in ("genus", "components", "seconds"))] for m, name in names.items()]
    return markdown(["from", "H", "M", "genus", "components", "seconds"], rows)


def cages() -> str:
    data = read_results("cages")["cages"].values()
    rows = [[label(m), *(text for kind in ("turned", "crossing") for counts in ([cage[m][kind] for cage in data],)
                         for text in (str(sum(counts)), str(sum(count > 0 for count in counts))))]
            for m in (*ALL[1:], "default, uncross")]
    return markdown(["", "turned triangles", "cages with any", "crossing pairs", "cages with any"], rows)


def ablation(setting: str = "16 pairs, 40 epochs") -> str:
    data = read_results("ablation")["summary"][f"cartoon_elephant.npz, {setting}"]
    names = {"paper": "the paper's network", "loss on the last level": "loss on the last level only",
             "from Loop": "displacements from Loop's positions", "2 vertex steps": "2 vertex steps",
             "MeshCNN features": "MeshCNN's features",
             "MeshCNN features, relative": "MeshCNN's features, displacements in edge lengths",
             "relative lengths": "the paper's inputs, lengths in edge lengths"}

    def digits(value: float) -> str:
        return f"{1e6 * value:.{4 if value < 1e-8 else 2 if value < 1e-5 else 1 if value < 1e-4 else 0}f}"

    rows = [[names.get(variant, variant), str(row["seeds"]), *map(digits, (*row["levels"], row["sum"])),
             digits(row["deviation"]) if row["seeds"] > 1 else "",
             f"{row['cpu_seconds']:.0f}" if row["cpu_seconds"] else ""]
            for variant, row in data.items()]
    return markdown(["variant", "seeds", "level 0", "level 1", "level 2", "sum", "spread of the sum",
                     "seconds of one core"], rows)


def ablation_full() -> str:
    return ablation("200 pairs, 200 epochs")


def ablation_long() -> str:
    return ablation("200 pairs, 700 epochs")


def runtime_loss() -> str:
    names = {"chamfer, KD-tree": "chamfer, KD-tree", "chamfer, all pairs": "chamfer, all pairs",
             "chamfer, all pairs, GPU": "the same, GPU"}

    def times(row: dict, name: str) -> str:
        return f"{float(f'{row[name]:.3g}'):,.0f}" if name in row else "too large"

    rows = [[f"{row['points']:,}", *(times(row, name) for name in names)]
            for row in read_results("runtime")["fig:runtime"]["times_the_known_targets"]]
    return markdown(["points", *names.values()], rows)


def runtime_decimation() -> str:
    rows = [[f"{row['vertices']:,}", f"{row['microseconds_a_collapse']:.1f}",
             f"{1e9 * row['seconds'] / (row['vertices'] * np.log2(row['vertices'])):.0f}",
             f"{row['seconds']:.2g}", f"{row['igl_qslim_seconds']:.2g}", f"{row['peak_megabytes']:.0f}"]
            for row in read_results("runtime")["sec:SSS"]["sizes"]]
    return markdown(["vertices", "µs a collapse", "ns / (N log2 N)", "seconds", "igl", "MB at the peak"], rows)


def styles() -> str:
    data = read_results("styles")
    names = {"spot": "trained on spot, smooth", "wingnut": "trained on a wingnut, sharp", "two": "trained on both",
             "four": "trained on both, a fish and a hammer", "organic": "trained on four organic shapes",
             "mechanical": "trained on four man-made shapes"}
    entries = {label(scheme): data["baselines"][scheme] for scheme in SCHEMES}
    entries |= {title: data["trainings"][name]["held_out"] for name, title in names.items()}
    entries |= {f"{title}, unbounded": data["trainings"][name]["held_out_unbounded"] for name, title in names.items()}
    rows = [[name, *(hmn(entry[group]) for group in ("organic", "man-made")),
             f"{entry['crease_kept_percent']['mean']:.0f}"] for name, entry in entries.items()]
    return markdown(["H / M / normals", "organic", "man-made", "creases, %"], rows)


def poses() -> str:
    data = read_results("styles")["trainings"]["pose"]["unseen_poses"]
    return markdown(["mean of five poses", *map(label, data)], [["H / M / normals", *map(hmn, data.values())]])


def level3() -> str:
    data, levels = read_results("level3")["scores"], ("level 2", "level 3", "level 4")
    names = {"2 levels": "trained on two levels", "3 levels": "trained on three", "butterfly": "butterfly"}
    rows = [[title, *(f"{hm(data[name][level])} / {data[name][level]['angle']:.1f}" for level in levels)]
            for name, title in names.items()]
    return markdown(["H / M / angle, at level", "2", "3", "4"], rows)


def learn_loop() -> str:
    data = read_results("learn_loop")["percent_of_the_diagonal"]
    keys = ("mean", "99 %", "worst", "mean of level 1", "midpoint", "butterfly")
    rows = [[name.split("_")[1], *(f"{row[key]:.3f}" for key in keys)] for name, row in data["shapes"].items()]
    rows.append([f"**{cell}**" for cell in ("mean", *(f"{data['mean'][key]:.3f}" for key in keys))])
    return markdown(["shape", "mean", "99 %", "worst", "mean at level 1", "midpoint's distance to Loop", "butterfly's"],
                    rows)


def translation() -> str:
    data = read_results("translation")["mean_error_percent_of_the_diagonal"]
    names = {"paper": "local frames (the paper's)", "world axes": "world axes",
             "world positions": "world axes, positions"}
    rows = [[title, *(f"{dict(map(tuple, data[name]['angle']))[angle]:.3f}" for angle in (0, 5, 20, 45, 90)),
             *(f"{dict(map(tuple, data[name]['shift']))[shift]:.3f}" for shift in (0.05, 0.2, 1))]
            for name, title in names.items()]
    return markdown(["network", "as trained", "turned by 5 degrees", "20", "45", "90",
                     "moved by 0.05 sides of the box", "0.2", "1"], rows)


def point2mesh() -> str:
    data = read_results("losses")["targets"]
    rows = [[name.split("_")[1], *(f"{100 - row[kind]['covered']:.2f}" for kind in ("closest points", "map")),
             *(f"{row[kind]['flipped']:.2f}" for kind in ("midpoints", "closest points", "map"))]
            for name, row in data.items() if isinstance(row, dict)]
    return markdown(["shape", "missed, %: closest points", "map", "flipped, %: midpoints", "closest points", "map"],
                    rows)


def losses() -> str:
    names = {"correspondences": "ours: targets by the map", "chamfer": "chamfer", "closest points": "closest points"}
    rows = [[names[name], f"{row['flipped']:.3g}", f"{row['folded']:.3g}", f"{row['covered']:.1f}", f"{row['H']:.2f}",
             f"{row['M']:.3f}", str(row["cpu_seconds"])] for name, row in read_results("losses")["results"].items()]
    return markdown(["loss", "flipped, %", "folded, %", "covered, %", "H", "M", "seconds of one core"], rows)


TABLES: dict[str, Callable[[], str]] = {function.__name__: function for function in (
    fixed_inputs, teaser, all_levels, fit, artists, texture, semantic, modeling, levels_distance, levels_angle,
    upsampling, cages, ablation, ablation_full, ablation_long, runtime_loss, runtime_decimation, styles, poses,
    level3, learn_loop, translation, point2mesh, losses, table2_top, table2_bottom, shares_top, shares_bottom,
    trainings, trainings_shapes)}


def renewed(text: str) -> str:
    """The page with its marked tables as the results are now.  Raises KeyError for an unknown table."""
    return MARKED.sub(lambda found: found[1] + TABLES[found[2]]() + found[3], text)


def pages() -> list[Path]:
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def main() -> None:
    argparse.ArgumentParser(prog="python -m experiments tables", description=__doc__,
                            formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    for page in pages():
        old = page.read_text()
        new = renewed(old)
        if new != old:
            page.write_text(new)
            print(f"{page.relative_to(ROOT)}: written")


if __name__ == "__main__":
    main()
