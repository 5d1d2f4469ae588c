"""What a CUDA GPU gives: the same as the CPU, in inference and in training."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from experiments.variants import NETWORKS, LastLevel, fit

import neusub
import neusub.recording
import neusub.training
import shapes
from neusub import PRESETS, Subdivider, TrainingConfig
from neusub.flaps import level_flaps
from neusub.generation import Batch, batch_pairs, save_pairs
from neusub.recording import Recorder
from neusub.subdivider import model_names
from neusub.topology import topology_levels
from neusub.training import train
from test_network import GOLDEN_FILES, reference_network
from test_training import loop_pair

if not torch.cuda.is_available():
    pytest.skip("no CUDA GPU: what one computes is not compared with the CPU", allow_module_level=True)


@pytest.fixture
def recorded(monkeypatch):
    """What is recorded during the test."""
    words, record = [], Recorder._recorded
    monkeypatch.setattr(Recorder, "_recorded", lambda *given: words.append(given) or record(*given))
    return words


@pytest.fixture
def pairs():
    """Of shaken shapes: where symmetry makes a gradient zero, Adam takes a whole step along its rounding."""
    shake = np.random.default_rng(0).normal
    return [loop_pair(vertices + shake(0, 0.03 * np.ptp(vertices), vertices.shape), faces)
            for vertices, faces in (shapes.torus(6, 5), shapes.grid(), shapes.icosahedron(), shapes.cone())]


@pytest.fixture
def files(tmp_path, pairs):
    save_pairs(pairs, tmp_path / "train.safetensors", {})
    save_pairs(pairs[:2], tmp_path / "validation.safetensors", {})
    return [tmp_path / "train.safetensors"], [tmp_path / "validation.safetensors"]


@pytest.mark.parametrize("shape", [shapes.torus(), shapes.grid(), shapes.cube(), shapes.genus(2), shapes.cone(),
                                   shapes.collinear_face(), shapes.coincident_vertices()])
@pytest.mark.parametrize("model", model_names())
@pytest.mark.parametrize("crease_angle", [None, 40])
def test_inference_equals_the_cpu(shape, model, crease_angle):
    mesh = neusub.Mesh(*shape)
    there, here = (Subdivider.load(model, device=device, dtype=torch.float64).subdivide(
        mesh, 3, crease_angle=crease_angle) for device in ("cuda", "cpu"))
    for ours, theirs in zip(there, here, strict=True):
        assert np.abs(ours.vertices - theirs.vertices).max() < 1e-10 * np.ptp(mesh.vertices)


@pytest.mark.parametrize("dtype, suffix, tolerance", [(torch.float32, "f32", 2e-6), (torch.float64, "f64", 1e-12)])
@pytest.mark.parametrize("name", GOLDEN_FILES)
def test_outputs_equal_the_reference_at_every_level(golden, name, dtype, suffix, tolerance):
    data = np.load(golden / f"{name}.npz")
    levels = [level_flaps(topology, "cuda")
              for topology in topology_levels(data["input_F"].astype(np.int64), len(data["input_V"]), 2)[0]]
    with torch.inference_mode():
        outputs = reference_network(golden, dtype).cuda()(torch.tensor(data["input_V"]).to("cuda", dtype), levels)
    for level, out in enumerate(outputs):
        assert np.abs(out.cpu().numpy() - data[f"out_V_level{level}_{suffix}"]).max() <= tolerance


@pytest.mark.parametrize("options", [
    {"batch": 1},
    {"batch": 3, "network": PRESETS["default"].network, "loss": "surface", "shallow": 0.5, "learning_rate": 1e-3},
])
def test_a_recorded_training_equals_the_cpus(files, tmp_path, options, recorded):
    rows = {}
    for device in ("cuda", "cpu"):
        rows[device] = []
        config = replace(PRESETS["paper"], epochs=6, device=device, **options)
        train(*files, tmp_path / device, config, on_epoch=rows[device].append)
    for ours, theirs in zip(rows["cuda"], rows["cpu"], strict=True):
        for key in ("training_loss", "validation_loss"):
            assert ours[key] == pytest.approx(theirs[key], rel=0.02)  # rounding grows from step to step
    assert len(recorded) >= 4  # two batches at least, two held out pairs
    assert rows["cuda"][0]["validation_loss"] == pytest.approx(rows["cpu"][0]["validation_loss"], rel=1e-4)


def test_a_recorded_training_goes_on_where_it_was(files, tmp_path):
    config = replace(PRESETS["paper"], epochs=8, device="cuda", checkpoint_every=1)
    whole = train(*files, tmp_path / "whole", config)
    train(*files, tmp_path / "parts", replace(config, epochs=4))
    parts = train(*files, tmp_path / "parts", config, resume=True)
    assert parts.best_loss == pytest.approx(whole.best_loss, rel=0.02)
    assert json.loads(json.dumps(parts.model.card["training"]["config"]))["device"] == "cuda"


def test_a_training_that_fills_the_gpu_goes_on_without_recording(files, tmp_path, monkeypatch):
    config, room = replace(PRESETS["paper"], epochs=4, device="cuda"), iter([True] * 6)  # then no more
    whole = train(*files, tmp_path / "whole", config)
    for module in (neusub.recording, neusub.training):
        monkeypatch.setattr(module, "has_room", lambda device: next(room, False))
    crowded = train(*files, tmp_path / "crowded", config)
    assert crowded.best_loss == pytest.approx(whole.best_loss, rel=0.02)


@pytest.mark.parametrize("name, kind", [*((name, Batch) for name in NETWORKS), ("paper", LastLevel)])
def test_the_experiments_train_alike(name, kind, pairs, recorded):
    found = [fit(NETWORKS[name], batches, batches[:2], TrainingConfig(epochs=3, seed=1)) for device in ("cpu", "cuda")
             for batches in [[kind(**vars(batch_pairs([pair], device=device))) for pair in pairs]]]
    assert len(recorded) == len(pairs) + 2  # steps, and held out pairs
    np.testing.assert_allclose(found[1].losses, found[0].losses, rtol=0.02)
    np.testing.assert_allclose(found[1].errors, found[0].errors, rtol=0.02)
