"""Signals on corners go through the map with their seams; textures are resampled where they must be."""

from dataclasses import replace
from io import BytesIO

import numba
import numpy as np
import pytest
from PIL import Image

import shapes
from neusub.errors import ParameterizationError
from neusub.mesh import Mesh
from neusub.selfparam import PLACE, SelfParameterization, decimate
from neusub.selfparam.baking import MARGIN, png_bytes, sample_texture
from neusub.selfparam.parameterization import Refinement, refinement, weighted
from neusub.selfparam.placement import evaluate, minimise
from neusub.selfparam.signals import locate_refined
from neusub.topology import connected_components

LEVELS = 2


def refined(parameterization: SelfParameterization, levels: int = LEVELS) -> Refinement:
    return refinement(parameterization.faces, len(parameterization.decimated), levels)


def images(parameterization: SelfParameterization, levels: int = LEVELS) -> np.ndarray:
    """Where the map puts the vertices of the refinement."""
    parts = refined(parameterization, levels)
    return parameterization.points(*parameterization.to_fine(parts.at, parts.barycentric))


def inner_points(parameterization: SelfParameterization, count: int = 200, spread: float = 1.0):
    """Random points in each refined face: barycentric (count, 3), fine faces (nF, count), barycentric there.

    spread: 1 is uniform; with less, points gather at edges and corners.
    """
    parts = refined(parameterization)
    inner = np.random.default_rng(0).dirichlet([spread] * 3, count)
    inner = inner[inner.min(axis=1) > 1e-7]
    count = len(inner)
    at, barycentric = parameterization.to_fine(np.repeat(parts.owner, count), (inner @ parts.corners).reshape(-1, 3))
    return inner, at.reshape(-1, count), barycentric.reshape(-1, count, 3)


def split(mesh: Mesh, levels: int) -> Mesh:
    """Midpoint subdivision, UVs and face data with it."""
    for _ in range(levels):
        edges = mesh.topology.edges
        mesh = mesh.refined(np.concatenate([mesh.vertices, mesh.vertices[edges].mean(axis=1)]))
    return mesh


def flat_patch(seed: int = 0) -> Mesh:
    """An open grid whose inner vertices lie anywhere nearby in the plane."""
    vertices, faces = shapes.refined(shapes.grid(5, 5), 2)
    mesh = Mesh(vertices, faces)
    inner = ~mesh.topology.is_boundary_vertex
    vertices[inner, :2] += np.random.default_rng(seed).uniform(-0.06, 0.06, (inner.sum(), 2))
    return Mesh(vertices, faces)


@pytest.fixture(scope="module")
def patch() -> SelfParameterization:
    return decimate(flat_patch(), n_faces=60, strategy="random")


def box_mesh() -> Mesh:
    """The cube, each side in its own sixth of the texture; face data say which side."""
    parts = shapes.uv_box()
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    uv = np.concatenate([(np.array([k % 3, k // 3]) + 0.2 + 0.6 * square) / [3, 2] for k in range(6)])
    return split(Mesh(**{**parts, "uv": uv}, face_data={"side": np.repeat(np.arange(6), 2)}), 3)


@pytest.fixture(scope="module")
def box() -> SelfParameterization:
    """Random collapses: vertices leave the edges of the box, so that seams go through faces."""
    return decimate(box_mesh(), n_faces=120, strategy="random", seed=1)


def uv_of_side(mesh: Mesh, side: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """On each side of the box UVs are affine in the position."""
    result = np.empty((len(positions), 2))
    for k in range(6):
        of_side = mesh.face_data["side"] == k
        known = np.column_stack([mesh.vertices[mesh.faces[of_side]].reshape(-1, 3), np.ones(3 * of_side.sum())])
        map_k = np.linalg.lstsq(known, mesh.uv[mesh.uv_faces[of_side]].reshape(-1, 2), rcond=None)[0]
        result[side == k] = np.column_stack([positions, np.ones(len(positions))])[side == k] @ map_k
    return result


def color_at(positions: np.ndarray) -> np.ndarray:
    return 60 + 120 * positions


def box_texture(mesh: Mesh, width: int = 192, height: int = 128) -> np.ndarray:
    """Each texel has the colour of the point of the box that it shows (or would show, beyond the side)."""
    row, column = np.mgrid[:height, :width]
    uv = np.stack([(column + 0.5) / width, 1 - (row + 0.5) / height], axis=-1)
    cell = np.floor(uv * [3, 2]).astype(int)
    image = np.empty((height, width, 3), dtype=np.uint8)
    for k in range(6):
        of_side, here = mesh.face_data["side"] == k, (cell == [k % 3, k // 3]).all(axis=-1)
        known = np.column_stack([mesh.uv[mesh.uv_faces[of_side]].reshape(-1, 2), np.ones(3 * of_side.sum())])
        map_k = np.linalg.lstsq(known, mesh.vertices[mesh.faces[of_side]].reshape(-1, 3), rcond=None)[0]
        image[here] = np.round(color_at(np.column_stack([uv[here], np.ones(here.sum())]) @ map_k))
    return image


# --- transfer ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("columns", [1, 2, 3])
def test_a_signal_affine_in_position_stays_so_on_a_flat_patch(patch, columns):
    matrix = np.random.default_rng(3).normal(size=(3, columns))
    uv, uv_faces, crosses = patch.transfer_corners(patch.fine.vertices @ matrix + 5, patch.fine.faces, LEVELS)
    parts = refined(patch)
    assert np.allclose(uv[uv_faces], (images(patch) @ matrix + 5)[parts.faces], atol=1e-12)
    assert not crosses.any()
    assert len(uv) == parts.sizes[-1]  # no seam where there was none


def test_without_a_collapse_corners_keep_their_values_and_seams():
    mesh = split(Mesh(**shapes.uv_box()), 2)
    uv, uv_faces, crosses = decimate(mesh, n_faces=len(mesh.faces)).transfer_corners(mesh.uv, mesh.uv_faces, 1)
    expected = split(mesh, 1)
    assert np.allclose(uv[uv_faces], expected.uv[expected.uv_faces], atol=1e-14)
    assert len(uv) == len(expected.uv)
    assert not crosses.any()


@numba.cfunc(PLACE)
def planes_only(a, b, quadric, position):
    """The built-in quadrics also keep triangles even, and so move vertices along the edges of the box to its corners,
    around which nothing lies flat; the planes alone take the sides' inner vertices first."""
    minimise(quadric, (a[0] + b[0]) / 2, (a[1] + b[1]) / 2, (a[2] + b[2]) / 2, position)
    return evaluate(quadric, position[0], position[1], position[2])


def test_seams_along_kept_edges_stay_there():
    """Quadrics hold vertices on the edges of the box: each seam runs along edges, and no face goes across."""
    mesh = box_mesh()
    parameterization = decimate(mesh, n_faces=100, strategy=planes_only)
    uv, uv_faces, crosses = parameterization.transfer_corners(mesh.uv, mesh.uv_faces, LEVELS)
    assert not crosses.any()
    parts = refined(parameterization)
    sides = connected_components(uv_faces, len(uv))[0]
    assert sides == 6
    centre, _ = parameterization.to_fine(parts.owner, parts.corners.mean(axis=1))
    side = np.repeat(mesh.face_data["side"][centre], 3)
    expected = uv_of_side(mesh, side, images(parameterization)[parts.faces].reshape(-1, 3))
    assert np.allclose(uv[uv_faces].reshape(-1, 2), expected, atol=1e-9)


def test_faces_that_no_seam_crosses_have_the_values_of_their_side(box):
    mesh = box.fine
    uv, uv_faces, crosses = box.transfer_corners(mesh.uv, mesh.uv_faces, LEVELS)
    parts = refined(box)
    centre, _ = box.to_fine(parts.owner, parts.corners.mean(axis=1))
    side = np.repeat(mesh.face_data["side"][centre[~crosses]], 3)
    expected = uv_of_side(mesh, side, images(box)[parts.faces[~crosses]].reshape(-1, 3))
    assert np.allclose(uv[uv_faces[~crosses]].reshape(-1, 2), expected, atol=1e-9)
    assert 0.3 < (~crosses).mean() < 1


def test_the_faces_whose_images_have_two_sides_are_reported_and_no_others(box):
    _, _, crosses = box.transfer_corners(box.fine.uv, box.fine.uv_faces, LEVELS)
    _, at, _ = inner_points(box, 1000, spread=0.1)  # seams cut off tips that few uniform points would find
    sides = box.fine.face_data["side"][at]
    has_two = (sides != sides[:, :1]).any(axis=1)
    assert has_two.sum() > 50
    assert crosses[has_two].all()
    assert (crosses & ~has_two).sum() <= 0.03 * crosses.sum()  # the thinnest slivers, which no point has hit


def test_a_chart_that_meets_itself_is_found():
    """A torus cut open: one chart, and no face that goes through the cut may pass for whole."""
    vertices, faces = shapes.torus(24, 16)
    i, j = np.divmod(faces, 16)
    wraps_i, wraps_j = ((x.max(axis=1) - x.min(axis=1) > 2)[:, None] & (x == 0) for x in (i, j))
    corners = np.stack([(i + 24 * wraps_i) / 24, (j + 16 * wraps_j) / 16], axis=-1).reshape(-1, 2)
    uv, uv_faces = np.unique(corners, axis=0, return_inverse=True)
    mesh = Mesh(vertices, faces, uv=uv, uv_faces=uv_faces.reshape(-1, 3))
    parameterization = decimate(mesh, n_faces=150)
    uv, uv_faces, crosses = parameterization.transfer_corners(mesh.uv, mesh.uv_faces, LEVELS)
    _, at, barycentric = inner_points(parameterization)
    inner = np.einsum("fnk,fnkc->fnc", barycentric, mesh.uv[mesh.uv_faces[at]])
    torn = (np.ptp(inner, axis=1) > 0.5).any(axis=1)
    assert crosses[torn].all() and torn.any()
    assert np.ptp(uv[uv_faces[~crosses]], axis=1).max() < 0.5
    assert crosses.mean() < 0.5


def test_a_mirrored_texture_is_a_seam():
    mesh = flat_patch()
    middle = np.abs(mesh.vertices[:, 0] - 2) < 0.1  # a column of edges, made straight
    mesh = mesh.replace_vertices(np.where(middle[:, None], mesh.vertices * [0, 1, 1] + [2, 0, 0], mesh.vertices))
    uv = np.stack([np.abs(mesh.vertices[:, 0] - 2), mesh.vertices[:, 1]], axis=1)
    parameterization = decimate(mesh, n_faces=60)
    result, _, crosses = parameterization.transfer_corners(uv, mesh.faces, LEVELS)
    _, at, barycentric = inner_points(parameterization)
    x = np.einsum("fnk,fnk->fn", barycentric, mesh.vertices[mesh.faces[at], 0]) - 2
    has_two = (x.min(axis=1) < -1e-9) & (x.max(axis=1) > 1e-9)
    assert crosses[has_two].all() and has_two.any()
    assert not crosses[np.abs(x).min(axis=1) > 0.3].any()
    assert len(result) == refined(parameterization).sizes[-1]  # values agree along it: no row twice


def test_corners_on_a_seam_take_their_side_and_no_row_more(box):
    """Along a seam each side has its row; elsewhere a vertex has one."""
    uv, uv_faces, crosses = box.transfer_corners(box.fine.uv, box.fine.uv_faces, LEVELS)
    parts = refined(box)
    at_vertex = [set() for _ in range(parts.sizes[-1])]
    for face, rows in zip(parts.faces.tolist(), uv_faces.tolist()):
        for v, row in zip(face, rows):
            at_vertex[v].add(row)
    near_seam = np.zeros(parts.sizes[-1], dtype=bool)
    near_seam[parts.faces[crosses]] = True
    assert all(len(rows) == 1 for rows, near in zip(at_vertex, near_seam) if not near)
    assert all(len(rows) <= 3 for rows in at_vertex)
    assert np.array_equal(np.unique(uv_faces), np.arange(len(uv)))


def test_points_are_found_in_the_refinement():
    rng = np.random.default_rng(0)
    _, faces = shapes.icosahedron()
    parts = refinement(faces, 12, 3)
    face, inner = rng.integers(0, len(parts.faces), 500), rng.dirichlet([1, 1, 1], 500)
    points = np.einsum("nk,nkc->nc", inner, parts.corners[face])
    found, barycentric = locate_refined(parts.owner[face], points, 3, len(faces))
    assert np.array_equal(found, face)
    assert np.allclose(barycentric, inner, atol=1e-14)


# --- bake --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def baked(box):
    return box.bake(box_texture(box.fine), LEVELS)


def test_baked_colours_are_those_of_the_surface(box, baked):
    """Corners of all faces, and points inside of those across seams.

    Two roundings make one grey level; at an edge of the box the colour's slope turns, by 120 grey levels over 38
    texels a side, within a texel.
    """
    image, uv, uv_faces = baked
    parts = refined(box)
    corners = sample_texture(image, uv[uv_faces].reshape(-1, 2))
    assert np.abs(corners - color_at(images(box))[parts.faces].reshape(-1, 3)).max() < 1 + 2 * 120 / 38
    _, _, crosses = box.transfer_corners(box.fine.uv, box.fine.uv_faces, LEVELS)
    inner, at, barycentric = inner_points(box)
    shown = sample_texture(image, (inner @ uv[uv_faces[crosses]]).reshape(-1, 2))
    points = weighted(box.fine.vertices, box.fine.faces[at[crosses].ravel()], barycentric[crosses].reshape(-1, 3))
    error = np.abs(shown - color_at(points))
    assert error.max() < 1 + 2 * 120 / 38
    assert np.quantile(error, 0.9) < 1


def test_a_patch_on_a_flat_seam_is_within_a_grey_level():
    """Two charts side by side on a flat patch, apart in the texture: colours are affine, so nothing is lost."""
    vertices, faces = shapes.refined(shapes.grid(5, 5), 2)
    right = vertices[faces].mean(axis=1)[:, 0] > 2
    uv = np.concatenate([vertices[:, :2] / 16 + 0.05, vertices[:, :2] / 16 + [0.55, 0.05]])
    parameterization = decimate(Mesh(vertices, faces, uv=uv, uv_faces=faces + len(vertices) * right[:, None]),
                                n_faces=40, strategy="random")
    row, column = np.mgrid[:128, :128]
    x = ((column + 0.5) / 128 - np.where(column < 64, 0.05, 0.55)) * 16
    y = (1 - (row + 0.5) / 128 - 0.05) * 16
    texture = np.round(np.clip(np.stack([40 + 30 * x, 40 + 30 * y, 200 - 20 * x - 20 * y], axis=-1), 0, 255))
    image, uv, uv_faces = parameterization.bake(texture.astype(np.uint8), LEVELS)
    crosses = parameterization.transfer_corners(parameterization.fine.uv, parameterization.fine.uv_faces, LEVELS)[2]
    assert crosses.any()
    inner, at, barycentric = inner_points(parameterization)
    points = weighted(vertices, faces[at[crosses].ravel()], barycentric[crosses].reshape(-1, 3))
    shown = sample_texture(image, (inner @ uv[uv_faces[crosses]]).reshape(-1, 2))
    x, y = points[:, 0], points[:, 1]
    error = np.abs(shown - np.stack([40 + 30 * x, 40 + 30 * y, 200 - 20 * x - 20 * y], axis=-1))
    assert np.quantile(error, 0.99) <= 1
    assert error.max() < 3  # the map is affine in pieces; a texel may have the joint of two


def test_other_faces_keep_their_texels(box, baked):
    image, uv, uv_faces = baked
    texture = box_texture(box.fine)
    height, width, _ = texture.shape
    assert np.array_equal(image[MARGIN : MARGIN + height, MARGIN : MARGIN + width], texture)
    old, old_faces, crosses = box.transfer_corners(box.fine.uv, box.fine.uv_faces, LEVELS)
    texel = (uv * [1, -1] + [0, 1]) * [image.shape[1], image.shape[0]] - MARGIN
    expected = (old * [1, -1] + [0, 1]) * [width, height]
    assert np.allclose(texel[uv_faces[~crosses]], expected[old_faces[~crosses]], atol=1e-9)


def test_patches_do_not_touch_and_lie_in_the_image(box, baked):
    image, uv, uv_faces = baked
    crosses = box.transfer_corners(box.fine.uv, box.fine.uv_faces, LEVELS)[2]
    corners = (uv[uv_faces[crosses]] * [1, -1] + [0, 1]) * [image.shape[1], image.shape[0]]
    assert (corners > 1).all() and (corners < [image.shape[1] - 1, image.shape[0] - 1]).all()
    inner = np.random.default_rng(0).dirichlet([1, 1, 1], 300)
    texels = np.floor(inner @ corners - 0.5).astype(int)
    owner = np.full(image.shape[:2], -1)
    for face, places in enumerate(texels):
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            known = owner[places[:, 1] + dy, places[:, 0] + dx]
            assert ((known == -1) | (known == face)).all()
            owner[places[:, 1] + dy, places[:, 0] + dx] = face


def test_orientation_of_the_texture_is_kept(box, baked):
    """So that normal maps stay right: patches are not mirrored."""
    _, uv, uv_faces = baked
    crosses = box.transfer_corners(box.fine.uv, box.fine.uv_faces, LEVELS)[2]
    (a, b, c) = uv[uv_faces[crosses]].transpose(1, 0, 2)
    assert (np.cross(np.pad(b - a, ((0, 0), (0, 1))), np.pad(c - a, ((0, 0), (0, 1))))[:, 2] > 0).all()


def test_without_crossings_the_texture_comes_back(patch):
    fine = Mesh(patch.fine.vertices, patch.fine.faces, uv=patch.fine.vertices[:, :2] / 4, uv_faces=patch.fine.faces)
    texture = np.random.default_rng(0).integers(0, 256, (8, 8, 4), dtype=np.uint8)
    image, uv, uv_faces = replace(patch, fine=fine).bake(texture, 1)
    assert np.array_equal(image, texture)
    assert np.allclose(uv[uv_faces], images(patch, 1)[refined(patch, 1).faces][..., :2] / 4)


def test_a_texture_that_repeats_is_found_again(patch):
    """UVs from 0 to 5: faces within a repetition keep texels, those over its border get a patch."""
    fine = Mesh(patch.fine.vertices, patch.fine.faces, uv=patch.fine.vertices[:, :2] * 1.25, uv_faces=patch.fine.faces)
    wave = np.round(127 + 100 * np.sin(2 * np.pi * (np.arange(64) + 0.5) / 64))
    texture = np.stack(np.broadcast_arrays(wave[None, :], wave[::-1, None], 9.0), axis=-1).astype(np.uint8)
    image, uv, uv_faces = replace(patch, fine=fine).bake(texture, 3, density=2)
    assert uv.min() >= 0 and uv.max() <= 1 and len(image) > 64 + 2 * MARGIN
    shown = sample_texture(image, uv[uv_faces].reshape(-1, 2))
    position = images(patch, 3)[refined(patch, 3).faces].reshape(-1, 3) * 1.25
    expected = 127 + 100 * np.sin(2 * np.pi * position[:, :2])
    assert np.abs(shown[:, :2] - expected).max() < 1 + 100 * (2 * np.pi / 64) ** 2  # linear between samples of a sine


def test_files_and_alpha(box, baked):
    texture = box_texture(box.fine)
    assert np.array_equal(box.bake(png_bytes(texture), LEVELS)[0], baked[0])
    clear = np.dstack([texture, np.full(texture.shape[:2], 77, dtype=np.uint8)])
    image = box.bake(png_bytes(clear), LEVELS)[0]
    assert np.array_equal(image[..., :3], baked[0]) and (image[..., 3] == 77).all()
    grey = Image.fromarray(texture[..., 0])
    file = BytesIO()
    grey.save(file, format="PNG")
    assert box.bake(file.getvalue(), 0)[0].shape[2] == 3


# --- errors ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("change", "message"), [
    (lambda uv, faces: (uv, faces[:-1]), r"uv_faces \(767, 3\)"),
    (lambda uv, faces: (uv[:, 0], faces), r"uv \("),
    (lambda uv, faces: (uv, faces * 1.0), "float64"),
    (lambda uv, faces: (uv[:-1], faces), "but uv has"),
    (lambda uv, faces: (np.where(uv == uv[7], np.nan, uv), faces), r"uv \d+ is \[.*nan"),
])  # fmt: skip
def test_signals_that_do_not_fit_are_refused(box, change, message):
    with pytest.raises(ParameterizationError, match=message):
        box.transfer_corners(*change(box.fine.uv, box.fine.uv_faces))


@pytest.mark.parametrize(("texture", "message"), [
    (np.zeros((4, 4), np.uint8), r"shape \(4, 4\)"),
    (np.zeros((4, 4, 3)), "float64"),
    (np.zeros((0, 4, 3), np.uint8), r"\(0, 4, 3\)"),
    (b"not a picture", "no image"),
])  # fmt: skip
def test_textures_that_are_none_are_refused(box, texture, message):
    with pytest.raises(ParameterizationError, match=message):
        box.bake(texture)


def test_other_bad_words_are_refused(box, patch):
    texture = np.zeros((4, 4, 3), np.uint8)
    with pytest.raises(ParameterizationError, match="no UVs"):
        patch.bake(texture)
    with pytest.raises(ParameterizationError, match="density = 0"):
        box.bake(texture, density=0)
    for call in (lambda: box.bake(texture, -1), lambda: box.report(-1),
                 lambda: box.transfer_corners(box.fine.uv, box.fine.uv_faces, -1)):
        with pytest.raises(ParameterizationError, match="levels = -1"):
            call()
