"""Truths of the half-flap network, then the reference implementation's numbers."""

from dataclasses import asdict

import numpy as np
import pytest
import torch

import neusub.compiled
import neusub.flaps
import shapes
from neusub.configuration import PRESETS, Architecture, TrainingConfig
from neusub.flaps import level_flaps
from neusub.frames import differential_coordinates, star_sums
from neusub.generation import Batch, Pair, batch_pairs
from neusub.network import NeuralSubdivision
from neusub.topology import topology_levels

DEFAULT = asdict(PRESETS["default"].network)
OPTIONS = [pytest.param({}, id="paper"), pytest.param(DEFAULT, id="default")]
GOLDEN_FILES = ("valid_001", "valid_005", "test_bunny", "test_horse")
REFERENCE_NAMES = {"initial": "init", "vertex": "vertex", "edge": "edge",
                   "first": "layerIn", "hidden": "hidden.0", "last": "layerOut"}


@pytest.fixture(params=["tensors", "compiled"])
def way(request, monkeypatch):
    """Each of the two ways to the same numbers: `said_by_tensors` and the kernels."""
    monkeypatch.setattr(neusub.compiled, "serves", lambda *_: request.param == "compiled")
    return request.param


def flaps_of(faces, n_vertices, levels=2):
    return [level_flaps(topology) for topology in topology_levels(faces, n_vertices, levels)[0]]


def run(network, vertices, faces, levels=2):
    weight = next(network.parameters())
    with torch.no_grad():
        return network(torch.as_tensor(vertices, dtype=weight.dtype), flaps_of(faces, len(vertices), levels))


def random_network(seed=0, dtype=torch.float64, **options):
    torch.manual_seed(seed)
    return NeuralSubdivision(Architecture(**options)).to(dtype)


def reference_network(golden, dtype):
    weights = np.load(golden / "weights.npz")
    network = NeuralSubdivision()
    state = {}
    for key in network.state_dict():
        module, layer, kind = key.split(".")
        state[key] = torch.tensor(weights[f"net_{REFERENCE_NAMES[module]}.{REFERENCE_NAMES[layer]}.{kind}"])
    network.load_state_dict(state)
    return network.to(dtype)


def rotation(seed=0):
    q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    return q * np.sign(np.linalg.det(q))


def bumpy(vertices, seed=1):
    return vertices + 0.1 * np.random.default_rng(seed).standard_normal(vertices.shape)


@pytest.mark.parametrize("make", [lambda: shapes.torus(8, 6), lambda: shapes.grid(5, 4), shapes.tetrahedron])
def test_rotating_the_input_rotates_the_output(make, way):
    vertices, faces = make()
    vertices = bumpy(vertices)
    turn = rotation()
    network = random_network()
    diagonal = np.linalg.norm(np.ptp(vertices, axis=0))
    for out, turned in zip(run(network, vertices, faces), run(network, vertices @ turn.T + [1, 2, 3], faces)):
        assert np.abs(turned.numpy() - (out.numpy() @ turn.T + [1, 2, 3])).max() <= 1e-12 * diagonal


def test_zero_last_layers_give_midpoint_subdivision():
    vertices, faces = shapes.icosahedron()
    network = random_network()
    for module in (network.initial, network.vertex, network.edge):
        torch.nn.init.zeros_(module.last.weight)
        torch.nn.init.zeros_(module.last.bias)
    level0, level1, _ = run(network, vertices, faces)
    edges = topology_levels(faces, len(vertices), 1)[0][0].edges
    assert np.array_equal(level0.numpy(), vertices)
    assert np.array_equal(level1.numpy()[len(vertices) :], vertices[edges].mean(axis=1))


def test_renumbering_the_vertices_renumbers_the_output():
    vertices, faces = shapes.torus(7, 5)
    vertices = bumpy(vertices)
    order = np.random.default_rng(0).permutation(len(vertices))
    rank = np.argsort(order)
    network = random_network()
    level0 = run(network, vertices, faces)[0].numpy()
    assert np.allclose(run(network, vertices[order], rank[faces])[0].numpy(), level0[order], rtol=0, atol=1e-12)


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("make", [lambda: shapes.torus(9, 7), lambda: shapes.grid(6, 5)])
def test_chunks_do_not_change_the_output(make, options, monkeypatch):
    vertices, faces = make()
    network = random_network(**{**options, "trained": 1, "settle": 0.05} if options else {})
    whole = run(network, bumpy(vertices), faces)
    monkeypatch.setattr(neusub.flaps, "CHUNK", 320)
    for a, b in zip(whole, run(network, bumpy(vertices), faces)):
        assert torch.allclose(a, b, rtol=0, atol=1e-12)


@pytest.mark.parametrize("options", [{}, {"vectors": 2, "turns": True, "residual": True, "activation": "silu"}],
                         ids=["paper", "vectors"])  # sizes and heights count as constants, so not with these
@pytest.mark.parametrize("make", [lambda: shapes.torus(5, 4), lambda: shapes.grid(3, 3)])
def test_gradients_equal_finite_differences(make, options, way):
    vertices, faces = make()
    network = random_network(**options)
    levels = flaps_of(faces, len(vertices), 2)
    start = torch.tensor(bumpy(vertices))
    parameters = dict(network.named_parameters())
    direction = {key: torch.randn_like(value) for key, value in parameters.items()}

    def loss():
        return sum(out.square().mean() for out in network(start, levels))

    loss().backward()
    slope = sum(float((parameters[key].grad * direction[key]).sum()) for key in parameters)
    step, values = 1e-8, []  # so small that hardly any ReLU changes sides
    for sign in (1, -1):
        with torch.no_grad():
            for key, value in parameters.items():
                value += sign * step * direction[key]
            values.append(float(loss()))
            for key, value in parameters.items():
                value -= sign * step * direction[key]
    assert slope == pytest.approx((values[0] - values[1]) / (2 * step), rel=1e-5)


def test_differential_coordinates_vanish_on_a_regular_flat_patch_up_to_its_straight_border():
    vertices, faces = shapes.grid(6, 6)
    flaps = flaps_of(faces, len(vertices), 1)[0]
    delta = differential_coordinates(star_sums(flaps.by_vertex, torch.tensor(vertices))).numpy()
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    corner = (np.isclose(vertices, low) | np.isclose(vertices, high))[:, :2].all(axis=1)
    assert np.abs(delta[~corner]).max() < 1e-12


def test_a_flat_open_patch_moves_alike_inside_and_along_its_border():
    vertices, faces = shapes.grid(9, 9)
    network = random_network()
    moved = run(network, vertices, faces, 1)[0].numpy() - vertices
    x, y = vertices[:, 0], vertices[:, 1]
    step = np.ptp(x) / (len(np.unique(x)) - 1)
    inside = (x > x.min() + 1.5 * step) & (x < x.max() - 1.5 * step) & (y > y.min() + 1.5 * step) & (
        y < y.max() - 1.5 * step)
    border = (y < y.min() + 0.5 * step) & (x > x.min() + 2.5 * step) & (x < x.max() - 2.5 * step)
    # A border vertex averages over 4 half-flaps of the 6 directions, so only the normal part is bound to be close.
    assert np.ptp(moved[inside], axis=0).max() < 1e-12
    assert np.ptp(moved[border], axis=0).max() < 1e-12


def degenerate_meshes():
    yield "collinear face", shapes.collinear_face()
    yield "coincident vertices", shapes.coincident_vertices()
    vertices, faces = shapes.icosahedron()
    yield "a point", (np.zeros_like(vertices), faces)
    yield "a line", (vertices * [1, 0, 0], faces)
    yield "folded flat", (vertices * [1, 1, 0], faces)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("name, mesh", degenerate_meshes(), ids=lambda value: value if isinstance(value, str) else "")
def test_degenerate_faces_give_finite_output_and_gradients(name, mesh, dtype, way):
    vertices, faces = mesh
    network = random_network(dtype=dtype)
    assert all(torch.isfinite(out).all() for out in run(network, vertices, faces))
    levels = flaps_of(faces, len(vertices))
    sum(out.square().mean() for out in network(torch.tensor(vertices, dtype=dtype), levels)).backward()
    assert all(torch.isfinite(p.grad).all() for p in network.parameters() if p.grad is not None)


@pytest.mark.parametrize("options", [{"relative": True}, DEFAULT], ids=["relative", "default"])
def test_a_relative_network_knows_no_scale(options, way):
    vertices, faces = shapes.torus(9, 7)
    network = random_network(**options)
    for out, scaled in zip(run(network, vertices, faces), run(network, vertices * 1000, faces)):
        np.testing.assert_allclose(scaled.numpy() / 1000, out.numpy(), atol=1e-12)


@pytest.mark.parametrize("options", [{"relative": True}, DEFAULT], ids=["relative", "default"])
def test_parts_of_a_relative_network_behave_as_each_alone(options, way):
    (a, f), (b, g) = shapes.torus(9, 7), shapes.icosahedron()
    network = random_network(**options)
    both = run(network, np.concatenate([a, 1e-3 * b + 5]), np.concatenate([f, g + len(a)]), 1)[0].numpy()
    np.testing.assert_allclose(both[: len(a)], run(network, a, f, 1)[0].numpy(), atol=1e-12)
    np.testing.assert_allclose(both[len(a) :], run(network, 1e-3 * b + 5, g, 1)[0].numpy(), atol=1e-12)


@pytest.mark.parametrize("shape", ["torus", "grid"])
def test_learned_vectors_turn_with_the_mesh(shape, way):
    vertices, faces = getattr(shapes, shape)(7, 6)
    vertices = vertices + 0.1 * np.random.default_rng(0).standard_normal(vertices.shape)
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    turn[:, 0] *= np.linalg.det(turn)
    network = random_network(**DEFAULT)
    for out, turned in zip(run(network, vertices, faces), run(network, vertices @ turn.T + 3, faces)):
        np.testing.assert_allclose(turned.numpy(), out.numpy() @ turn.T + 3, atol=1e-12)


def test_displacements_and_gradients_are_finite_where_faces_have_no_area(way):
    vertices, faces = shapes.torus(7, 6)
    vertices[:3] = vertices[0]
    network = random_network(**DEFAULT)
    start = torch.tensor(vertices, requires_grad=True)
    out = network(start, flaps_of(faces, len(vertices)))[-1]
    out.square().sum().backward()
    assert out.isfinite().all()
    assert all(weight.grad is not None and weight.grad.isfinite().all() for weight in network.initial.parameters())
    assert start.grad is not None and start.grad.isfinite().all()


@pytest.mark.parametrize("size, shape", [(1, shapes.coincident_vertices()), (0, shapes.torus()), (0, shapes.grid())])
def test_gradients_of_positions_are_finite_where_edges_have_no_length(size, shape, way):
    vertices, faces = shape
    network = random_network(**DEFAULT)
    start = torch.tensor(size * vertices, requires_grad=True)
    network(start, flaps_of(faces, len(vertices)))[-1].square().sum().backward()
    assert start.grad is not None and start.grad.isfinite().all()


def make_pair(vertices, faces, seed):
    topologies, _ = topology_levels(faces, len(vertices), 2)
    sizes = (len(vertices), *(t.n_vertices + len(t.edges) for t in topologies))
    targets = np.random.default_rng(seed).standard_normal((sizes[-1], 3)).astype(np.float32)
    targets[: len(vertices)] = vertices
    return Pair(faces, targets, sizes)


def test_the_loss_of_a_union_is_the_sum_of_its_meshes_losses():
    pairs = [make_pair(*shapes.torus(6, 5), 0), make_pair(*shapes.grid(4, 3), 1), make_pair(*shapes.icosahedron(), 2)]
    network = random_network()

    def loss(batch: Batch) -> float:
        with torch.no_grad():
            return float(batch.loss(network(batch.positions, batch.levels)))

    single = sum(loss(batch_pairs([pair], dtype=torch.float64)) for pair in pairs)
    assert loss(batch_pairs(pairs, dtype=torch.float64)) == pytest.approx(single, rel=1e-12)


@pytest.mark.parametrize("dtype, suffix, tolerance", [(torch.float32, "f32", 2e-6), (torch.float64, "f64", 1e-12)])
@pytest.mark.parametrize("name", GOLDEN_FILES)
def test_outputs_equal_the_reference_at_every_level(golden, name, dtype, suffix, tolerance, way):
    data = np.load(golden / f"{name}.npz")
    outputs = run(reference_network(golden, dtype), data["input_V"], data["input_F"])
    for level, out in enumerate(outputs):
        assert np.abs(out.numpy() - data[f"out_V_level{level}_{suffix}"]).max() <= tolerance


@pytest.mark.parametrize("name", GOLDEN_FILES)
def test_rigid_motion_costs_no_more_than_in_the_reference(golden, name, way):
    data = np.load(golden / f"{name}.npz")
    network = reference_network(golden, torch.float32)
    turn, shift = torch.tensor(data["rot_R"]), torch.tensor(data["rot_t"])
    start = torch.tensor(data["input_V"])
    outs, turned = run(network, start, data["input_F"]), run(network, start @ turn.T + shift, data["input_F"])
    error = max(float((b - (a @ turn.T + shift)).abs().max()) for a, b in zip(outs, turned))
    assert error <= data["rot_err_f32"].max()


def test_the_validation_loss_equals_the_reference(golden, elephant, tmp_path, way):
    from neusub.generation import load_pairs
    from neusub.importing import import_pairs
    from neusub.training import validate

    paths = import_pairs(elephant, tmp_path)
    batches = [batch_pairs([pair]) for pair in load_pairs(paths[1])]
    loss = validate(reference_network(golden, torch.float32), batches, TrainingConfig())
    assert loss == pytest.approx(1.926012e-6, abs=5e-13)
