"""Pictures of the paper with the shipped weights: decimated shapes, artists' models, textures, deformed cages, limits.

    python -m experiments gallery MESHES

MESHES is the folder of INDEX.csv.  No training: the models are `elephant`, the paper's network, and `default`.  H and M
are in percent of the reference's diagonal.  Coarse meshes come from `decimate(strategy="quadric")` down to 350 vertices
where nothing else is said; networks are told the kind of input where their card names weights for it.
Writes results/gallery.json and docs/reproduction/*.webp.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy import ndarray

import neusub
from experiments import measures
from experiments.common import parsed, parser_of, provenance, write_results
from experiments.drawing import upright
from experiments.measures import FOLD, KINDS, SCHEMES, angles, mean_of, percents, remeshed, volume
from neusub import Mesh, SelfParameterization
from neusub.metrics import point_distance, sample_surface

SHOWS = ("fig:teaser", "fig:allLevels", "fig:trainData", "fig:manyShapes", "fig:SSS", "fig:subdivScene",
         "fig:lim_semantic", "fig:texture", "fig:modeling")
MODELS = ("elephant", "default")
METHODS = (*SCHEMES, *MODELS)
TEASER = (*SCHEMES, "bunny", *MODELS)  # with the teaser's own training shape
COARSE, LEVELS = 350, 2
FEWER = (75, 150, 350)
ROCKER, CAT = "manmade/ns_rocker_arm.ply", "organic/oded_cat_low_resolution.ply"
SKULL = "organic/oded_skull_low_resolution.ply"
UNSEEN = (ROCKER, "organic/oded_bunny_hr.ply", "organic/oded_armadillo.ply", "manmade/mlab_casting.ply",
          "manmade/common_fandisk.ply", "manmade/oded_boot.ply")  # in no training of these models but `bunny`'s
ARTISTS = ("quat_cow", "quat_wolf", "quat_pig", "kenney_cloud", "oded_penguin_control_mesh", "oded_spot_control_mesh",
           "oded_fish_control_mesh", "ns_coarse_rockerArm")
CAGE = "oded_spot_control_mesh"


# --- shapes and scores -------------------------------------------------------------------------------------------


@cache
def decimated(folder: Path, name: str, vertices: int = COARSE) -> SelfParameterization:
    return neusub.decimate(neusub.load(folder / name), n_vertices=vertices, strategy="quadric")


def refined(mesh: Mesh, method: str, levels: int = LEVELS, kind: str = "on_surface") -> Mesh:
    return measures.refined(mesh, method, levels, kind)[-1]


def teaser(folder: Path, shapes: Sequence[str]) -> dict:
    """fig:teaser: each kind of coarse vertices, each method; means, and the shapes."""
    rows: dict = {}
    for kind in KINDS:
        for method in TEASER:
            scores = {}
            for name in shapes:
                pair = decimated(folder, name)
                coarse = pair.on_surface if kind == "on_surface" else pair.coarse
                scores[Path(name).stem] = percents(refined(coarse, method, kind=kind), pair.fine)
            means = mean_of(scores)
            rows.setdefault(kind, {})[method] = {**means, "shapes": scores}
            print(f"{kind:12s}{method:12s}H {means['H']:.3f}  M {means['M']:.4f}", flush=True)
    return rows


def all_levels(folder: Path) -> dict:
    """fig:allLevels: the coarse mesh, then the network's levels 0 to 3."""
    rows: dict = {}
    for name in (ROCKER, CAT):
        pair = decimated(folder, name)
        for method in MODELS:
            levels = measures.refined(pair.on_surface, method, 3)
            rows.setdefault(Path(name).stem, {})[method] = {
                "coarse": percents(pair.on_surface, pair.fine),
                **{f"level {k}": percents(mesh, pair.fine) for k, mesh in enumerate(levels)}}
    return rows


def artists(folder: Path) -> dict:
    """fig:subdivScene: no truth is known; how smooth the result is, how many edges fold, what became of the volume."""
    rows: dict = {}
    for name in ARTISTS:
        coarse = artist_mesh(folder, name)
        for method in METHODS:
            result = refined(coarse, method)
            degrees = angles(result)
            rows.setdefault(name, {})[method] = {
                "mean_angle": float(degrees.mean()), "folds": int((degrees > FOLD).sum()),
                "volume_percent_of_coarse": 100 * volume(result) / volume(coarse)}
        rows[name]["coarse_folds"] = int((angles(coarse) > FOLD).sum())
    return rows


def artist_mesh(folder: Path, name: str) -> Mesh:
    return upright(neusub.load(folder / "lowpoly" / f"{name}.obj"), name)


def semantic(folder: Path) -> dict:
    """fig:lim_semantic: ever fewer vertices; beside the networks, what a perfect one could reach with as many faces."""
    rows: dict = {}
    for vertices in FEWER:
        pair = decimated(folder, SKULL, vertices)
        rows[vertices] = {"coarse": percents(pair.on_surface, pair.fine),
                          **{method: percents(refined(pair.on_surface, method), pair.fine) for method in MODELS},
                          "remesh": percents(remeshed(pair, LEVELS), pair.fine)}
    return rows


# --- deformed cages ----------------------------------------------------------------------------------------------


def big_head(vertices: ndarray) -> ndarray:
    """What lies high and in front grows by half about the neck, softly."""
    neck = np.array([0, 0.25, 0.45])
    along = (vertices - neck) @ (np.array([0, 0.8, 0.6]))
    return neck + (vertices - neck) * (1 + 0.5 * np.clip(along / 0.4, 0, 1))[:, None]


def long_legs(vertices: ndarray) -> ndarray:
    """What lies below the belly is stretched."""
    return vertices + np.minimum(vertices[:, 1:2] + 0.25, 0) * [0, 1.2, 0]


def curved(vertices: ndarray) -> ndarray:
    """The body bent about the vertical by some 60 degrees, head and tail to one side."""
    angle = 0.75 * vertices[:, 2]
    radius = 1 / 0.75 + vertices[:, 0]
    return np.stack([radius * np.cos(angle) - 1 / 0.75, vertices[:, 1], radius * np.sin(angle)], axis=1)


DEFORMATIONS = {"big head": big_head, "long legs": long_legs, "bent": curved}


def modeling(folder: Path) -> dict:
    """fig:modeling: how far subdividing the deformed cage is from deforming the subdivided one."""
    cage, rows = artist_mesh(folder, CAGE), {}
    for name, deform in DEFORMATIONS.items():
        changed = cage.replace_vertices(deform(cage.vertices))
        rows[name] = {}
        for method in METHODS[1:]:
            result = refined(cage, method)
            rows[name][method] = percents(refined(changed, method), result.replace_vertices(deform(result.vertices)))
    return rows


# --- texture -----------------------------------------------------------------------------------------------------


def painted(mesh: Mesh, uv: ndarray, uv_faces: ndarray, image: bytes) -> Mesh:
    from neusub.mesh import Material

    material = Material("texture", textures=(("map_Kd", "texture.png", image),))
    return Mesh(mesh.vertices, mesh.faces, uv, uv_faces, face_data={"material": np.zeros(len(mesh.faces), np.int64)},
                materials=(material,))


def textured_cage(folder: Path) -> Mesh:
    """spot's control mesh with its UVs and its texture."""
    mesh = neusub.load(folder / "originals" / "spot_control_mesh_uv.obj")
    assert mesh.uv is not None and mesh.uv_faces is not None
    return painted(mesh, mesh.uv, mesh.uv_faces, (folder / "originals" / "spot_texture.png").read_bytes())


def textured_fine(folder: Path) -> Mesh:
    mesh = neusub.load(folder / "originals" / "spot_triangulated.obj")
    assert mesh.uv is not None and mesh.uv_faces is not None
    return painted(mesh, mesh.uv, mesh.uv_faces, (folder / "originals" / "spot_texture.png").read_bytes())


def baked(pair: SelfParameterization, image: bytes, method: str) -> Mesh:
    """The decimated mesh, subdivided, with the fine mesh's texture carried through the map."""
    from neusub.selfparam.baking import png_bytes

    atlas, uv, uv_faces = pair.bake(image, LEVELS)
    return painted(refined(pair.on_surface, method), uv, uv_faces, png_bytes(atlas))


def colors_at(mesh: Mesh, points: ndarray, faces: ndarray) -> ndarray:
    """Of the texture at points of faces, 0 .. 255."""
    from igl import barycentric_coordinates

    from neusub.selfparam.baking import checked_texture, sample_texture

    assert mesh.uv is not None and mesh.uv_faces is not None
    a, b, c = (np.ascontiguousarray(corner) for corner in mesh.vertices[mesh.faces[faces]].transpose(1, 0, 2))
    weights = barycentric_coordinates(points, a, b, c)
    uv = np.einsum("nk,nkc->nc", weights, mesh.uv[mesh.uv_faces[faces]])
    return sample_texture(checked_texture(mesh.materials[0].textures[0][2]), uv)[:, :3]


def color_difference(result: Mesh, fine: Mesh) -> float:
    """Mean over the result of the difference to the colour at the closest point, in percent of white."""
    points, faces = sample_surface(result, 20_000, np.random.default_rng(0))
    _, at, closest = point_distance(points, fine)
    return float(np.abs(colors_at(result, points, faces) - colors_at(fine, closest, at)).mean() / 2.55)


def texture(folder: Path) -> dict:
    """fig:texture: an artist's cage with its UVs, and a decimated mesh with the texture carried through the map."""
    cage, fine = textured_cage(folder), textured_fine(folder)
    pair = neusub.decimate(fine, n_vertices=COARSE, strategy="quadric")
    image, rows = fine.materials[0].textures[0][2], {}  # type: ignore[var-annotated]
    for method in METHODS:
        for name, result in (("cage", refined(cage, method)), ("decimated", baked(pair, image, method))):
            rows.setdefault(name, {})[method] = {**percents(result, fine),
                                                 "color_difference_percent": color_difference(result, fine)}
    return rows


# --- the whole ---------------------------------------------------------------------------------------------------


def main() -> None:
    parser = parser_of("experiments gallery", __doc__, "one shape for fig:teaser, no pictures")
    parser.add_argument("meshes", type=Path)
    options = parsed(parser)
    folder = options.meshes
    numbers = {
        "fig:teaser": teaser(folder, UNSEEN[:1] if options.quick else UNSEEN),
        "fig:allLevels": all_levels(folder),
        "fig:subdivScene": artists(folder),
        "fig:lim_semantic": semantic(folder),
        "fig:modeling": modeling(folder),
        "fig:texture": texture(folder),
    }
    if options.quick:
        print(numbers)
        return
    from experiments.gallery_pictures import draw_all

    draw_all(folder)
    write_results("gallery", {**provenance(options), "settings": {"vertices": COARSE, "levels": LEVELS}, **numbers},
                  options)


if __name__ == "__main__":
    main()
