"""Successive self-parameterization: the paper's figures about it, as numbers and as pictures.

    python -m experiments parameterization MESHES [--quick]

MESHES is the folder that holds INDEX.csv.  Writes results/parameterization.json, and the pictures of
`parameterization_pictures.py` to docs/reproduction.  --quick takes fewer and smaller meshes, and writes nothing.
Distortion is the quasi-conformal error (`neusub.selfparam.report`) of the triangles of the second refinement.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy import ndarray

import neusub
from experiments.common import parsed, parser_of, provenance, write_results
from experiments.measures import remeshed, round_trip
from neusub import Criteria, Mesh, SelfParameterization, decimate
from neusub.selfparam.maps import decimate_maps
from neusub.selfparam.parameterization import refinement

SHOWS = ("fig:withWithoutConformal", "fig:controlEC", "fig:uniformRemesh", "fig:robustSSS", "fig:manyShapes",
         "fig:trainData")
FACES, LEVELS = 500, 2
SPOT, BLUB = "organic/oded_spot.ply", "textured/cino_blub_triangulated.ply"
KOALA, PENGUIN, HAMMER = "organic/oded_koala.ply", "organic/oded_penguin_hr.ply", "manmade/oded_hammer.ply"
TEXTURED = "originals/spot_triangulated.obj"  # 2930 vertices; also the one of which a half is refined
STRATEGIES = ("quadric", "uniform", "random", "edge-length", "appearance")
CRITERIA = {
    "all": Criteria(),
    "no min_normal_dot": Criteria(min_normal_dot=None),
    "no min_quality": Criteria(min_quality=None),
    "no plane_flips": Criteria(plane_flips=False),
    "no tiny": Criteria(tiny=None),
    "none": Criteria(min_normal_dot=None, min_quality=None, plane_flips=False, tiny=None),
}


# --- what is measured --------------------------------------------------------------------------------------------


def areas(vertices: ndarray, faces: ndarray) -> ndarray:
    corners = vertices[faces]
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2


def variation(values: ndarray) -> float:
    """Coefficient of variation: standard deviation over mean."""
    return float(values.std() / values.mean())


def distortion(result: SelfParameterization) -> dict:
    report = result.report(LEVELS)
    return {"median": report.conformal_median, "99 %": report.conformal_high, "worst": report.conformal_worst,
            "flipped_percent": 100 * report.flipped}


def evenness(result: SelfParameterization, levels: int = 4) -> dict:
    """How the areas vary: of the remesh's triangles, and of what each coarse face covers on the fine surface."""
    level2, fine = remeshed(result), remeshed(result, levels)
    owner = refinement(result.faces, len(result.decimated), levels).owner
    return {"triangles": variation(areas(level2.vertices, level2.faces)),
            "covered": variation(np.bincount(owner, areas(fine.vertices, fine.faces)))}


def lost(result: SelfParameterization, points: int = 20_000) -> float:
    """Share of random coarse points that do not come back from the fine mesh, by more than 1e-6 of the diagonal."""
    return float((round_trip(result, points) > 1e-6).mean())


# --- one function for each figure --------------------------------------------------------------------------------


def conformal(folder: Path) -> dict:
    """fig:withWithoutConformal: the same collapses' rings flattened conformally, and by Tutte's uniform weights."""
    rows: dict = {}
    for name in (BLUB, KOALA, PENGUIN, HAMMER):
        mesh = neusub.load(folder / name)
        rows[Path(name).stem] = {"conformal": distortion(decimate(mesh, n_faces=FACES)),
                                 "uniform": distortion(decimate(mesh, n_faces=FACES, flattening="uniform"))}
    return rows


def strategies(folder: Path) -> dict:
    """fig:controlEC: how even each strategy's parameterization is, and what becomes of a texture."""
    mesh = neusub.load(folder / TEXTURED)
    rows: dict = {}
    for strategy in STRATEGIES:
        result = decimate(mesh, n_faces=FACES, strategy=strategy)
        rows[strategy] = {**evenness(result), **distortion(result), **texture(result),
                          "mean_distance_percent": percent(remeshed(result, 0), mesh)}
    return rows


def percent(mesh: Mesh, reference: Mesh) -> float:
    """Mean distance of two surfaces, of the reference's diagonal."""
    found = neusub.distance(mesh, reference)
    return 100 * found.mean / found.diagonal


def texture(result: SelfParameterization, levels: int = 4) -> dict:
    """Shares of the area: where a coarse face's linear UVs are off by over 0.01 of the texture's side, as they are all
    over a face that lies across a seam; and what the triangles of the refinement that a seam crosses cover."""
    uv, uv_faces = result.fine.uv, result.fine.uv_faces
    assert uv is not None and uv_faces is not None  # the file has them
    coarse, coarse_faces, _ = result.transfer_corners(uv, uv_faces, 0)
    fine, fine_faces, crosses = result.transfer_corners(uv, uv_faces, levels)
    refined, remesh = refinement(result.faces, len(result.decimated), levels), remeshed(result, levels)
    error = np.einsum("nik,nkx->nix", refined.corners, coarse[coarse_faces[refined.owner]]) - fine[fine_faces]
    is_off = np.linalg.norm(error, axis=2).mean(axis=1) > 0.01
    share = areas(remesh.vertices, remesh.faces) / areas(remesh.vertices, remesh.faces).sum()
    return {"uv_off_percent": 100 * float(share[is_off].sum()), "seam_percent": 100 * float(share[crosses].sum())}


def uneven(mesh: Mesh, times: int) -> Mesh:
    """Refine the half z > 0 so often: edges with both ends there are split, so its border faces are cut in two."""
    vertices, faces = mesh.vertices - np.median(mesh.vertices, axis=0), mesh.faces
    for _ in range(times):
        edges, number = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)), axis=0,
                                  return_inverse=True)
        split = (vertices[edges, 2] > 0).all(axis=1)
        middle = np.where(split, len(vertices) + np.cumsum(split) - 1, -1)[number.reshape(-1, 3)]
        vertices = np.concatenate([vertices, vertices[edges[split]].mean(axis=1)])
        count = (middle >= 0).sum(axis=1)  # of a face's edges 3, 1 or 0 are split, as 3, 2 or fewer corners are there
        (a, b, c), (ab, bc, ca) = faces[count == 3].T, middle[count == 3].T
        four = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
        turn = (middle[count == 1].argmax(axis=1)[:, None] + np.arange(3)) % 3  # the split edge becomes the first
        a, b, c = np.take_along_axis(faces[count == 1], turn, axis=1).T
        m = middle[count == 1].max(axis=1)
        two = np.concatenate([np.stack([a, m, c], axis=1), np.stack([m, b, c], axis=1)])
        faces = np.concatenate([faces[count == 0], four, two])
    return Mesh(vertices, faces)


def against_maps(folder: Path, times: int) -> dict:
    """fig:uniformRemesh: down to the same number of vertices from a very uneven triangulation."""
    mesh = uneven(neusub.load(folder / TEXTURED), times)
    rows: dict = {"vertices": len(mesh.vertices), "input_triangles_vary": variation(areas(mesh.vertices, mesh.faces))}
    for strategy in ("quadric", "uniform", "MAPS"):
        result = down(mesh, strategy)
        rows[strategy] = {"reached": result.reached, **evenness(result), **distortion(result),
                          "remesh_mean_distance_percent": percent(remeshed(result), mesh)}
    return rows


def down(mesh: Mesh, strategy: str) -> SelfParameterization:
    """To as many vertices as a closed mesh of FACES faces has, without handles."""
    size = FACES // 2 + 2
    if strategy == "MAPS":
        return decimate_maps(mesh, n_vertices=size)
    return decimate(mesh, n_vertices=size, strategy=strategy)


def shapes(folder: Path, most: int) -> list[Path]:
    """Manifold oriented meshes of 2000 to `most` vertices."""
    with (folder / "INDEX.csv").open() as file:
        return [folder / row["file"] for row in csv.DictReader(file)
                if row["manifold"] == "True" and float(row["orient_bad"]) == 0 and 2000 <= int(row["nV"]) <= most]


def criteria(files: list[Path]) -> dict:
    """fig:robustSSS: each criterion off in turn, on all shapes."""
    rows: dict = {name: [] for name in CRITERIA}
    for file in files:
        mesh = neusub.load(file)
        for name, chosen in CRITERIA.items():
            result = decimate(mesh, n_faces=FACES, criteria=chosen)
            report = result.report(LEVELS)
            rows[name].append((result.reached, 100 * report.flipped, report.conformal_median, report.conformal_high,
                               100 * lost(result), sum(report.refusals.values()) / report.collapses,
                               report.conformal_worst))
        print(file.stem, *(f"{rows[name][-1][1]:.2f}" for name in CRITERIA), flush=True)
    short = [file.stem for file, row in zip(files, rows["all"]) if not row[0]]
    return {"shapes": len(files), "too_large_with_all": short,
            **{name: summarised(np.array(row)) for name, row in rows.items()}}


def summarised(rows: ndarray) -> dict:
    reached, flipped, median, high, gone, refused, worst = rows.T
    return {"reached": int(reached.sum()),
            "flipped_percent": {"mean": flipped.mean(), "worst": flipped.max()},
            "distortion": {"median, median shape": np.median(median), "99 %, median shape": np.median(high),
                           "99 %, worst shape": high.max()},
            "shapes_with_triangles_without_area": int(np.isinf(worst).sum()),
            "points_lost_percent": {"mean": gone.mean(), "worst": gone.max(), "shapes": int((gone > 0).sum())},
            "refusals_for_each_collapse": refused.mean()}


def drawn(folder: Path, count: int) -> list[SelfParameterization]:
    """fig:manyShapes: random collapses to random sizes."""
    mesh, sizes = neusub.load(folder / SPOT), np.random.default_rng(0).integers(150, 501, count)
    return [decimate(mesh, n_vertices=int(n), strategy="random", seed=k) for k, n in enumerate(sizes)]


def discretizations(folder: Path, count: int) -> dict:
    """fig:manyShapes and fig:trainData: what the draws have in common, and how near the levels come to the surface."""
    results = drawn(folder, count)
    reports = [result.report(LEVELS) for result in results]
    levels = np.array([[percent(remeshed(r, level), r.fine) for level in range(LEVELS + 1)] for r in results])
    return {"draws": count, "vertices": [len(r.decimated) for r in results],
            "distortion_median": [r.conformal_median for r in reports],
            "flipped_percent": [100 * r.flipped for r in reports],
            "mean_distance_percent_of_level": dict(enumerate(levels.mean(axis=0).tolist()))}


def main() -> None:
    parser = parser_of("experiments parameterization", __doc__, "fewer and smaller meshes, no pictures")
    parser.add_argument("meshes", type=Path)
    options = parsed(parser)
    folder, quick = options.meshes, options.quick
    numbers = {
        "fig:withWithoutConformal": conformal(folder),
        "fig:controlEC": strategies(folder),
        "fig:uniformRemesh": against_maps(folder, 1 if quick else 2),
        "fig:robustSSS": criteria(shapes(folder, 5_000 if quick else 60_000)),
        "fig:manyShapes": discretizations(folder, 3 if quick else 10),
    }
    if quick:
        print(numbers)
        return
    from experiments.parameterization_pictures import draw_all

    draw_all(folder)
    settings = {"faces": FACES, "levels": LEVELS}
    write_results("parameterization", {**provenance(options), "settings": settings, **numbers}, options)


if __name__ == "__main__":
    main()
