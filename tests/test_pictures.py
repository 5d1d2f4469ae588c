"""Pictures are there, of the right size, and show something."""

import os
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

import neusub
import shapes
from neusub.errors import MeshFileError
from neusub.mesh import Material, Mesh
from test_io import _picture


def ball(radius: float = 1.0) -> Mesh:
    vertices, faces = shapes.icosphere(2)
    return Mesh(radius * vertices, faces)


def drawn(path) -> np.ndarray:
    """Which pixels are not white."""
    return (np.asarray(Image.open(path).convert("RGB")) < 250).any(axis=-1)


def test_each_mesh_gets_a_panel(tmp_path):
    path = neusub.render([ball(), ball()], tmp_path / "two.png", panel=(200, 160), titles=["one", "two"])
    pixels = drawn(path)
    assert pixels.shape == (160, 400)
    for half in (pixels[:, :200], pixels[:, 200:]):
        assert 0.1 < half.mean() < 0.9


def test_a_smaller_result_looks_smaller_beside_its_input(tmp_path):
    pixels = drawn(neusub.render([ball(), ball(0.5)], tmp_path / "two.png", panel=(200, 200)))
    assert pixels[:, 200:].sum() < 0.4 * pixels[:, :200].sum()


@pytest.mark.parametrize("size, share", [(1.9, 1.0), (5.0, 0.4)])
def test_a_larger_result_fills_its_panel_or_has_a_frame_of_its_own(tmp_path, size, share):
    panel = drawn(neusub.render([ball(), ball(size)], tmp_path / "two.png", panel=(200, 200)))[:, 200:]
    assert panel[80:120, 80:120].all()
    assert share - 0.1 < panel.mean() < share + 0.2


def test_a_heat_map_shows_what_lies_between_vertices_on_the_reference(tmp_path):
    coarse = Mesh(*shapes.icosphere(0))  # its vertices are the sphere's
    fine = Mesh(*shapes.icosphere(5))
    pixels = np.asarray(Image.open(neusub.render([coarse, fine], tmp_path / "a.png", panel=(200, 200), reference=fine)))
    yellow = (pixels[:200, :, 0].astype(int) - pixels[:200, :, 2]) > 100  # the far end of viridis
    assert yellow[:, :200].mean() > 0.02
    assert not yellow[:, 200:].any()
    neusub.render(fine, tmp_path / "b.png", panel=(200, 200), reference=Mesh(fine.vertices + 1e-16, fine.faces))
    assert not np.ptp(np.asarray(Image.open(tmp_path / "b.png"))[60:140, 60:140, 1].astype(int)) > 100  # of rounding


def test_panels_break_into_rows(tmp_path):
    path = neusub.render([ball()] * 3, tmp_path / "rows.png", panel=(100, 100), columns=2)
    assert Image.open(path).size == (200, 200)


def test_wireframe_draws_the_edges(tmp_path):
    plain = np.asarray(Image.open(neusub.render(ball(), tmp_path / "a.png")))
    wired = np.asarray(Image.open(neusub.render(ball(), tmp_path / "b.png", wireframe=True)))
    assert (plain != wired).any(axis=-1).mean() > 0.02


def test_a_heat_map_has_colours_and_a_bar(tmp_path):
    bumpy = Mesh(ball().vertices * (1 + 0.1 * np.sin(5 * ball().vertices[:, :1])), ball().faces)
    path = neusub.render(bumpy, tmp_path / "heat.png", panel=(300, 200), reference=ball())
    pixels = np.asarray(Image.open(path)).astype(int)
    assert pixels.shape[:2] == (270, 300)
    assert np.ptp(pixels[:200], axis=-1).max() > 60
    assert np.ptp(pixels[200:], axis=-1).max() > 60


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("red, blue", [("picture", "picture"), ("picture", "color"), ("color", "color")])
def test_each_face_shows_its_own_material(tmp_path, red, blue, smooth):
    """The box's front and top are blue, its right side red; that is what the camera sees."""
    materials = tuple(
        Material(name, (*rgb, 1.0)) if kind == "color" else
        Material(name, textures=(("map_Kd", f"{name}.png", _picture(name)),))
        for name, rgb, kind in (("red", (1.0, 0.0, 0.0), red), ("blue", (0.0, 0.0, 1.0), blue))
    )
    box = shapes.uv_box()
    is_right = (box["vertices"][box["faces"]][:, :, 0] == 1).all(axis=1)
    mesh = Mesh(**box, face_data={"material": np.where(is_right, 0, 1)}, materials=materials)
    path = neusub.render(mesh, tmp_path / "box.png", panel=(100, 100), smooth=smooth, camera=(1, 0.2, 1))
    pixels = np.asarray(Image.open(path).convert("RGB")).astype(int)
    r, g, b = np.moveaxis(pixels, -1, 0)
    is_red, is_blue = (r > g + 60) & (r > b + 60), (b > g + 60) & (b > r + 60)
    assert is_red[:, 55:].mean() > 0.2
    assert is_blue[:, :45].mean() > 0.2
    assert not is_red[:, :45].any()
    assert not is_blue[40:, 55:].any()  # above is the top


def test_nothing_is_left_behind_by_a_failure(tmp_path):
    with pytest.raises(MeshFileError, match="does not exist"):
        neusub.render(ball(), tmp_path / "no" / "picture.png")
    with pytest.raises(ValueError, match="titles"):
        neusub.render(ball(), tmp_path / "picture.png", titles=["a", "b"])
    assert list(tmp_path.iterdir()) == []


def test_a_picture_says_nothing_where_there_is_no_display(tmp_path):
    code = "import sys, neusub; neusub.render(neusub.Mesh(*eval(sys.argv[1])), 'one.png', panel=(100, 100))"
    vertices, faces = (array.tolist() for array in shapes.icosahedron())
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    done = subprocess.run([sys.executable, "-c", code, repr((vertices, faces))], cwd=tmp_path, env=environment,
                          capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")
