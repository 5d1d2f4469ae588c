"""Pictures of meshes as PNG files, drawn off-screen (no display is needed)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from io import BytesIO
from math import ceil, log
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from neusub.errors import MeshFileError
from neusub.files import replacing
from neusub.mesh import Mesh
from neusub.raw import base_picture, face_materials

if TYPE_CHECKING:
    import pyvista

__all__ = ["render"]

CLAY = "#dfe3ea"
EDGE = "#4a5568"
MEASURED_FACES = 20_000  # pieces of a mesh at least, whose distances are drawn
CAMERA = (0.9, 0.45, 1.2)  # from where it looks, with y up: right, above, in front


def render(
    meshes: Mesh | Sequence[Mesh],
    path: str | Path,
    *,
    titles: Sequence[str] | None = None,
    smooth: bool = False,
    wireframe: bool = False,
    reference: Mesh | None = None,
    columns: int | None = None,
    panel: tuple[int, int] = (480, 400),
    camera: tuple[float, float, float] = CAMERA,
    up: tuple[float, float, float] = (0, 1, 0),
) -> Path:
    """Draw meshes side by side, each seen from the same side; the path of the PNG.

    titles: a line below each.  smooth: smooth shading instead of flat.  wireframe: draw the edges.  reference: colour
    by the distance to it, within the faces too, one colour bar for all, in the meshes' unit.  columns: panels in a row
    (all by default).  panel: width and height of a panel in pixels.  camera, up: direction to the eye and upwards.
    The panels of a row frame the same box, that of the row's first mesh, so that shrinking shows; a mesh that lies
    elsewhere, or is more than twice as large, has its own.
    Raises MeshFileError where the file cannot be written or a texture not read; ValueError for no meshes, titles of
    another number, or a camera along `up`.
    """
    meshes = [meshes] if isinstance(meshes, Mesh) else list(meshes)
    if not meshes or (titles is not None and len(titles) != len(meshes)):
        raise ValueError(f"{len(meshes)} meshes and {len(titles or [])} titles: give at least one mesh, a title each.")
    if columns is not None and columns < 1:
        raise ValueError(f"columns = {columns}: give at least one.")
    if np.linalg.norm(np.cross(camera, up)) < 1e-9:
        raise ValueError(f"camera {camera} looks along up {up}: choose another up.")
    columns = columns or len(meshes)
    rows = -(-len(meshes) // columns)
    bar_height = 70 if reference is not None else 0
    errors = [None if reference is None else _errors(mesh, reference) for mesh in meshes]
    top = max((float(np.percentile(error, 99)) for _, error in filter(None, errors)), default=0.0)
    if reference is not None:  # rounding has no colour
        top = max(top, 1e-9 * float(np.linalg.norm(np.ptp(reference.vertices, axis=0))))
    with replacing(path) as new:
        with off_screen(panel[0] * columns, panel[1] * rows, shape=(rows, columns), border=False) as plotter:
            for k, (mesh, error) in enumerate(zip(meshes, errors)):
                plotter.subplot(k // columns, k % columns)
                _draw(plotter, mesh, error, top, smooth, wireframe)
                if titles is not None:
                    plotter.add_text(titles[k], position="lower_edge", font_size=9, color="black")
                first = meshes[k - k % columns]
                aim_camera(plotter, first if _share_a_frame(first, mesh) else mesh, camera, up, panel)
            picture = plotter.screenshot(return_img=True)
        _write_png(np.asarray(picture), new, top, bar_height)
    return Path(path)


@contextmanager
def off_screen(width: int, height: int, **options: Any) -> Iterator[pyvista.Plotter]:
    """A plotter that needs no display.  Where there is none VTK warns, before it takes another way to draw."""
    import pyvista
    from vtkmodules.vtkCommonCore import vtkLogger

    verbosity = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
    try:
        with closing(pyvista.Plotter(off_screen=True, window_size=[width, height], **options)) as plotter:
            yield plotter
    finally:
        vtkLogger.SetStderrVerbosity(verbosity)


def _errors(mesh: Mesh, reference: Mesh) -> tuple[Mesh, np.ndarray]:
    """The mesh with points within its faces, and each point's distance: vertices may lie on the reference alone."""
    from neusub.metrics import point_distance
    from neusub.schemes import subdivide_classic

    levels = max(0, ceil(log(MEASURED_FACES / len(mesh.faces), 4)))
    fine = subdivide_classic(mesh, "midpoint", levels)[-1]
    return fine, point_distance(fine.vertices, reference)[0]


def _share_a_frame(first: Mesh, mesh: Mesh) -> bool:
    """Whether the boxes meet and are of like size; a mesh elsewhere, or a giant, is framed by itself."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    meet = (first.vertices.min(axis=0) <= high) & (low <= first.vertices.max(axis=0))
    return bool(meet.all() and np.linalg.norm(high - low) <= 2 * np.linalg.norm(np.ptp(first.vertices, axis=0)))


def _draw(plotter: pyvista.Plotter, mesh: Mesh, error: tuple[Mesh, np.ndarray] | None, top: float, smooth: bool,
          wireframe: bool) -> None:
    """Add one mesh to the current panel."""
    import pyvista

    look: dict[str, Any] = {"smooth_shading": smooth, "show_edges": wireframe, "edge_color": EDGE, "line_width": 1,
                            "ambient": 0.25, "diffuse": 0.75, "specular": 0.1, "show_scalar_bar": False}
    if error is not None:
        fine, distances = error
        plotter.add_mesh(pyvista.PolyData.from_regular_faces(fine.vertices, fine.faces), scalars=distances,
                         cmap="viridis", clim=(0, top or 1), **{**look, "show_edges": False})
        if wireframe:
            plotter.add_mesh(pyvista.PolyData.from_regular_faces(mesh.vertices, mesh.faces), style="wireframe",
                             color=EDGE, line_width=1, lighting=False)
    else:
        _draw_materials(plotter, mesh, look)
    plotter.set_background("white")  # type: ignore[arg-type]


def _draw_materials(plotter: pyvista.Plotter, mesh: Mesh, look: dict[str, Any]) -> None:
    """Each face with its texture, or else its vertices' colours, or else its material's."""
    import pyvista
    from matplotlib.colors import to_rgb

    material = face_materials(mesh)
    pictures = {k: base_picture(m) for k, m in enumerate(mesh.materials) if mesh.uv is not None}
    is_plain = np.ones(len(mesh.faces), dtype=bool)
    for k, picture in pictures.items():
        chosen = material == k
        if picture is not None and chosen.any():
            is_plain &= ~chosen
            plotter.add_mesh(_with_uv(mesh, chosen), texture=_texture(*picture), **look)
    if not is_plain.any():
        return
    data = pyvista.PolyData.from_regular_faces(mesh.vertices, mesh.faces[is_plain])
    if mesh.colors is not None:
        plotter.add_mesh(data, scalars=np.clip(mesh.colors[:, :3], 0, 1), rgb=True, preference="point", **look)
    else:
        clay = to_rgb(CLAY)
        palette = np.array([*(m.color[:3] if m.color else clay for m in mesh.materials), clay])  # the last: no material
        colors = np.clip(palette[material[is_plain]], 0, 1)
        plotter.add_mesh(data, scalars=colors, rgb=True, preference="cell", **look)


def _with_uv(mesh: Mesh, chosen: np.ndarray) -> pyvista.PolyData:
    """The chosen faces, each texture vertex being a point of its own, as the renderer has one UV a point."""
    import pyvista

    assert mesh.uv is not None and mesh.uv_faces is not None
    pairs = np.stack([mesh.faces[chosen].reshape(-1), mesh.uv_faces[chosen].reshape(-1)], axis=1)
    unique, corner = np.unique(pairs, axis=0, return_inverse=True)
    data = pyvista.PolyData.from_regular_faces(mesh.vertices[unique[:, 0]], corner.reshape(-1, 3))
    data.active_texture_coordinates = mesh.uv[unique[:, 1]]
    return data


def _texture(name: str, content: bytes) -> pyvista.Texture:
    import pyvista
    from PIL import Image, UnidentifiedImageError

    try:
        image = np.asarray(Image.open(BytesIO(content)).convert("RGB"))
    except UnidentifiedImageError:
        raise MeshFileError(f"the texture {name} is no image that can be read. Replace it.") from None
    return pyvista.Texture(image)  # type: ignore[arg-type]


def aim_camera(plotter: pyvista.Plotter, mesh: Mesh, camera: tuple, up: tuple, panel: tuple[int, int]) -> None:
    """Look at the mesh's box from the camera's direction, the box just inside the panel."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    centre = (low + high) / 2
    direction = np.asarray(camera) / np.linalg.norm(camera)
    radius = np.linalg.norm(mesh.vertices - centre, axis=1).max() or 1.0
    distance = 4 * radius
    plotter.camera.position = tuple(centre + distance * direction)
    plotter.camera.focal_point = tuple(centre)
    plotter.camera.up = up
    right = np.cross(up, direction)
    right /= np.linalg.norm(right)
    above = np.cross(direction, right)
    offset = mesh.vertices - centre
    depth = distance - offset @ direction
    half = max((np.abs(offset @ above) / depth).max(), (np.abs(offset @ right) / depth).max() * panel[1] / panel[0])
    plotter.camera.view_angle = float(np.degrees(2 * np.arctan(1.2 * half)))
    plotter.camera.clipping_range = (0.01 * distance, 3 * distance)  # a mesh twice as large may come close


def _write_png(picture: np.ndarray, path: Path, top: float, bar_height: int) -> None:
    """The picture, with a colour bar below where there is one."""
    from PIL import Image

    image = Image.fromarray(picture)
    if bar_height:
        whole = Image.new("RGB", (image.width, image.height + bar_height), "white")
        whole.paste(image, (0, 0))
        bar = _colour_bar(image.width, bar_height, top)
        whole.paste(bar, (0, image.height))
        image = whole
    image.save(path, format="PNG")


def _colour_bar(width: int, height: int, top: float) -> Any:
    """The scale of the heat map, from 0 to the 99th percentile of the largest panel."""
    from matplotlib.colorbar import ColorbarBase
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from PIL import Image

    figure = Figure(figsize=(width / 100, height / 100), dpi=100)
    axes = figure.add_axes((0.2, 0.6, 0.6, 0.25))
    bar = ColorbarBase(axes, cmap="viridis", norm=Normalize(0, top or 1), orientation="horizontal", extend="max")
    bar.set_label("distance to the reference (mesh units)", fontsize=8)
    axes.tick_params(labelsize=8)
    file = BytesIO()
    figure.savefig(file, format="png")
    return Image.open(file).convert("RGB")
