"""The pictures of `styles.py`, for docs/reproduction."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy import ndarray

import neusub
from experiments.common import tosca_poses
from experiments.drawing import BACK, BLUE, FRONT, GREEN, GREY, SIDE, blank, shaded, titled, write_panels
from experiments.styles import (
    BLUB,
    BOAT,
    FISH,
    HAMMER,
    HAND,
    HELD_OUT,
    SPOT,
    SWORD,
    TRAININGS,
    WINGNUT,
    held_out,
    refined,
    sharp_coarse,
    unseen_poses,
)

CAMERAS = {SPOT: BACK, FISH: SIDE, BLUB: SIDE, HAND: FRONT, WINGNUT: FRONT, HAMMER: FRONT, BOAT: FRONT,
           SWORD: FRONT}
STYLES = {"spot": "one smooth shape", "wingnut": "one sharp shape", "organic": "four smooth ones",
          "mechanical": "four man-made ones"}
MORE = {"spot": "one training shape", "two": "two", "four": "four"}


def draw(models: dict[str, neusub.Subdivider], options: Namespace) -> None:
    """The pictures whose trainings are here; a column for each."""
    names = models.keys()
    if len(names & STYLES.keys()) > 1:
        print(draw_styles(models, options.meshes))
    if "spot" in names:
        print(draw_single(models["spot"], options.meshes))
    if len(names & MORE.keys()) > 1:
        print(draw_more(models, options.meshes))
    if "pose" in names and options.tosca:
        print(draw_poses(models["pose"], options))


def training_panel(folder: Path, shapes: Sequence[str], size: tuple[int, int]) -> ndarray:
    """Green: one shape, two side by side, or four."""
    columns, rows = (1 if len(shapes) == 1 else 2), (1 if len(shapes) <= 2 else 2)
    part = size[0] // columns, size[1] // rows
    small = [shaded(neusub.load(folder / shape), GREEN, part, CAMERAS[shape]) for shape in shapes]
    return np.concatenate([np.concatenate(small[k : k + columns], axis=1) for k in range(0, len(small), columns)])


def draw_styles(models: dict[str, neusub.Subdivider], folder: Path) -> Path:
    """fig:dataDriven, fig:lim_sharp, fig:mechE_vs_smooth: the same coarse meshes after different trainings."""
    names, size = [name for name in STYLES if name in models], (250, 220)
    inputs = [(sharp_coarse()["cube"], FRONT), (sharp_coarse()["solid 2"], FRONT),
              (held_out(folder, HELD_OUT["organic"][2])[1], FRONT)]
    rows = [[titled(blank(size), "coarse")]]
    rows[0] += [titled(training_panel(folder, TRAININGS[name], size), STYLES[name]) for name in names]
    for mesh, camera in inputs:
        rows.append([shaded(mesh, GREY, size, camera, edges=True)])
        rows[-1] += [shaded(refined(mesh, models[name]), BLUE, size, camera, frame=mesh) for name in names]
    return write_panels("styles", rows)


def draw_single(model: neusub.Subdivider, folder: Path) -> Path:
    """fig:singleShape."""
    size = (240, 240)
    shown = [(HELD_OUT["organic"][0], FRONT), (HELD_OUT["organic"][1], FRONT), (HELD_OUT["organic"][3], FRONT),
             (BOAT, FRONT)]
    meshes = [(held_out(folder, name)[1], camera) for name, camera in shown]
    spot, results = neusub.load(folder / SPOT), [refined(mesh, model) for mesh, _ in meshes]
    return write_panels("single_shape", [
        [shaded(spot, GREEN, size, BACK), *(shaded(mesh, GREY, size, camera, edges=True) for mesh, camera in meshes)],
        [titled(shaded(spot, GREEN, size, FRONT), "the training shape"),
         *(titled(shaded(result, BLUE, size, camera), "level 2") for result, (_, camera) in zip(results, meshes))],
    ])


def draw_more(models: dict[str, neusub.Subdivider], folder: Path) -> Path:
    """fig:moreShapes."""
    names, size = [name for name in MORE if name in models], (300, 240)
    rows = [[titled(blank(size), "coarse")]]
    rows[0] += [titled(training_panel(folder, TRAININGS[name], size), MORE[name]) for name in names]
    for mesh in (held_out(folder, HELD_OUT["organic"][0])[1], sharp_coarse()["solid 2"]):
        rows.append([shaded(mesh, GREY, size, FRONT, edges=True)])
        rows[-1] += [shaded(refined(mesh, models[name]), BLUE, size, FRONT, frame=mesh) for name in names]
    return write_panels("more_shapes", rows)


def draw_poses(model: neusub.Subdivider, options: Namespace) -> Path:
    """fig:poses."""
    size, trained = (230, 280), turned_up(tosca_poses(options.tosca, "centaur")[0])
    rows = [[titled(shaded(trained, GREEN, size), "the training shape")], [titled(blank(size), "")]]
    for _, _, coarse in unseen_poses(options):
        mesh = turned_up(coarse)
        rows[0].append(titled(shaded(mesh, GREY, size, edges=True), f"{len(mesh.vertices)} vertices"))
        rows[1].append(titled(shaded(refined(mesh, model), BLUE, size, frame=mesh), "level 2"))
    return write_panels("poses", rows)


def turned_up(mesh: neusub.Mesh) -> neusub.Mesh:
    """TOSCA's z is up, the camera's y."""
    return mesh.replace_vertices(mesh.vertices[:, [1, 2, 0]])
