"""A picture of a map: which part of the fine surface each coarse face covers, how the map distorts, one collapse."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int64, UInt8
from numpy import ndarray

from neusub.errors import ParameterizationError
from neusub.files import replacing
from neusub.mesh import Mesh
from neusub.metrics import face_normals, triangle_quality
from neusub.pictures import CAMERA, EDGE, aim_camera, off_screen
from neusub.selfparam.mapping import BEFORE, MADE, UV
from neusub.selfparam.parameterization import SelfParameterization, refinement, weighted
from neusub.topology import build_topology

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "Surface", "View", "checkerboard", "coloured_fine", "edge_images", "face_colors", "levels_within", "render_map",
    "surface_picture",
]

DETAIL = 3  # small faces for each pixel of a panel, at most: surfaces are split so that borders of colours are crisp
STEPS = 48  # straight pieces in the image of a coarse edge
LIFT = 0.0005  # of the diagonal: how far lines stand out, so that the surface does not hide them
CANDIDATES = 400  # charts that are looked at for a good one to show
TITLE = 30  # pixels below a panel
DOTS = 100  # per inch
DARK, LIGHT = (76, 103, 153), (246, 241, 228)  # the checkerboard
GONE = "#4a5568"  # faces that vanish in a collapse
RED = "#c0392b"  # the edge that collapses, and the merged vertex


def render_map(
    parameterization: SelfParameterization,
    path: str | Path,
    *,
    collapse: int | None = None,
    checks: int = 2,
    panel: tuple[int, int] = (640, 520),
    camera: tuple[float, float, float] = CAMERA,
    up: tuple[float, float, float] = (0, 1, 0),
) -> Path:
    """Draw a map as one PNG of 2 x 2 panels, off-screen; the path.

    Coarse and fine mesh, both coloured by coarse face; a checkerboard, the triangles of the coarse mesh's `checks`-th
    refinement, on the fine surface; the flat chart of one collapse, before and after.
    collapse: which one, counted from the first; by default a late one whose ring is well shaped.
    panel: width and height in pixels.  camera, up: direction to the eye and upwards.
    Raises: ParameterizationError for a collapse that there is not, and for negative checks; MeshFileError where the
    file cannot be written; ValueError for a camera along `up`.
    """
    check_words(parameterization, collapse, checks, camera, up)
    coarse = parameterization.coarse
    colors = face_colors(coarse.faces, len(coarse.vertices))
    view, most = View(parameterization.fine, panel, camera, up), DETAIL * panel[0] * panel[1]
    titles = [
        f"coarse mesh, {len(coarse.faces):,} faces",
        f"fine mesh, {len(parameterization.fine.faces):,} faces, coloured by coarse face",
        "checkerboard of the coarse triangles on the fine surface",
    ]
    with replacing(path) as new:
        pictures = [
            surface_picture(Surface(coarse.vertices, coarse.faces, colors), view, wireframe=True),
            surface_picture(coloured_fine(parameterization, colors, most), view, edge_images(parameterization)),
            surface_picture(checkerboard(parameterization, checks, most), view),
        ]
        figure = composed(pictures, titles, panel)
        add_chart(figure, parameterization, usual_chart(parameterization) if collapse is None else collapse)
        figure.savefig(new, format="png", dpi=DOTS)
    return Path(path)


def check_words(
    parameterization: SelfParameterization, collapse: int | None, checks: int, camera: tuple, up: tuple
) -> None:
    n_charts = int(parameterization.charts.used[0])
    if collapse is not None and not 0 <= collapse < n_charts:
        raise ParameterizationError(f"collapse = {collapse}: the map has {n_charts} steps, counted from 0.")
    if checks < 0:
        raise ParameterizationError(f"checks = {checks}: take 0 or more.")
    if np.linalg.norm(np.cross(camera, up)) < 1e-9:
        raise ValueError(f"camera {camera} looks along up {up}: choose another up.")


# --- what surfaces show ------------------------------------------------------------------------------------------


class Surface(NamedTuple):
    """What a panel shows."""

    vertices: ndarray  # (n, 3) float64
    faces: ndarray  # (m, 3) int64
    colors: ndarray  # (m, 3) uint8


class View(NamedTuple):
    """How it is seen; all panels frame the same mesh."""

    frame: Mesh
    panel: tuple[int, int]
    camera: tuple[float, float, float]
    up: tuple[float, float, float]


def face_colors(faces: Int64[ndarray, "nF 3"], n_vertices: int) -> UInt8[ndarray, "nF 3"]:
    """A colour for each face, another than its neighbours': across edges always, around vertices where possible."""
    from matplotlib import colormaps

    palette = np.array([*colormaps["Set3"].colors, *colormaps["Set2"].colors])  # type: ignore[attr-defined]
    rng = np.random.default_rng(0)
    twins = build_topology(faces, n_vertices).twins.reshape(-1, 3)
    around = np.zeros((n_vertices, len(palette)), dtype=np.int64)  # faces of each colour at each vertex
    chosen = np.full(len(faces) + 1, -1)  # the last one for faces that there are not
    for f in rng.permutation(len(faces)):
        cost = around[faces[f]].sum(axis=0) + rng.random(len(palette))
        across = chosen[np.where(twins[f] < 0, len(faces), twins[f] // 3)]
        cost[across[across >= 0]] += 1000
        chosen[f] = np.argmin(cost)
        around[faces[f], chosen[f]] += 1
    return np.round(255 * palette[chosen[:-1]]).astype(np.uint8)


def levels_within(n_faces: int, most: int) -> int:
    """How often so many faces can be split into four before there are too many."""
    return max(0, int(np.log(most / n_faces) / np.log(4)))


def coloured_fine(parameterization: SelfParameterization, colors: ndarray, most: int) -> Surface:
    """The fine surface in up to `most` small faces, each with the colour of the coarse face that has its centroid."""
    fine = parameterization.fine
    parts = refinement(fine.faces, len(fine.vertices), levels_within(len(fine.faces), most))
    owner, _ = parameterization.to_coarse(parts.owner, parts.corners.mean(axis=1))
    return Surface(weighted(fine.vertices, fine.faces[parts.at], parts.barycentric), parts.faces, colors[owner])


def checkerboard(parameterization: SelfParameterization, checks: int, most: int) -> Surface:
    """A refinement on the fine surface; dark where the triangle of level `checks` stands upside down.

    Where that leaves fewer than `most` faces, they are split further, to follow the surface.
    """
    n_faces = len(parameterization.faces)
    levels = max(checks, levels_within(n_faces, most))
    parts = refinement(parameterization.faces, len(parameterization.decimated), levels)
    is_dark = np.zeros(n_faces, dtype=bool)
    for level in range(levels):
        is_dark = np.concatenate([is_dark] * 3 + [~is_dark if level < checks else is_dark])
    points = parameterization.points(*parameterization.to_fine(parts.at, parts.barycentric))
    return Surface(points, parts.faces, np.where(is_dark[:, None], DARK, LIGHT).astype(np.uint8))


def edge_images(parameterization: SelfParameterization) -> Float64[ndarray, "nE steps 3"]:
    """The coarse edges on the fine surface, a little above it."""
    fine, topology = parameterization.fine, parameterization.coarse.topology
    halfedge = np.repeat(topology.edge_halfedges.max(axis=1), STEPS + 1)
    t = np.tile(np.linspace(0, 1, STEPS + 1), len(topology.edges))
    barycentric, row = np.zeros((len(t), 3)), np.arange(len(t))
    barycentric[row, halfedge % 3], barycentric[row, (halfedge + 1) % 3] = 1 - t, t
    at, barycentric = parameterization.to_fine(halfedge // 3, barycentric)
    lift = LIFT * np.linalg.norm(np.ptp(fine.vertices, axis=0))
    return (parameterization.points(at, barycentric) + lift * face_normals(fine)[at]).reshape(-1, STEPS + 1, 3)


def surface_picture(
    surface: Surface, view: View, lines: Float64[ndarray, "n steps 3"] | None = None, *, wireframe: bool = False
) -> UInt8[ndarray, "h w 3"]:
    """One panel: faces in their colours, with lines, or with the faces' own edges."""
    import pyvista
    from PIL import Image

    data = pyvista.PolyData.from_regular_faces(surface.vertices, surface.faces)
    data.cell_data["color"] = surface.colors
    look: dict[str, Any] = {"show_edges": wireframe, "edge_color": EDGE, "line_width": 2, "ambient": 0.4,
                            "diffuse": 0.65, "specular": 0.05}
    with off_screen(*(2 * n for n in view.panel)) as plotter:  # reduced below: smooth edges
        plotter.add_mesh(data, scalars="color", rgb=True, **look)
        if lines is not None:
            n, steps, _ = lines.shape
            cells = np.concatenate([np.full((n, 1), steps), np.arange(n * steps).reshape(n, steps)], axis=1)
            plotter.add_mesh(pyvista.PolyData(lines.reshape(-1, 3), lines=cells.reshape(-1)), color=EDGE, line_width=2,
                             lighting=False)
        plotter.set_background("white")  # type: ignore[arg-type]
        aim_camera(plotter, view.frame, view.camera, view.up, view.panel)
        picture = Image.fromarray(np.asarray(plotter.screenshot(return_img=True)))
    return np.asarray(picture.reduce(2).convert("RGB"))


def composed(pictures: list[ndarray], titles: list[str], panel: tuple[int, int]) -> Figure:
    """The panels in a figure of 2 x 2, with room for the fourth."""
    from matplotlib.figure import Figure

    width, height = panel[0], panel[1] + TITLE
    figure = Figure(figsize=(2 * width / DOTS, 2 * height / DOTS), dpi=DOTS, facecolor="white")
    for k, (picture, title) in enumerate(zip(pictures, titles)):
        x, y = k % 2 * width, (1 - k // 2) * height
        figure.figimage(picture[::-1], x, y + TITLE, origin="lower")
        figure.text((x + width / 2) / (2 * width), (y + TITLE / 2) / (2 * height), title, ha="center", va="center",
                    fontsize=10)
    return figure


# --- one collapse in the plane -----------------------------------------------------------------------------------


def chart_faces(parameterization: SelfParameterization, c: int, is_after: bool) -> tuple[ndarray, ndarray]:
    """Corners (n, 3) of the faces of chart c, local indices as in `mapping.py`; and which one of the others each has
    most in common with."""
    charts = parameterization.charts
    if is_after:
        begin, end = charts.starts[c : c + 2, MADE] - charts.starts[0, MADE]
        rows = charts.after[begin:end].astype(np.int64)
    else:
        rows = charts.before[slice(*charts.starts[c : c + 2, BEFORE])].astype(np.int64)
    return rows[:, :3], rows[:, 3]


def inner_vertices(parameterization: SelfParameterization, c: int) -> tuple[ndarray, ndarray]:
    """Local vertices of chart c that vanish, j and k of a collapse, and that appear, the merged one."""
    before, after = (chart_faces(parameterization, c, is_after)[0] for is_after in (False, True))
    return np.setdiff1d(before, after), np.setdiff1d(after, before)


def chart_uv(parameterization: SelfParameterization, c: int) -> Float64[ndarray, "n 2"]:
    """Places of the local vertices; j -> k along the x axis."""
    uv = parameterization.charts.uv[slice(*parameterization.charts.starts[c : c + 2, UV])]
    ends = uv[inner_vertices(parameterization, c)[0]]
    along = ends[-1] - ends[0]
    length = np.linalg.norm(along)
    x, y = along / length if length > 0 else (1.0, 0.0)
    return (uv - ends.mean(axis=0)) @ np.array([[x, -y], [y, x]])


def usual_chart(parameterization: SelfParameterization) -> int:
    """Of the last charts the one with the best worst triangle; rings without boundary and of 8 or more first."""
    last, best, best_score = int(parameterization.charts.used[0]), -1, -np.inf
    for c in range(max(0, last - CANDIDATES), last):
        uv = chart_uv(parameterization, c)
        before, after = (chart_faces(parameterization, c, is_after)[0] for is_after in (False, True))
        solid = np.column_stack([uv, np.zeros(len(uv))])
        is_inner = len(before) == len(after) + 2
        score = triangle_quality(solid, np.concatenate([before, after])).min() + is_inner + (len(after) >= 8)
        if score > best_score:
            best, best_score = c, score
    return best


def add_chart(figure: Figure, parameterization: SelfParameterization, c: int) -> None:
    """Draw chart c into the figure's fourth panel, before and after; -1 is none."""
    gone, new = inner_vertices(parameterization, c) if c >= 0 else ([], [])
    word = "collapse" if len(gone) != 1 else "slide" if len(new) == 1 else "removal"
    title = f"{word} {c:,} in the plane: before and after" if c >= 0 else "no collapse"
    height = figure.get_size_inches()[1] * DOTS
    figure.text(0.75, TITLE / 2 / height, title, ha="center", va="center", fontsize=10)
    if c < 0:
        return
    uv = chart_uv(parameterization, c)
    low, high = uv.min(axis=0), uv.max(axis=0)
    border = 0.08 * (high - low).max()
    for k, is_after in enumerate((False, True)):
        axes = figure.add_axes((0.505 + 0.25 * k, 1.5 * TITLE / height, 0.24, 0.5 - 2 * TITLE / height))
        draw_chart(axes, parameterization, c, is_after)
        axes.set(xlim=(low[0] - border, high[0] + border), ylim=(low[1] - border, high[1] + border), aspect="equal")
        axes.axis("off")


def draw_chart(axes: Axes, parameterization: SelfParameterization, c: int, is_after: bool) -> None:
    """The faces of chart c in the plane; two that have most in common with each other have the same colour."""
    from matplotlib import colormaps
    from matplotlib.patheffects import withStroke

    uv = chart_uv(parameterization, c)
    corners, partner = chart_faces(parameterization, c, is_after)
    vanishes = chart_faces(parameterization, c, not is_after)[1][partner] != np.arange(len(partner))
    for t, face in enumerate(corners):
        is_gone = vanishes[t] and not is_after
        color = GONE if is_gone else colormaps["Set3"](int(t if is_after else partner[t]) % 12)
        axes.fill(*uv[face].T, facecolor=color, edgecolor=EDGE, linewidth=1.2, alpha=0.55 if is_gone else 1)
    inner = inner_vertices(parameterization, c)[is_after]
    if len(inner) == 2:
        axes.plot(*uv[inner].T, color=RED, linewidth=3, solid_capstyle="round")
    shown = np.unique(corners)
    is_inner = np.isin(shown, inner)
    axes.scatter(*uv[shown].T, s=np.where(is_inner, 60, 18), color=np.where(is_inner, RED, EDGE), zorder=3)
    for name, v in zip("jk" if len(inner) == 2 else "i", inner):
        axes.annotate(name, tuple(uv[v]), xytext=(0, 9), textcoords="offset points", ha="center", fontsize=13,
                      style="italic", zorder=4, path_effects=[withStroke(linewidth=3, foreground="white")])
