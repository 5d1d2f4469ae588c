"""The pictures of `parameterization.py`, for docs/reproduction; of shapes with a free licence only (CC0, CC BY)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy import ndarray

import neusub
from experiments.drawing import BACK, FRONT, SIDE, UP, panel, red, titled, write_panels
from experiments.measures import remeshed
from experiments.parameterization import (
    BLUB,
    CRITERIA,
    FACES,
    KOALA,
    LEVELS,
    PENGUIN,
    STRATEGIES,
    TEXTURED,
    down,
    drawn,
    uneven,
)
from neusub import Mesh, SelfParameterization, decimate
from neusub.map_pictures import View, checkerboard, coloured_fine, edge_images, face_colors, surface_picture
from neusub.metrics import face_normals
from neusub.selfparam.parameterization import refinement

SMALL = 400_000  # faces of a coloured surface
# Four corners of a view, in shares of the shape's box.
LACES = np.array([[0.3, 0.4, 0.2], [0.75, 0.4, 0.2], [0.3, 1.0, 0.2], [0.3, 0.4, 0.8]])  # of the boot
FINGERS = np.array([[0.1, 0.5, 0.0], [0.95, 0.5, 0.0], [0.1, 1.0, 0.0], [0.1, 0.5, 1.0]])  # of the hand
GALLERY = {  # where to look from
    "organic/oded_fish.ply": SIDE,
    "organic/oded_hand_closed.ply": FRONT,
    "organic/oded_scorpion.ply": (0.9, 0.8, 1.2),
    "organic/oded_penguin_hr.ply": FRONT,
    "organic/oded_skull_low_resolution.ply": FRONT,
    "manmade/oded_boot.ply": FRONT,
    "manmade/oded_wingnut.ply": (0.9, 0.8, 1.2),
    "boundary/oded_plane_holes.ply": (0.9, 0.8, 1.2),
}


def draw_all(folder: Path) -> None:
    for draw in (draw_flattenings, draw_strategies, draw_maps, draw_fitted, draw_criteria, draw_gallery, draw_draws,
                 draw_targets):
        print(draw(folder), flush=True)


# --- panels ------------------------------------------------------------------------------------------------------


def wireframe(mesh: Mesh, view: View) -> ndarray:
    return panel(mesh, view, edges=True)


def checks(result: SelfParameterization, view: View) -> ndarray:
    return surface_picture(checkerboard(result, LEVELS, SMALL), view)


def patches(result: SelfParameterization, view: View) -> ndarray:
    """The fine surface coloured by coarse face, with the images of the coarse edges."""
    colors = face_colors(result.faces, len(result.decimated))
    return surface_picture(coloured_fine(result, colors, SMALL), view, edge_images(result))


# --- pictures ----------------------------------------------------------------------------------------------------


def draw_flattenings(folder: Path) -> Path:
    """fig:withWithoutConformal."""
    rows: list[list[ndarray]] = [[], []]
    for name, camera in ((BLUB, (1.0, 0.3, 0.6)), (KOALA, FRONT), (PENGUIN, FRONT)):
        mesh = neusub.load(folder / name)
        view = View(mesh, (420, 360), camera, UP)
        for row, flattening in zip(rows, ("conformal", "uniform")):
            picture = checks(decimate(mesh, n_faces=FACES, flattening=flattening), view)
            row.append(titled(picture, f"{flattening} flattening"))
    return write_panels("flattening", rows)


def draw_strategies(folder: Path) -> Path:
    """fig:controlEC."""
    mesh = neusub.load(folder / TEXTURED)
    view = View(mesh, (270, 330), BACK, UP)
    results = {name: decimate(mesh, n_faces=FACES, strategy=name) for name in STRATEGIES}
    return write_panels("strategies", [[wireframe(r.coarse, view) for r in results.values()],
                                       [titled(patches(r, view), name) for name, r in results.items()]])


def draw_maps(folder: Path) -> Path:
    """fig:uniformRemesh: the first refinement."""
    mesh = uneven(neusub.load(folder / TEXTURED), 2)
    view = View(mesh, (330, 390), (1.3, 0.45, -0.6), UP)
    titles = {"quadric": "ours, quadric", "uniform": "ours, uniform", "MAPS": "MAPS"}
    panels = [titled(wireframe(remeshed(down(mesh, name), 1), view), title) for name, title in titles.items()]
    return write_panels("maps", [[titled(wireframe(mesh, view), f"input, {len(mesh.faces):,} faces"), *panels]])


def closer(mesh: Mesh, corners: ndarray, size: tuple[int, int]) -> View:
    """A view of a part, which lies between these corners of the box."""
    frame = corners * np.ptp(mesh.vertices, axis=0) + mesh.vertices.min(axis=0)
    return View(Mesh(frame, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3]])), size, FRONT, UP)


def draw_fitted(folder: Path) -> Path:
    """Not of the paper: the second refinement as decimated and fitted."""
    mesh = neusub.load(folder / "organic/oded_hand_closed.ply")
    view, result = closer(mesh, FINGERS, (420, 320)), decimate(mesh, n_faces=200, strategy="uniform")
    panels = {f"input, {len(mesh.faces):,} faces": mesh, "over 200 faces": remeshed(result),
              "fitted": remeshed(result.fitted(LEVELS))}
    return write_panels("fitted", [[titled(wireframe(shown, view), title) for title, shown in panels.items()]])


def draw_criteria(folder: Path) -> Path:
    """fig:robustSSS: the second refinement with all criteria, and with none; red where it turned over."""
    mesh = neusub.load(folder / "manmade/oded_boot.ply")
    view, panels = closer(mesh, LACES, (480, 440)), []
    for name, title in (("all", "all criteria"), ("none", "no criteria")):
        result = decimate(mesh, n_faces=FACES, criteria=CRITERIA[name])
        fine, refined = remeshed(result), refinement(result.faces, len(result.decimated), LEVELS)
        under, _ = result.to_fine(refined.owner, refined.corners.mean(axis=1))
        is_flipped = (face_normals(fine) * face_normals(mesh)[under]).sum(axis=1) < 0
        picture = panel(fine, view, red(is_flipped), edges=True)
        panels.append(titled(picture, f"{title}, {100 * is_flipped.mean():.1f} % turned over"))
    return write_panels("criteria", [panels])


def draw_gallery(folder: Path) -> Path:
    """fig:robustSSS: shapes, coloured by coarse face."""
    panels = []
    for name, camera in GALLERY.items():
        result = decimate(neusub.load(folder / name), n_faces=FACES)
        view = View(result.fine, (330, 280), camera, UP)
        panels.append(titled(patches(result, view), f"{len(result.fine.faces):,} to {len(result.faces)} faces"))
    return write_panels("shapes", [panels[:4], panels[4:]])


def draw_draws(folder: Path) -> Path:
    """fig:manyShapes."""
    results = drawn(folder, 7)
    view = View(results[0].fine, (300, 330), BACK, UP)
    panels = [titled(wireframe(mesh, view), f"{len(mesh.vertices):,} vertices")
              for mesh in (results[0].fine, *(result.coarse for result in results))]
    return write_panels("many_shapes", [panels[:4], panels[4:]])


def draw_targets(folder: Path) -> Path:
    """fig:trainData: two draws, and the levels that are their targets."""
    rows = []
    for result in drawn(folder, 7)[-3:-1]:
        view = View(result.fine, (300, 330), BACK, UP)
        rows.append([titled(wireframe(result.coarse, view), f"decimated, {len(result.decimated)} vertices")])
        rows[-1] += [titled(wireframe(remeshed(result, level), view), f"target of level {level}")
                     for level in range(LEVELS + 1)]
    return write_panels("training_data", rows)
