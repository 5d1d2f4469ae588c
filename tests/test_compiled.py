"""The kernels against the tensors: the same outputs and gradients, in any number of threads."""

from dataclasses import asdict

import numpy as np
import pytest
import torch

import neusub.compiled
import shapes
from neusub.bounds import Measures, measured
from neusub.compiled import serves
from neusub.configuration import PRESETS, Architecture
from neusub.frames import edge_vectors, local_frames
from neusub.layers import Weights
from test_network import bumpy, flaps_of, random_network

OPTIONS = {
    "paper": {},
    "vectors": {"vectors": 2, "turns": True, "residual": True, "activation": "silu"},
    "default": {**asdict(PRESETS["default"].network), "bound": (0.3, 0.5, 0.3)},
    "no features": {"features": 0, "vectors": 2},
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
    """Outputs, and the gradients of the weights."""
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


@pytest.mark.parametrize("options", ["vectors", "default", "wide"])  # gradients of relu jump with a rounding
def test_single_precision_is_as_good_as_that_of_tensors(options, monkeypatch):
    vertices, faces = SHAPES["torus"]()
    network = random_network(**OPTIONS[options])
    exact = results(network, vertices, faces, monkeypatch, False)
    network = network.float()
    for out, *rounded in zip(exact, *(results(network, vertices, faces, monkeypatch, way) for way in (False, True))):
        errors = [float((out - one).norm() / out.norm()) for one in rounded]
        assert 0 < errors[1] < 4 * errors[0] + 1e-6


@pytest.mark.parametrize("shape", ["torus", "tetrahedron", "grid"])
@pytest.mark.parametrize("options", ["paper", "vectors", "wide"])
def test_gradients_of_the_input_are_those_of_tensors(options, shape, monkeypatch):
    vertices, faces = shapes.grid(6, 5) if shape == "grid" else SHAPES[shape]()
    network, gradients = random_network(**OPTIONS[options]), []
    for compiled in (False, True):
        monkeypatch.setattr(neusub.compiled, "serves", lambda *_, compiled=compiled: compiled)
        start = torch.tensor(bumpy(vertices), requires_grad=True)
        sum(out.square().sum() for out in network(start, flaps_of(faces, len(vertices)))).backward()
        gradients.append(start.grad)
    assert float((gradients[1] - gradients[0]).abs().max()) <= 1e-10 * float(gradients[0].abs().max())


def test_a_vertex_of_many_half_flaps_is_like_any_other(monkeypatch):
    n = 400  # a double cone, whose tips have more half-flaps than a block
    angle = np.arange(n) * 2 * np.pi / n
    rim = np.stack([np.cos(angle), np.sin(angle), 0.1 * np.sin(3 * angle)], axis=1)
    k = np.arange(n)
    faces = np.concatenate([np.stack([k, (k + 1) % n, k * 0 + n], 1), np.stack([(k + 1) % n, k, k * 0 + n + 1], 1)])
    network = random_network(**OPTIONS["default"])
    vertices = np.concatenate([rim, [[0, 0, 1.0], [0, 0, -1.0]]])
    for a, b in zip(*(results(network, vertices, faces, monkeypatch, way) for way in (False, True))):
        assert float((a - b).abs().max()) <= 1e-10 * max(1e-3, float(a.abs().max()))


def test_what_changed_since_it_was_used_raises_an_error():
    vertices, faces = SHAPES["torus"]()
    network = random_network()
    out = network(torch.tensor(vertices), flaps_of(faces, len(vertices)))[-1]
    with torch.no_grad():
        network.vertex.hidden.weight.mul_(3)
    with pytest.raises(RuntimeError, match="inplace"):
        out.sum().backward()


def test_a_network_that_was_used_can_learn(monkeypatch):
    monkeypatch.setattr(neusub.compiled, "serves", lambda *_: False)
    vertices, faces = SHAPES["torus"]()
    network = random_network(features=13)  # of a size that no other test has, for what is kept by size
    with torch.inference_mode():
        network(torch.tensor(vertices), flaps_of(faces, len(vertices)))
    network(torch.tensor(vertices), flaps_of(faces, len(vertices)))[-1].sum().backward()
    assert all(part.grad is not None for part in network.parameters())


def test_second_derivatives_raise_an_error():
    vertices, faces = SHAPES["torus"]()
    start = torch.tensor(vertices, requires_grad=True)
    out = random_network(activation="silu")(start, flaps_of(faces, len(vertices)))[-1]
    slope, = torch.autograd.grad(out.square().sum(), start, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        slope.square().sum().backward()


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
    weights = random_network().initial
    parts = [part for layer in (weights.first, weights.hidden, weights.last) for part in (layer.weight, layer.bias)]
    said = neusub.compiled.said(groups, positions, torch.zeros(len(positions), 3), None, Weights(*parts),
                                Architecture(sharp=0.03), False, "all")
    for name, a, b in zip(Measures._fields, wanted, said.measures):
        np.testing.assert_allclose(b, a, rtol=1e-9, atol=1e-12, err_msg=name)


def test_the_kernels_serve_learning_and_large_meshes_on_a_cpu():
    groups = flaps_of(shapes.torus(8, 6)[1], 48, 1)[0].by_vertex
    positions = torch.zeros(48, 3)
    assert serves(groups, positions, positions)
    with torch.no_grad():
        assert not serves(groups, positions, positions)
        large = flaps_of(shapes.torus(130, 65)[1], 130 * 65, 1)[0].by_vertex
        assert serves(large, positions, positions)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert not serves(groups, positions, positions)
    assert not serves(groups, positions.double(), positions)
    for other in (positions.half(), positions.to("meta")):
        assert not serves(groups, other, other)
