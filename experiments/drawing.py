"""Panels of the documentation's pictures, in the paper's colours: what is fine green, what is coarse grey, what a
network made blue, classical schemes in sand."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray
from PIL import Image, ImageDraw, ImageFont

from experiments.common import HERE
from neusub import Mesh
from neusub.files import replacing
from neusub.map_pictures import Surface, View, surface_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURES = HERE.parent / "docs" / "reproduction"
GREEN, GREY, BLUE, SAND = (150, 200, 140), (214, 214, 214), (150, 190, 230), (232, 214, 180)
CLAY, RED = (223, 227, 234), (220, 50, 40)
FRONT, BACK, SIDE = (0.9, 0.45, 1.2), (0.9, 0.45, -1.2), (1.0, 0.3, 0.4)  # most shapes look along z, some along -z
UP, TITLE = (0, 1, 0), 26
TURNS = {  # axes and their signs that bring a mesh of the folder to stand upright and look along z
    **dict.fromkeys(("oded_spot_control_mesh", "ns_coarse_spot", "quat_red_fox"), ([0, 1, 2], [-1, 1, -1])),
    "quat_wolf": ([2, 1, 0], [-1, 1, 1]),
    "ns_coarse_bunny": ([0, 2, 1], [1, 1, -1]),
    "gc_fox": ([1, 2, 0], [1, 1, 1]),
}


def upright(mesh: Mesh, name: str) -> Mesh:
    """The bare mesh, turned for the pictures."""
    axes, signs = TURNS.get(name, ([0, 1, 2], [1, 1, 1]))
    return Mesh(mesh.vertices[:, axes] * signs, mesh.faces)


def panel(mesh: Mesh, view: View, color: tuple | ndarray = CLAY, *, edges: bool = False) -> ndarray:
    """A picture of a mesh in one colour, or in a colour for each face (nF, 3)."""
    colors = np.empty(mesh.faces.shape, np.uint8)
    colors[:] = color
    return surface_picture(Surface(mesh.vertices, mesh.faces, colors), view, wireframe=edges)


def shaded(mesh: Mesh, color: tuple, size: tuple[int, int], camera: tuple = FRONT, *, frame: Mesh | None = None,
           edges: bool = False) -> ndarray:
    """The same, framed by `frame`, by the mesh itself by default."""
    return panel(mesh, View(frame or mesh, size, camera, UP), color, edges=edges)


def red(is_red: ndarray) -> ndarray:
    """Colours of faces: some of them red, the others as clay."""
    return np.where(is_red[:, None], RED, CLAY)


def blank(size: tuple[int, int]) -> ndarray:
    return np.full((size[1], size[0], 3), 255, np.uint8)


def titled(picture: ndarray, title: str) -> ndarray:
    image = Image.new("RGB", (picture.shape[1], picture.shape[0] + TITLE), "white")
    image.paste(Image.fromarray(picture))
    at = (picture.shape[1] / 2, picture.shape[0] + TITLE / 2)
    ImageDraw.Draw(image).text(at, title, fill="black", font=ImageFont.load_default(15), anchor="mm")
    return np.asarray(image)


def write_panels(name: str, rows: Sequence[Sequence[ndarray]]) -> Path:
    """Panels of one size in rows."""
    return write_picture(name, Image.fromarray(np.concatenate([np.concatenate(row, axis=1) for row in rows])))


def write_chart(name: str, figure: Figure) -> Path:
    """Lines on a plain ground are smaller without losses."""
    file = BytesIO()
    figure.savefig(file, format="png")
    return write_picture(name, Image.open(file), lossless=True)


def write_picture(name: str, image: Image.Image, folder: Path = PICTURES, lossless: bool = False) -> Path:
    """Of the documentation, as WebP: half of the bytes of a PNG in few colours."""
    path = folder / f"{name}.webp"
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as new:
        image.convert("RGB").save(new, quality=90, method=6, lossless=lossless)
    return path
