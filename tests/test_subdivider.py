"""Truths of a model: its file, its scale and what it carries along."""

import numpy as np
import pytest
import torch

import neusub
import shapes
from neusub import Mesh, Subdivider
from neusub.errors import ModelError
from neusub.subdivider import model_names
from test_network import GOLDEN_FILES, reference_network

CARD = {"architecture": {"kind": "half-flap", "width": 32, "features": 29}, "input": "on_surface",
        "scale": {"box": 1.0, "edge": 0.1}}


@pytest.fixture(scope="module")
def model() -> Subdivider:
    return Subdivider.load(device="cpu", dtype=torch.float64)


def sphere() -> Mesh:
    return Mesh(*shapes.icosphere(1))


def test_shipped_models_say_what_they_are_and_under_which_licence():
    assert model_names()
    for name in model_names():
        card = Subdivider.load(name, device="cpu").card
        assert {"training", "licence", "scores", "description", "command"} <= card.keys()


@pytest.mark.parametrize("scale, shift", [(1e-6, 0), (1e6, 0), (1, 1e4), (3.7, -2)])
def test_scale_and_place_of_the_input_do_not_matter(model, scale, shift):
    mesh = sphere()
    out = model.subdivide(mesh)[-1].vertices
    moved = model.subdivide(Mesh(mesh.vertices * scale + shift, mesh.faces))[-1].vertices
    rounding = 1e-12 + 1e-15 * abs(shift) / scale * 100
    assert np.abs((moved - shift) / scale - out).max() <= rounding * np.linalg.norm(np.ptp(out, axis=0))


def test_each_component_is_treated_alone(model):
    mesh = sphere()
    n = len(mesh.vertices)
    both = Mesh(np.concatenate([mesh.vertices, 5 * mesh.vertices + 100]), np.concatenate([mesh.faces, mesh.faces + n]))
    one, two = model.subdivide(mesh)[-1], model.subdivide(both)[-1]
    from neusub.topology import connected_components

    _, component = connected_components(two.faces, len(two.vertices))
    assert np.allclose(two.vertices[component == 0], one.vertices, rtol=0, atol=1e-12)
    assert np.allclose((two.vertices[component == 1] - 100) / 5, one.vertices, rtol=0, atol=1e-11)


def test_levels_have_the_midpoint_refinements_connectivity_and_limit_levels_follow(model):
    mesh = sphere()
    levels = model.subdivide(mesh, 2, limit_levels=1)
    assert [len(level.faces) for level in levels] == [len(mesh.faces) * 4**k for k in range(4)]
    loop = neusub.subdivide(levels[2], "loop", 1)[-1]
    assert np.array_equal(levels[3].vertices, loop.vertices)


def test_a_sphere_gets_rounder(model):
    radius = np.linalg.norm(model.subdivide(sphere())[-1].vertices, axis=1)
    assert radius.min() > 0.97
    assert radius.max() < 1.03


def test_colours_uvs_and_face_data_follow(model):
    textured = Mesh(**shapes.uv_box())
    mesh = Mesh(textured.vertices, textured.faces, textured.uv, textured.uv_faces,
                colors=np.random.default_rng(0).random((len(textured.vertices), 3)),
                face_data={"label": np.arange(len(textured.faces))})
    fine = model.subdivide(mesh, 1)[-1]
    assert np.array_equal(fine.face_data["label"], np.tile(np.arange(len(mesh.faces)), 4))
    assert fine.colors.shape == (len(fine.vertices), 3)
    corners = mesh.uv[mesh.uv_faces]
    assert np.allclose(fine.uv[fine.uv_faces][: len(mesh.faces), 1], corners[:, :2].mean(axis=1))


def test_a_model_survives_its_file(model, tmp_path):
    model.save(tmp_path / "model.safetensors")
    again = Subdivider.load(tmp_path / "model.safetensors", device="cpu", dtype=torch.float64)
    assert again.card == model.card
    assert np.array_equal(again.subdivide(sphere())[-1].vertices, model.subdivide(sphere())[-1].vertices)


def test_a_missing_or_broken_model_is_a_named_error(tmp_path):
    with pytest.raises(ModelError, match="neither a file nor a model"):
        Subdivider.load("no such model")
    (tmp_path / "m.safetensors").write_bytes(b"12345678 not weights")
    with pytest.raises(ModelError, match="not a readable"):
        Subdivider.load(tmp_path / "m.safetensors")


@pytest.mark.parametrize("entry, message", [
    ({"architecture": None}, "architecture is None"),
    ({"architecture": [32, 29]}, "architecture is"),
    ({"input": "foo"}, "input is 'foo': take one of on_surface, decimated"),
    ({"scale": {"box": 1.0}}, "scale is .* give the training's box and edge"),
    ({"scale": {"box": 1.0, "edge": 0.0}}, "above 0"),
    ({"scale": 1.0}, "scale is 1.0"),
])
def test_a_broken_card_is_a_named_error(tmp_path, model, entry, message):
    with pytest.raises(ModelError, match=message):
        Subdivider(model.network, {**CARD, **entry})
    good = Subdivider(model.network, CARD)
    good.card = {**CARD, **entry}
    good.save(tmp_path / "m.safetensors")
    with pytest.raises(ModelError, match=message):
        Subdivider.load(tmp_path / "m.safetensors")


def test_weights_that_are_not_finite_are_named_when_they_are_loaded(tmp_path):
    model = Subdivider.load(device="cpu")
    model.network.edge.last.bias[0] = float("nan")
    model.save(tmp_path / "m.safetensors")
    with pytest.raises(ModelError, match=r"edge\.last\.bias are not all finite"):
        Subdivider.load(tmp_path / "m.safetensors")


@pytest.mark.parametrize("levels, scale", [(0, "edge"), (2, "furlong")])
def test_wrong_options_are_named(model, levels, scale):
    with pytest.raises(ValueError, match=r"level|scale"):
        model.subdivide(sphere(), levels, scale=scale)


@pytest.mark.parametrize("name", GOLDEN_FILES)
def test_golden_meshes_come_out_through_the_public_door(golden, name):
    data = np.load(golden / f"{name}.npz")
    model = Subdivider(reference_network(golden, torch.float64), CARD)
    scale = "box" if name.startswith("test") else "none"
    vertices = data["raw_V"] if scale == "box" else data["input_V"].astype(np.float64)
    outputs = model.subdivide(Mesh(vertices, data["raw_F"]), scale=scale)
    factor = 1 / np.ptp(vertices, axis=0).max() if scale == "box" else 1.0
    low = vertices.min(axis=0) if scale == "box" else 0.0
    shift = data["input_V"].min(axis=0) if scale == "box" else 0.0
    for level, mesh in enumerate(outputs):
        expected = data[f"out_V_level{level}_f64"]
        # The golden inputs were rounded to float32 after they were scaled.
        assert np.abs((mesh.vertices - low) * factor + shift - expected).max() <= (1e-6 if scale == "box" else 1e-12)


def test_a_card_names_the_weights_for_the_other_kind_of_input(model):
    mesh = sphere()
    kind = model.card["input"]
    assert model.companion(kind) is model
    alone = Subdivider(model.network, {**CARD, "architecture": model.card["architecture"], "input": kind})
    with pytest.raises(ModelError, match="names no weights for decimated"):
        alone.subdivide(mesh, input="decimated")
    both = Subdivider(model.network, {**CARD, "companions": {"decimated": "elephant"}})
    expected = Subdivider.load("elephant", device="cpu", dtype=torch.float64).subdivide(mesh)[-1].vertices
    assert np.array_equal(both.subdivide(mesh, input="decimated")[-1].vertices, expected)


def test_what_is_no_mesh_or_no_scheme_is_named():
    with pytest.raises(TypeError, match="mesh is a str: load a file"):
        neusub.subdivide("cow.obj")
    with pytest.raises(ValueError, match="unknown scheme 'lop': take one of neural, loop"):
        neusub.subdivide(Mesh(*shapes.cube()), "lop")
