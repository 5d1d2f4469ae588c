"""Pictures of a map show every panel, and what they show is the map."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

import shapes
from neusub.errors import MeshFileError, ParameterizationError
from neusub.map_pictures import (
    DARK,
    TITLE,
    add_chart,
    chart_faces,
    chart_uv,
    checkerboard,
    coloured_fine,
    face_colors,
    render_map,
)
from neusub.mesh import Mesh
from neusub.selfparam import SelfParameterization, decimate

PANEL = (160, 120)


@pytest.fixture(scope="module")
def ball() -> SelfParameterization:
    return decimate(Mesh(*shapes.bumpy(shapes.icosphere(3))), n_faces=80)


@pytest.fixture(scope="module")
def dome() -> SelfParameterization:
    vertices, faces = shapes.refined(shapes.cone(8), 3)
    return decimate(Mesh(vertices, faces), n_faces=60, strategy="random")


def panels(path) -> list[np.ndarray]:
    pixels = np.asarray(Image.open(path).convert("RGB")).astype(int)
    (width, height), whole = PANEL, PANEL[1] + TITLE
    assert pixels.shape == (2 * whole, 2 * width, 3)
    return [pixels[y : y + height, x : x + width] for y in (0, whole) for x in (0, width)]


@pytest.mark.parametrize("name", ["ball", "dome"])
def test_every_panel_shows_something(name, request, tmp_path):
    path = render_map(request.getfixturevalue(name), tmp_path / "map.png", panel=PANEL)
    for panel in panels(path):
        assert 0.1 < (panel < 250).any(axis=-1).mean() < 0.9
        assert len(np.unique(panel.reshape(-1, 3), axis=0)) > 20


def test_a_map_without_collapse_has_no_chart_to_show(tmp_path):
    mesh = Mesh(*shapes.icosahedron())
    *surfaces, chart = panels(render_map(decimate(mesh, n_faces=20), tmp_path / "map.png", panel=PANEL))
    assert all((panel < 250).any() for panel in surfaces)
    assert (chart == 255).all()


def test_neighbouring_faces_differ_in_colour(ball):
    colors = face_colors(ball.faces, len(ball.decimated))
    twins = ball.coarse.topology.twins
    assert (colors[np.arange(len(twins)) // 3] != colors[twins // 3]).any(axis=1).all()


def test_the_fine_mesh_has_the_colours_of_the_map(ball):
    colors = np.arange(3 * len(ball.faces)).reshape(-1, 3)  # all different
    surface = coloured_fine(ball, colors, 20_000)
    assert np.array_equal(np.unique(surface.colors, axis=0), colors)  # every coarse face covers something
    mesh = Mesh(*shapes.icosahedron())
    surface = coloured_fine(decimate(mesh, n_faces=20), colors[:20], 1000)
    normals = np.cross(*(surface.vertices[surface.faces[:, k]] - surface.vertices[surface.faces[:, 0]] for k in (1, 2)))
    own = np.cross(*(mesh.vertices[mesh.faces[:, k]] - mesh.vertices[mesh.faces[:, 0]] for k in (1, 2)))
    cosine = (normals * own[surface.colors[:, 0] // 3]).sum(axis=1)
    assert (cosine > 0.999 * np.linalg.norm(normals, axis=1) * np.linalg.norm(own[0])).all()


@pytest.mark.parametrize(("checks", "share"), [(0, 0), (1, 1 / 4), (2, 6 / 16)])
def test_the_checkerboard_is_dark_where_triangles_stand_upside_down(ball, checks, share):
    assert (checkerboard(ball, checks, 10_000).colors == DARK).all(axis=1).mean() == share


@pytest.mark.parametrize("name", ["ball", "dome"])
def test_a_chart_covers_the_same_ground_before_and_after(name, request):
    parameterization = request.getfixturevalue(name)
    for c in range(int(parameterization.charts.used[0])):
        uv = chart_uv(parameterization, c)
        area = [0.0, 0.0]
        for is_after in (False, True):
            (x1, y1), (x2, y2), (x3, y3) = uv[chart_faces(parameterization, c, is_after)[0]].transpose(1, 2, 0)
            area[is_after] = ((x2 - x1) * (y3 - y1) - (y2 - y1) * (x3 - x1)).sum()
        assert area[0] > 0 and np.isclose(*area, rtol=1e-9)


def test_bad_words_are_refused_and_leave_nothing_behind(ball, tmp_path):
    n_charts = int(ball.charts.used[0])
    for collapse in (-1, n_charts):
        with pytest.raises(ParameterizationError, match=f"collapse = {collapse}: the map has {n_charts}"):
            render_map(ball, tmp_path / "map.png", collapse=collapse)
    with pytest.raises(ValueError, match="looks along up"):
        render_map(ball, tmp_path / "map.png", camera=(0, 2, 0))
    with pytest.raises(ParameterizationError, match="checks = -1"):
        render_map(ball, tmp_path / "map.png", checks=-1)
    with pytest.raises(MeshFileError, match="does not exist"):
        render_map(ball, tmp_path / "no" / "map.png", panel=PANEL)
    assert list(tmp_path.iterdir()) == []


def test_slides_are_drawn_as_such(tmp_path):
    result = decimate(Mesh(*shapes.bumpy(shapes.icosphere(4))), n_faces=100)
    fitted, figure = result.fitted(), Figure()
    last = int(fitted.charts.used[0]) - 1
    assert last > int(result.charts.used[0])
    add_chart(figure, fitted, last)
    assert figure.texts[0].get_text() == f"slide {last:,} in the plane: before and after"
    assert render_map(fitted, tmp_path / "map.png", collapse=last, panel=PANEL).exists()
