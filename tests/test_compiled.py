"""The kernels against the tensors: the same outputs and gradients, in any number of threads."""

from dataclasses import asdict

import numpy as np
import pytest
import torch

import neusub.compiled
import shapes
from neusub.bounds import Measures, measured
from neusub.configuration import PRESETS, Architecture
from neusub.frames import edge_vectors, local_frames
from test_network import bumpy, flaps_of, random_network

OPTIONS = {
    "paper": {},
    "vectors": {"vectors": 2, "turns": True, "residual": True, "activation": "silu"},
    "default": {**asdict(PRESETS["default"].network), "bound": (0.3, 0.5, 0.3)},
    "wide": {"width": 96, "features": 50, "vectors": 5, "relative": True, "activation": "silu"},
}


def folded():
    """An open mesh with coincident vertices, a face without area, and two that are folded shut."""
    vertices, faces = shapes.grid(6, 5)
    vertices = bumpy(vertices)
    vertices[7] = vertices[8]
    vertices[20] = (vertices[19] + vertices[21]) / 2
    vertices[3] = vertices[2] + vertices[9] - vertices[8]
    return vertices, faces


SHAPES = {"torus": lambda: (bumpy(shapes.torus(9, 7)[0]), shapes.torus(9, 7)[1]), "folded": folded,
          "tetrahedron": shapes.tetrahedron}


def results(network, vertices, faces, monkeypatch, compiled, learns=True):
    """Outputs, and the gradients of the weights; through the positions and vectors of all levels but the input's."""
    monkeypatch.setattr(neusub.compiled, "serves", lambda *_: compiled)
    network.zero_grad()
    start = torch.tensor(vertices, dtype=next(network.parameters()).dtype)
    with torch.set_grad_enabled(learns):
        outputs = network(start, flaps_of(faces, len(vertices)))
    if not learns:
        return outputs
    weights = [torch.linspace(1, 2, out.numel(), dtype=out.dtype).view(out.shape) for out in outputs]
    sum((out * weight).square().sum() for out, weight in zip(outputs, weights)).backward()
    return [*(out.detach() for out in outputs), *(p.grad.clone() for p in network.parameters())]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("options", OPTIONS)
def test_outputs_and_gradients_are_those_of_tensors(options, shape, monkeypatch):
    vertices, faces = SHAPES[shape]()
    network = random_network(**OPTIONS[options])
    for a, b in zip(*(results(network, vertices, faces, monkeypatch, way) for way in (False, True))):
        # Both round differently: gradients of relu may jump, but not at these inputs.
        assert float((a - b).abs().max()) <= 1e-10 * max(1e-3, float(a.abs().max()))


@pytest.mark.parametrize("options", OPTIONS)
def test_single_precision_is_as_good_as_that_of_tensors(options, monkeypatch):
    vertices, faces = SHAPES["torus"]()
    network = random_network(**OPTIONS[options])
    exact = results(network, vertices, faces, monkeypatch, False, learns=False)
    network = network.float()
    for out, *rounded in zip(exact, *(results(network, vertices, faces, monkeypatch, way, learns=False)
                                      for way in (False, True))):
        errors = [float((out - one).abs().max()) for one in rounded]
        assert 0 < errors[1] < 2 * errors[0] + 1e-6


@pytest.mark.parametrize("options", ["paper", "default"])
def test_threads_and_blocks_do_not_change_the_results(options, monkeypatch):
    vertices, faces = SHAPES["folded"]()
    network = random_network(**OPTIONS[options])
    whole = results(network, vertices, faces, monkeypatch, True)
    monkeypatch.setattr(neusub.compiled, "PART", 16)
    monkeypatch.setattr(neusub.compiled, "ROWS", 5)  # fewer than the half-flaps around a vertex
    threads = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        for a, b in zip(whole, results(network, vertices, faces, monkeypatch, True)):
            np.testing.assert_allclose(b, a, rtol=0, atol=1e-11 * max(1.0, float(a.abs().max())))
    finally:
        torch.set_num_threads(threads)


@pytest.mark.parametrize("shape", SHAPES)
def test_measures_are_those_of_tensors(shape):
    vertices, faces = SHAPES[shape]()
    groups, positions = flaps_of(faces, len(vertices), 1)[0].by_vertex, torch.tensor(vertices)
    edges = edge_vectors(groups, positions)
    axes, defined = local_frames(edges)
    wanted = measured(groups, edges, torch.where(defined, axes, 0), True)
    network = random_network()
    layers = neusub.compiled.Layers(network.initial.first.weight[:, :9].contiguous(), network.initial.first.bias,
                                    network.initial.hidden.weight, network.initial.hidden.bias,
                                    network.initial.last.weight[:3], network.initial.last.bias[:3])
    said = neusub.compiled.said(groups, positions, None, None, layers, Architecture(), False, "all")
    for name, a, b in zip(Measures._fields, wanted, said.measures):
        np.testing.assert_allclose(b, a, rtol=1e-9, atol=1e-12, err_msg=name)


def test_the_kernels_serve_learning_and_large_meshes_on_a_cpu():
    groups = flaps_of(shapes.torus(8, 6)[1], 48, 1)[0].by_vertex
    positions = torch.zeros(48, 3)
    assert neusub.compiled.serves(groups, positions)
    with torch.no_grad():
        assert not neusub.compiled.serves(groups, positions)
        large = flaps_of(shapes.torus(130, 65)[1], 130 * 65, 1)[0].by_vertex
        assert neusub.compiled.serves(large, positions)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert not neusub.compiled.serves(groups, positions)
    assert not neusub.compiled.serves(groups, positions.half())
    assert not neusub.compiled.serves(groups, positions.to("meta"))
