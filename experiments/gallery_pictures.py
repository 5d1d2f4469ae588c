"""The pictures of `gallery.py`, for docs/reproduction."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy import ndarray
from PIL import Image

import neusub
from experiments import measures
from experiments.drawing import BACK, BLUE, FRONT, GREEN, GREY, SAND, SIDE, UP, shaded, titled, write_panels
from experiments.gallery import (
    ARTISTS,
    CAGE,
    CAT,
    COARSE,
    DEFORMATIONS,
    FEWER,
    MODELS,
    ROCKER,
    SKULL,
    TEASER,
    artist_mesh,
    baked,
    decimated,
    refined,
    textured_cage,
    textured_fine,
)
from experiments.measures import SCHEMES, percents, remeshed
from experiments.parameterization_pictures import SMALL
from neusub import Mesh, SelfParameterization
from neusub.map_pictures import Surface, View, coloured_fine, edge_images, face_colors, levels_within, surface_picture
from neusub.selfparam.parameterization import refinement

NAMES = {"loop": "Loop", **{name: name for name in ("butterfly", *MODELS)}}
COLORS = {**dict.fromkeys(SCHEMES, SAND), **dict.fromkeys(TEASER[len(SCHEMES):], BLUE)}


def draw_all(folder: Path) -> None:
    for draw in (draw_teaser, draw_levels, draw_pairs, draw_map, draw_artists, draw_semantic, draw_texture,
                 draw_cages):
        print(draw(folder), flush=True)


def draw_teaser(folder: Path) -> Path:
    """fig:teaser: reference and coarse mesh, then each method with its mean distance."""
    pair, size = decimated(folder, ROCKER), (300, 190)
    coarse = pair.on_surface
    panels = [titled(shaded(pair.fine, GREEN, size), "reference"),
              titled(shaded(coarse, GREY, size, frame=pair.fine, edges=True), f"coarse, {COARSE} vertices")]
    for method in TEASER:
        result = refined(coarse, method)
        title = f"{NAMES.get(method, method)}, M {percents(result, pair.fine)['M']:.3f} %"
        panels.append(titled(shaded(result, COLORS[method], size, frame=pair.fine), title))
    return write_panels("teaser", [panels[:4], panels[4:]])


def draw_levels(folder: Path) -> Path:
    """fig:allLevels: the coarse mesh and three levels of a network, with edges."""
    rows, size = [], (330, 270)
    for name, method in ((ROCKER, "default"), (CAT, "elephant")):
        pair = decimated(folder, name)
        levels = measures.refined(pair.on_surface, method, 3)[1:]
        rows.append([shaded(pair.on_surface, GREY, size, frame=pair.fine, edges=True)])
        rows[-1] += [shaded(mesh, BLUE, size, frame=pair.fine, edges=level == 0) for level, mesh in enumerate(levels)]
        titles = (f"coarse, {COARSE} vertices", *(f"{method}, level {k}" for k in (1, 2, 3)))
        rows[-1] = [titled(panel, title) for panel, title in zip(rows[-1], titles)]
    return write_panels("all_levels", rows)


def draw_pairs(folder: Path) -> Path:
    """fig:trainData, fig:manyShapes: one shape, random coarse meshes, and their targets on the surface."""
    fine, size = neusub.load(folder / "organic" / "oded_hand_closed.ply"), (300, 330)
    results = [neusub.decimate(fine, n_vertices=n, strategy="random", seed=n) for n in (150, 220, 300)]
    top = [titled(shaded(fine, GREEN, size), "original"),
           *(titled(shaded(r.coarse, GREY, size, frame=fine, edges=True), f"{len(r.decimated)} vertices")
             for r in results)]
    bottom = [titled(shaded(fine, GREEN, size, BACK), "from behind"),
              *(titled(shaded(remeshed(r, 1), BLUE, size, frame=fine, edges=True), "target of level 1")
                for r in results)]
    return write_panels("train_pairs", [top, bottom])


def draw_map(folder: Path) -> Path:
    """fig:SSS: the original, the coarse mesh, and the original in the colours of the faces of each level."""
    result, size = decimated(folder, SKULL, 100), (400, 360)
    view = View(result.fine, size, FRONT, UP)
    coarse = Surface(result.decimated, result.faces, face_colors(result.faces, len(result.decimated)))
    panels = [titled(shaded(result.fine, GREEN, size), f"original, {len(result.fine.faces):,} faces"),
              titled(surface_picture(coarse, view, wireframe=True), f"decimated, {len(result.faces)} faces"),
              titled(surface_picture(coloured_fine(result, coarse.colors, SMALL), view, edge_images(result)),
                     "the original, by coarse face")]
    panels += [titled(surface_picture(level_colored(result, level), view), f"by face of level {level}")
               for level in (1, 2, 3)]
    return write_panels("map_levels", [panels[:3], panels[3:]])


def level_colored(result: SelfParameterization, level: int) -> Surface:
    """The fine surface, each face of a refinement in its colour; split further, to follow the surface."""
    n = len(result.decimated)
    colors = face_colors(refinement(result.faces, n, level).faces, refinement(result.faces, n, level).sizes[-1])
    levels = max(level, levels_within(len(result.faces), SMALL))
    parts = refinement(result.faces, n, levels)
    points = result.points(*result.to_fine(parts.at, parts.barycentric))
    return Surface(points, parts.faces, np.concatenate([colors] * 4 ** (levels - level)))


def draw_artists(folder: Path) -> Path:
    """fig:subdivScene: a contact sheet."""
    size, meshes = (180, 165), [artist_mesh(folder, name) for name in ARTISTS]
    rows = []
    for method, title in {"coarse": "coarse", **NAMES}.items():
        is_coarse = method == "coarse"
        rows.append([titled(shaded(mesh if is_coarse else refined(mesh, method), COLORS.get(method, GREY), size,
                                   frame=mesh, edges=is_coarse), "" if k else title) for k, mesh in enumerate(meshes)])
    return write_panels("artists", rows)


def draw_semantic(folder: Path) -> Path:
    """fig:lim_semantic: what the coarse mesh has lost stays lost."""
    size, rows = (330, 330), [[], []]  # type: ignore[var-annotated]
    whole = decimated(folder, SKULL).fine
    for vertices in FEWER:
        coarse = decimated(folder, SKULL, vertices).on_surface
        rows[0].append(titled(shaded(coarse, GREY, size, frame=whole, edges=True), f"{vertices} vertices"))
        rows[1].append(titled(shaded(refined(coarse, "default", 3), BLUE, size, frame=whole), "default, level 3"))
    rows[0].append(titled(shaded(whole, GREEN, size), "the original"))
    rows[1].append(titled(shaded(whole, GREEN, size, SIDE), "from the side"))
    return write_panels("semantic", rows)


def draw_texture(folder: Path) -> Path:
    """fig:texture: an artist's cage whose UVs come along, and a decimated mesh with a texture through the map."""
    cage, fine = textured_cage(folder), textured_fine(folder)
    pair = neusub.decimate(fine, n_vertices=COARSE, strategy="quadric")
    image = fine.materials[0].textures[0][2]
    top = [cage, refined(cage, "loop"), refined(cage, "default")]
    bottom = [fine, baked(pair, image, "loop"), baked(pair, image, "default")]
    titles = [["cage, 188 vertices", "Loop", "default"], ["original", "decimated, Loop", "decimated, default"]]
    return write_panels("texture", [[titled(photo(mesh, (400, 400), BACK), title) for mesh, title in zip(row, words)]
                                    for row, words in zip((top, bottom), titles)])


def photo(mesh: Mesh, size: tuple[int, int], camera: Sequence[float]) -> ndarray:
    """A panel with the mesh's texture."""
    with TemporaryDirectory() as place:
        path = neusub.render(mesh, Path(place) / "panel.png", panel=(2 * size[0], 2 * size[1]), camera=tuple(camera))
        return np.asarray(Image.open(path).convert("RGB").reduce(2))


def draw_cages(folder: Path) -> Path:
    """fig:modeling: a cage and three deformed ones, and what the default network makes of them."""
    cage, size, rows = artist_mesh(folder, CAGE), (320, 320), [[], []]  # type: ignore[var-annotated]
    for title, deform in {"the cage": None, **DEFORMATIONS}.items():
        mesh = cage if deform is None else cage.replace_vertices(deform(cage.vertices))
        rows[0].append(titled(shaded(mesh, GREY, size, edges=True), title))
        rows[1].append(titled(shaded(refined(mesh, "default"), BLUE, size, frame=mesh), "default, level 2"))
    return write_panels("modeling", rows)
