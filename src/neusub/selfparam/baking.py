r"""Textures through the map: faces that a seam crosses get patches of their own, beside the old texture.

A patch is the right triangle under a refined face, two of a size in one square cell:

      +-----------+       n texels along the legs, corners at texel centres, MARGIN texels around it.  Bilinear
      | \ . . . 0 |       look-ups in a triangle then read its own texels only.
      | : \  2 | :|       Row 0 of an image is at the top, v points upwards.
      | 2   \    :|
      | | \   \ 1 |
      | 0--1 . .\ |
      +-----------+
"""

from __future__ import annotations

from io import BytesIO
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8
from numpy import ndarray

from neusub.errors import ParameterizationError
from neusub.selfparam.parameterization import SelfParameterization, refinement, weighted
from neusub.selfparam.signals import inside, signed_areas, transfer_corners

__all__ = ["bake", "checked_texture", "png_bytes", "sample_texture"]

MARGIN = 2
SMALLEST, STEP, LARGEST = 4, 2, 256  # sizes of patches: multiples of the step, so that few are in use
CHUNK = 1 << 18  # texels that are filled at a time


def bake(
    parameterization: SelfParameterization, texture: ndarray | bytes, levels: int = 0, *, density: float = 1.0
) -> tuple[UInt8[ndarray, "H W c"], Float64[ndarray, "nT_L 2"], Int64[ndarray, "nF_L 3"]]:
    """The fine mesh's texture for the `levels`-th refinement: image, UVs, and each refined corner's row of them.

    texture: (h, w, 3 or 4) uint8, or the bytes of a PNG or JPEG file; v points upwards.  density: texels of a patch
    for each texel of the texture, along an edge.  Faces that no seam crosses keep their texels.  The others, and faces
    that reach over the border of a texture that repeats, get a patch below it: the surface's colour at each texel,
    through the map.  Where there are none the texture comes back as it is.
    Raises: ParameterizationError where the fine mesh has no UVs, for a texture that is no image of this kind, a density
    that is not positive, a negative level.
    """
    fine, image = parameterization.fine, checked_texture(texture)
    if fine.uv is None or fine.uv_faces is None:
        raise ParameterizationError("the fine mesh has no UVs, so that no texture lies on it. Give uv and uv_faces.")
    if not 0 < density < np.inf:
        raise ParameterizationError(f"density = {density}: take a positive number, 1 for the texture's own.")
    uv, uv_faces, needs_patch = transfer_corners(parameterization, fine.uv, fine.uv_faces, levels)
    repeats = bool(fine.uv.min() < 0 or fine.uv.max() > 1)
    if repeats:
        uv, uv_faces, leaves = in_unit_square(uv, uv_faces)
        needs_patch |= leaves
    if not needs_patch.any():
        return image, uv, uv_faces
    refined = refinement(parameterization.faces, len(parameterization.decimated), levels)
    owner, corners = refined.owner[needs_patch], inside(refined.corners[needs_patch])
    sizes = patch_sizes(parameterization, owner, corners, image, density)
    height, width, _ = image.shape
    patches, (total_height, total_width) = pack(sizes, (height + 2 * MARGIN, width + 2 * MARGIN))
    atlas = np.empty((total_height, total_width, image.shape[2]), dtype=np.uint8)
    atlas[:] = np.round(image.mean(axis=(0, 1)))
    atlas[: height + 2 * MARGIN, : width + 2 * MARGIN] = np.pad(image, ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0)),
                                                               mode="wrap" if repeats else "edge")
    fill(atlas, patches, Source(parameterization, image, repeats), owner, corners)
    texels = np.stack([uv[:, 0] * width + MARGIN, (1 - uv[:, 1]) * height + MARGIN], axis=1)
    texels, uv_faces = with_patches(texels, uv_faces, needs_patch, patches)
    return atlas, np.stack([texels[:, 0] / total_width, 1 - texels[:, 1] / total_height], axis=1), uv_faces


def png_bytes(image: UInt8[ndarray, "h w c"]) -> bytes:
    """The file of an image, as `Material.textures` keeps it."""
    from PIL import Image

    file = BytesIO()
    Image.fromarray(image).save(file, format="PNG")
    return file.getvalue()


def checked_texture(texture: ndarray | bytes) -> UInt8[ndarray, "h w c"]:
    """A texture's pixels, from an image or a file's bytes.  Raises ParameterizationError for what is neither."""
    from PIL import Image, UnidentifiedImageError

    if isinstance(texture, bytes):
        try:
            image = Image.open(BytesIO(texture))
            return np.asarray(image.convert("RGBA" if image.has_transparency_data else "RGB"))
        except (UnidentifiedImageError, OSError) as error:
            raise ParameterizationError(f"the texture is no image that can be read ({error}). Give the bytes of a PNG "
                                        "or JPEG file.") from None
    image = np.asarray(texture)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] not in (3, 4) or 0 in image.shape:
        raise ParameterizationError(f"the texture has shape {image.shape} and type {image.dtype}. Give (h, w, 3 or 4) "
                                    "of type uint8, or the bytes of a PNG file.")
    return image


def in_unit_square(
    uv: Float64[ndarray, "nT 2"], uv_faces: Int64[ndarray, "nF 3"]
) -> tuple[Float64[ndarray, "n 2"], Int64[ndarray, "nF 3"], Bool[ndarray, " nF"]]:
    """Faces moved into the unit square by whole numbers, as the texture repeats; and which of them do not fit."""
    corners = uv[uv_faces]
    cell = np.floor(corners.min(axis=1) + 1e-9).astype(np.int64)
    leaves = (corners.max(axis=1) > cell + 1 + 1e-9).any(axis=1)
    keys = np.concatenate([uv_faces[..., None], np.repeat(cell[:, None], 3, axis=1)], axis=2).reshape(-1, 3)
    unique, row_of = np.unique(keys, axis=0, return_inverse=True)
    return uv[unique[:, 0]] - unique[:, 1:], row_of.reshape(-1, 3), leaves


# --- where patches lie -------------------------------------------------------------------------------------------


class Patches(NamedTuple):
    """Places of the patches in the image."""

    sizes: ndarray  # (n,) int64: texels along a leg
    left: ndarray  # (n,) int64: first column of the cell
    top: ndarray  # (n,) int64: first row
    is_upper: ndarray  # (n,) bool: which of the cell's two


def side_of(size: int) -> int:
    """Texels along a cell's side."""
    return size + 3 * MARGIN + 1


def patch_sizes(
    parameterization: SelfParameterization, owner: ndarray, corners: ndarray, image: ndarray, density: float
) -> Int64[ndarray, " n"]:
    """Texels along a leg: as many as the texture has along the image of the face's longest edge."""
    fine = parameterization.fine
    assert fine.uv is not None and fine.uv_faces is not None
    at, barycentric = parameterization.to_fine(np.repeat(owner, 3), corners.reshape(-1, 3))
    place = parameterization.points(at, barycentric).reshape(-1, 3, 3)
    edge = np.linalg.norm(place - np.roll(place, 1, axis=1), axis=2).max(axis=1)
    a, b, c = fine.vertices[fine.faces[at]].transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    texels = np.abs(signed_areas(fine.uv[fine.uv_faces[at]])) * image.shape[0] * image.shape[1]
    ratio = np.sqrt(np.divide(texels, area, out=np.zeros_like(area), where=area > 0)).reshape(-1, 3).mean(axis=1)
    wanted = np.minimum(edge * ratio * density, LARGEST)
    return np.maximum(STEP * np.ceil(wanted / STEP), SMALLEST).astype(np.int64)


def pack(sizes: Int64[ndarray, " n"], texture: tuple[int, int]) -> tuple[Patches, tuple[int, int]]:
    """Cells on shelves below the texture, the largest first; and the height and width of the whole."""
    n = len(sizes)
    order = np.argsort(-sizes, kind="stable")
    area = int((np.array([side_of(size) for size in sizes]) ** 2).sum()) // 2
    width = max(texture[1], side_of(int(sizes.max())), int(np.sqrt(area)))
    patches = Patches(sizes, np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, bool))
    x, y, shelf, half_full = 0, texture[0], 0, -1
    for patch in order:
        if half_full >= 0 and sizes[half_full] == sizes[patch]:
            patches.left[patch], patches.top[patch] = patches.left[half_full], patches.top[half_full]
            patches.is_upper[patch], half_full = True, -1
            continue
        side = side_of(int(sizes[patch]))
        if shelf == 0 or x + side > width:
            x, y, shelf = 0, y + shelf, side
        patches.left[patch], patches.top[patch], half_full = x, y, patch
        x += side
    return patches, (y + shelf, width)


def with_patches(
    texels: Float64[ndarray, "nT 2"], rows: Int64[ndarray, "nF 3"], needs_patch: Bool[ndarray, " nF"], patches: Patches
) -> tuple[Float64[ndarray, "n 2"], Int64[ndarray, "nF 3"]]:
    """Texture coordinates in texels (column, row; the first texel's centre at 1/2) with those of the patches."""
    last = (patches.sizes + 3 * MARGIN)[:, None]
    x = MARGIN + np.stack([0 * patches.sizes, patches.sizes, 0 * patches.sizes], axis=1)
    y = x[:, [0, 2, 1]]
    upper = patches.is_upper[:, None]
    x, y = np.where(upper, last - x, x), np.where(upper, last - y, y)
    corners = np.stack([patches.left[:, None] + x, patches.top[:, None] + last - y], axis=2) + 0.5
    used, kept = np.unique(rows[~needs_patch], return_inverse=True)
    result = np.empty_like(rows)
    result[~needs_patch] = kept.reshape(-1, 3)
    result[needs_patch] = len(used) + np.arange(3 * len(corners)).reshape(-1, 3)
    return np.concatenate([texels[used], corners.reshape(-1, 2)]), result


# --- what patches show -------------------------------------------------------------------------------------------


class Source(NamedTuple):
    """What colours come from: the fine mesh with UVs, the map to it, and its texture."""

    parameterization: SelfParameterization
    image: ndarray  # (h, w, c) uint8
    repeats: bool

    def colors(self, places: ndarray, owner: ndarray, corners: ndarray) -> Float64[ndarray, "n t c"]:
        """At places (t, 2) of the unit right triangle (corners (0, 0), (1, 0), (0, 1)) under each of n faces."""
        fine = self.parameterization.fine
        assert fine.uv is not None and fine.uv_faces is not None
        own = np.concatenate([1 - places.sum(axis=1, keepdims=True), places], axis=1)
        points = np.einsum("tk,nkc->ntc", own, corners).reshape(-1, 3)
        at, barycentric = self.parameterization.to_fine(np.repeat(owner, len(places)), points)
        uv = weighted(fine.uv, fine.uv_faces[at], barycentric)
        return sample_texture(self.image, uv, self.repeats).reshape(len(owner), len(places), -1)


def fill(atlas: ndarray, patches: Patches, source: Source, owner: ndarray, corners: ndarray) -> None:
    """Write the patches' texels into the atlas; all of one size at once, as far as memory allows."""
    for size in np.unique(patches.sizes):
        last = side_of(int(size)) - 1
        y, x = (grid.reshape(-1) for grid in np.mgrid[: last + 1, : last + 1])
        for is_upper in (False, True):
            own = (x + y > last) == is_upper
            column, row = x[own], last - y[own]
            p, q = (last - x[own], last - y[own]) if is_upper else (x[own], y[own])
            places = (np.stack([p, q], axis=1) - MARGIN) / size
            which = np.flatnonzero((patches.sizes == size) & (patches.is_upper == is_upper))
            step = max(1, CHUNK // len(places))
            for first in range(0, len(which), step):
                some = which[first : first + step]
                at = patches.top[some][:, None] + row, patches.left[some][:, None] + column
                atlas[at] = patch_colors(places, source, owner[some], corners[some])


def patch_colors(
    places: Float64[ndarray, "t 2"], source: Source, owner: ndarray, corners: ndarray
) -> UInt8[ndarray, "n t c"]:
    """Colours at places in and around the triangle.

    Beyond its edges the colour goes on as its mirror image says, linearly: so bilinear look-ups along an edge give what
    is on the edge.
    """
    within = into_triangle(places)
    outside = np.flatnonzero((within != places).any(axis=1))
    mirror = into_triangle(2 * within[outside] - places[outside])
    colors = source.colors(within, owner, corners)
    colors[:, outside] = 2 * colors[:, outside] - source.colors(mirror, owner, corners)
    return np.clip(np.round(colors), 0, 255).astype(np.uint8)


def into_triangle(places: Float64[ndarray, "t 2"]) -> Float64[ndarray, "t 2"]:
    """The closest places of the unit right triangle (beyond its two sharp corners: close ones)."""
    places = np.maximum(places, 0)
    places = np.maximum(places - np.maximum(places.sum(axis=1, keepdims=True) - 1, 0) / 2, 0)
    return places / np.maximum(places.sum(axis=1, keepdims=True), 1)


def sample_texture(
    image: UInt8[ndarray, "h w c"], uv: Float64[ndarray, "n 2"], repeats: bool = False
) -> Float64[ndarray, "n c"]:
    """Bilinear look-up, 0 .. 255; texel (row 0, column 0) has its centre at u = 1 / (2 w), v = 1 - 1 / (2 h).

    repeats: beyond the unit square the texture begins again; otherwise its border goes on.
    """
    height, width, _ = image.shape
    x, y = uv[:, 0] * width - 0.5, (1 - uv[:, 1]) * height - 0.5
    column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    s, t = (x - column)[:, None], (y - row)[:, None]
    columns, rows = np.stack([column, column + 1]), np.stack([row, row + 1])
    if repeats:
        columns, rows = columns % width, rows % height
    else:
        columns, rows = columns.clip(0, width - 1), rows.clip(0, height - 1)
    upper, lower = ((1 - s) * image[r, columns[0]] + s * image[r, columns[1]] for r in rows)
    return (1 - t) * upper + t * lower
