"""Truths of the training loop."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

import shapes
from neusub.configuration import Architecture, TrainingConfig
from neusub.errors import PairFileError, TrainingError
from neusub.generation import Pair, batch_pairs, load_pairs, save_pairs, scaled, shortened
from neusub.mesh import Mesh
from neusub.network import NeuralSubdivision
from neusub.schemes import subdivision_matrix
from neusub.subdivider import Subdivider
from neusub.threads import some_threads, workers_of
from neusub.topology import topology_levels
from neusub.training import PRESETS, batch_of, train, validate
from test_network import make_pair

CONFIG = TrainingConfig(epochs=4, checkpoint_every=1, device="cpu")


@pytest.fixture(autouse=True)
def threads_as_before():
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def loop_pair(vertices, faces) -> Pair:
    """Targets that Loop subdivision gives: something that a network can learn."""
    pair = make_pair(vertices, faces, 0)
    levels = [np.asarray(vertices)]
    for topology in topology_levels(faces, len(vertices), 2)[0]:
        levels.append(subdivision_matrix(topology, "loop") @ levels[-1])
    return replace(pair, targets=levels[-1].astype(np.float32))


@pytest.fixture
def files(tmp_path):
    pairs = [loop_pair(*shapes.torus(n, m)) for n, m in ((6, 5), (7, 5), (8, 6))] + [loop_pair(*shapes.icosahedron())]
    save_pairs(pairs, tmp_path / "train.safetensors", {"source": "made", "licence": "CC0"})
    save_pairs(pairs[:1], tmp_path / "validation.safetensors", {"source": "made", "licence": "CC0"})
    return [tmp_path / "train.safetensors"], [tmp_path / "validation.safetensors"]


@pytest.mark.parametrize("options", [
    {"batch": 1, "schedule": "constant"},
    {"batch": 3, "schedule": "cosine"},
    {"batch": 3, "network": PRESETS["default"].network, "loss": "surface", "shallow": 0.5},
    {"batch": 3, "network": PRESETS["default"].network, "loss": "surface", "shallow": 0.5, "threads": 2},
])
def test_an_interrupted_and_resumed_run_equals_an_uninterrupted_one_bit_for_bit(files, tmp_path, options):
    config = replace(CONFIG, **options)
    train(*files, tmp_path / "whole", config)

    class Interrupted(Exception):
        pass

    def interrupt(row):
        if row["epoch"] == 2:
            raise Interrupted

    with pytest.raises(Interrupted):
        train(*files, tmp_path / "parts", config, on_epoch=interrupt)
    train(*files, tmp_path / "parts", config, resume=True)
    whole, parts = (load_file(tmp_path / run / "checkpoint.safetensors") for run in ("whole", "parts"))
    assert whole.keys() == parts.keys()
    assert all(torch.equal(whole[key], parts[key]) for key in whole)
    without_time = [[line.split(",")[:5] for line in (tmp_path / run / "log.csv").read_text().splitlines()]
                    for run in ("whole", "parts")]
    assert without_time[0] == without_time[1]
    assert len(without_time[0]) == 5


@pytest.mark.parametrize("options", [{}, {"network": PRESETS["default"].network, "loss": "surface", "shallow": 0.5}])
def test_threads_share_a_batch_and_learn_what_one_does(files, tmp_path, options):
    rows: dict[int, list] = {1: [], 2: []}
    before = torch.get_num_threads()
    for count, found in rows.items():
        config = replace(CONFIG, batch=3, threads=count, learning_rate=1e-4, **options)
        with some_threads(count):
            assert workers_of(config, torch.device("cpu")) == count
        train(*files, tmp_path / str(count), config, on_epoch=found.append)
        assert torch.get_num_threads() == before
    losses = [[(row["training_loss"], row["validation_loss"]) for row in found] for found in rows.values()]
    np.testing.assert_allclose(*losses, rtol=1e-4)
    assert np.ptp(losses[0], axis=0).min() > 1e-3 * losses[0][0][0]  # they do learn


def test_the_loss_falls_and_the_best_weights_are_saved_with_their_card(files, tmp_path):
    losses = []
    config = replace(CONFIG, epochs=30)
    result = train(*files, tmp_path / "run", config, on_epoch=lambda row: losses.append(row["validation_loss"]))
    assert min(losses) < 0.5 * losses[0]
    assert result.best_loss == min(losses)
    assert result.best_epoch == losses.index(min(losses)) + 1
    card = Subdivider.load(tmp_path / "run" / "model.safetensors").card
    assert card["scores"]["validation_loss"] == min(losses)
    assert card["licence"] == "CC0"
    assert card["training"]["data"][0]["source"] == "made"


def test_steps_that_all_stop_at_level_1_are_those_of_a_training_for_one_level(files, tmp_path):
    deep = replace(CONFIG, network=PRESETS["default"].network, batch=2)
    for name, config in (("stopped", replace(deep, shallow=1.0)), ("one", replace(deep, levels=1)), ("deep", deep)):
        train(*files, tmp_path / name, config)
    stopped, one, full = ({key: value for key, value in load_file(tmp_path / name / "checkpoint.safetensors").items()
                           if key.startswith("model.")} for name in ("stopped", "one", "deep"))
    assert all(torch.equal(stopped[key], one[key]) for key in one)
    assert not all(torch.equal(stopped[key], full[key]) for key in full)


def test_pairs_of_several_depths_train_together_each_as_deep_as_it_is(files, tmp_path):
    pairs = load_pairs(files[0][0])
    save_pairs([shortened(pair, 1) for pair in pairs], tmp_path / "shallow.safetensors", {})
    config = TrainingConfig(epochs=2, batch=3, levels=2)
    result = train([*files[0], tmp_path / "shallow.safetensors"], files[1], tmp_path / "mixed", config)
    assert result.model.network.plan.trained == 2
    assert np.isfinite(result.best_loss)
    with pytest.warns(UserWarning, match="no pair has more than 1 levels: 1 are trained, not 2"):
        shallow = train([tmp_path / "shallow.safetensors"], files[1], tmp_path / "shallow", config)
    assert shallow.model.network.plan.trained == 1
    with pytest.raises(PairFileError, match="no training pairs"):
        train([], [], tmp_path / "none", config)


def test_mixed_precision_trains_the_default_network(files, tmp_path):
    config = replace(PRESETS["default"], epochs=1, cycles=1, levels=2, precision="bf16-mixed", device="cpu")
    assert np.isfinite(train(*files, tmp_path / "run", config).best_loss)


def test_without_held_out_pairs_shallow_steps_do_not_choose_the_epoch(files, tmp_path):
    """A step that stops at level 1 has a smaller loss: the epoch with the most of them would seem the best."""
    config = replace(CONFIG, epochs=5, shallow=0.5, learning_rate=1e-9, network=PRESETS["default"].network)
    losses = []  # of weights that stay as they are
    result = train(files[0], [], tmp_path / "run", config, on_epoch=lambda row: losses.append(row["training_loss"]))
    assert result.best_epoch == 5
    assert result.best_loss == losses[-1] > min(losses)


def test_the_seed_decides_the_run(files, tmp_path):
    one = train(*files, tmp_path / "1", CONFIG).best_loss
    assert train(*files, tmp_path / "2", CONFIG).best_loss == one
    assert train(*files, tmp_path / "3", replace(CONFIG, seed=1)).best_loss != one


def test_a_folder_that_holds_a_run_is_not_overwritten(files, tmp_path):
    train(*files, tmp_path / "run", CONFIG)
    with pytest.raises(TrainingError, match="resume"):
        train(*files, tmp_path / "run", CONFIG)


def test_a_run_is_not_resumed_with_other_options_or_data(files, tmp_path):
    train(*files, tmp_path / "run", CONFIG)
    with pytest.raises(TrainingError, match="learning_rate"):
        train(*files, tmp_path / "run", replace(CONFIG, learning_rate=1.0), resume=True)
    with pytest.raises(TrainingError, match="weighting"):
        train(*files, tmp_path / "run", replace(CONFIG, weighting="areas"), resume=True)
    with pytest.raises(TrainingError, match="other pair files"):
        train(files[1], files[1], tmp_path / "run", CONFIG, resume=True)
    train([*files[0], *files[1]], [], tmp_path / "all", CONFIG)
    with pytest.raises(TrainingError, match="the same ones held out"):
        train(*files, tmp_path / "all", CONFIG, resume=True)


def test_a_run_goes_on_for_another_cycle_as_if_asked_for_it_at_the_start(files, tmp_path):
    config = replace(CONFIG, schedule="cosine", epochs=4, cycles=2)
    whole = train(*files, tmp_path / "whole", config)
    train(*files, tmp_path / "parts", replace(config, epochs=2, cycles=1))
    with pytest.raises(TrainingError, match="epochs"):
        train(*files, tmp_path / "parts", replace(config, cycles=1), resume=True)
    with pytest.raises(ValueError, match="multiple"):
        replace(config, epochs=5)
    parts = train(*files, tmp_path / "parts", config, resume=True)
    assert (parts.best_loss, parts.best_epoch) == (whole.best_loss, whole.best_epoch)
    states = [load_file(tmp_path / run / "checkpoint.safetensors") for run in ("whole", "parts")]
    assert all(torch.equal(states[0][key], states[1][key]) for key in states[0])


def test_a_checkpoint_from_before_an_option_came_in_is_resumed(files, tmp_path):
    train(*files, tmp_path / "run", CONFIG)
    path = tmp_path / "run" / "checkpoint.safetensors"
    with safe_open(path, framework="pt") as file:
        header = json.loads(file.metadata()["neusub"])
    del header["config"]["network"]["settle"], header["config"]["shallow"]
    save_file(load_file(path), path, metadata={"neusub": json.dumps(header)})
    assert train(*files, tmp_path / "run", replace(CONFIG, epochs=5), resume=True).epochs == 5
    with pytest.raises(TrainingError, match="flat"):
        train(*files, tmp_path / "run", replace(CONFIG, network=Architecture(flat=0.1)), resume=True)


def test_a_run_can_start_from_a_model(files, tmp_path):
    config = replace(CONFIG, network=PRESETS["default"].network, loss="surface", batch=2)
    start = Subdivider.load("default", device="cpu")
    still = train(*files, tmp_path / "still", replace(config, epochs=1, learning_rate=1e-12), start=start)
    for name, weight in still.model.network.state_dict().items():
        torch.testing.assert_close(weight, start.network.state_dict()[name], atol=1e-9, rtol=0)
    origin = Subdivider.load(tmp_path / "still" / "model.safetensors").card["training"]["start"]
    assert origin["scores"] == start.card["scores"]
    assert set(still.model.card["licence"].split("; ")) == {"CC0", *start.card["licence"].split("; ")}

    whole = train(*files, tmp_path / "whole", config, start=start)
    train(*files, tmp_path / "parts", replace(config, epochs=2), start=start)
    with pytest.raises(TrainingError, match="began with other weights"):
        train(*files, tmp_path / "parts", config, resume=True)
    parts = train(*files, tmp_path / "parts", config, start=start, resume=True)
    assert whole.model.card["scores"] == parts.model.card["scores"]
    ends = [load_file(tmp_path / run / "checkpoint.safetensors") for run in ("whole", "parts")]
    assert all(torch.equal(ends[0][key], ends[1][key]) for key in ends[0])
    again = train(*files, tmp_path / "again", replace(config, epochs=1), start=still.model)  # with its card in Python
    assert train(*files, tmp_path / "again", replace(config, epochs=2), start=still.model, resume=True).epochs == 2
    assert again.model.card["training"]["start"]["training"]["start"]["hash"] == origin["hash"]
    worse = train(*files, tmp_path / "worse", replace(config, epochs=2, learning_rate=0.05), start=still.model)
    assert (worse.best_epoch, worse.best_loss < np.inf) == (0, True)
    for name, weight in worse.model.network.state_dict().items():
        assert torch.equal(weight, still.model.network.state_dict()[name])
    with pytest.raises(TrainingError, match=r"another network: width 48, not 32, .*relative True, not False"):
        train(*files, tmp_path / "other", CONFIG, start=start)


def test_the_trained_model_settles_beyond_the_levels_of_its_training(files, tmp_path):
    config = replace(CONFIG, epochs=1, settle=0.1, bound=(0.2, 0.3, 0.4))
    plan = train(*files, tmp_path / "run", config).model.network.plan
    assert (plan.trained, plan.settle, plan.bound) == (2, 0.1, (0.2, 0.3, 0.4))
    plan = Subdivider.load(tmp_path / "run" / "model.safetensors").network.plan
    assert (plan.trained, plan.settle, plan.bound) == (2, 0.1, (0.2, 0.3, 0.4))
    with pytest.raises(ValueError, match="settle"):
        TrainingConfig(network=Architecture(settle=0.1))
    with pytest.raises(ValueError, match="bound"):
        TrainingConfig(bound=(0.2,))  # type: ignore[arg-type]


def test_a_run_at_a_constant_rate_can_be_prolonged(files, tmp_path):
    whole = train(*files, tmp_path / "whole", CONFIG)
    train(*files, tmp_path / "parts", replace(CONFIG, epochs=2))
    parts = train(*files, tmp_path / "parts", CONFIG, resume=True)
    assert (parts.best_loss, parts.best_epoch, parts.epochs) == (whole.best_loss, whole.best_epoch, 4)


def test_a_loss_that_is_not_finite_is_a_named_error(files, tmp_path):
    with pytest.raises(TrainingError, match="not finite"):
        train(*files, tmp_path / "run", replace(CONFIG, learning_rate=1e30))


def test_the_default_network_is_saved_as_one_and_knows_no_scale(files, tmp_path):
    train(*files, tmp_path / "run", replace(CONFIG, epochs=1, network=PRESETS["default"].network))
    model = Subdivider.load(tmp_path / "run" / "model.safetensors", dtype=torch.float64)
    assert model.network.plan == replace(PRESETS["default"].network, bound=CONFIG.bound, sharp=CONFIG.sharp)
    vertices, faces = shapes.torus(8, 6)
    one, large = (model.subdivide(Mesh(s * vertices, faces), 1, scale="none")[-1].vertices for s in (1.0, 1000.0))
    np.testing.assert_allclose(large / 1000, one, atol=1e-12)


def test_the_loss_of_distances_is_not_carried_by_a_few_bad_targets(files):
    pairs = load_pairs(files[0][0])[:1]
    good = batch_pairs(pairs)
    bad = pairs[0].targets.copy()
    bad[-1] += 10
    spoiled = batch_pairs([replace(pairs[0], targets=bad)])
    outputs = [good.targets[: len(weight)] + 0.01 for weight in good.weights]
    grown = {kind: float(spoiled.loss(outputs, kind) / good.loss(outputs, kind)) for kind in ("squared", "distance")}
    assert grown["distance"] < 0.05 * grown["squared"]


def test_the_loss_of_the_surface_forgives_errors_along_it(files):
    batch = batch_pairs(load_pairs(files[0][0])[:1])
    along = torch.linalg.cross(batch.normals, torch.tensor([0.3, 0.5, 0.8]).expand_as(batch.normals))
    along /= torch.linalg.norm(along, dim=1, keepdim=True)
    losses = {}
    for name, direction in (("across", batch.normals), ("along", along)):
        outputs = [batch.targets[: len(weight)] + 0.01 * direction[: len(weight)] for weight in batch.weights]
        losses[name] = {kind: float(batch.loss(outputs, kind)) for kind in ("distance", "surface")}
    assert losses["across"]["surface"] == pytest.approx(losses["across"]["distance"], rel=1e-3)
    assert losses["along"]["surface"] == pytest.approx(losses["along"]["distance"] / 2, rel=1e-2)


def test_errors_can_be_weighted_by_area(files):
    pairs = load_pairs(files[0][0])[:2]
    alone, both = ([batch_pairs(group, weighting="areas") for group in groups] for groups in ([[p] for p in pairs],
                                                                                             [pairs]))
    for level, weight in enumerate(both[0].weights):
        assert float(weight.sum()) == pytest.approx(len(pairs) / 3, rel=1e-5)
        whole, parts = (torch.sort(w.flatten()).values for w in (weight, torch.cat([b.weights[level] for b in alone])))
        torch.testing.assert_close(whole, parts)
    faces = pairs[0].topologies[-1].refined_faces
    a, b, c = pairs[0].targets.astype(float)[faces.T]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    v = int(np.argmax(np.bincount(faces[:, 0])))
    share = area[(faces == v).any(axis=1)].sum() / area.sum()
    assert float(alone[0].weights[-1][v]) == pytest.approx(share / 9, rel=1e-4)


def test_the_error_of_normals_is_their_distance(files):
    """Turned by an angle as a whole, or a part of the area by another; a union is the sum of its meshes."""
    pairs = load_pairs(files[0][0])[:2]
    batch, *alone = (batch_pairs(group, normals=True, dtype=torch.float64) for group in (pairs, *([p] for p in pairs)))
    for angle in (0.02, 0.5):
        turn = torch.linalg.matrix_exp(torch.tensor([[0.0, -angle, 0], [angle, 0, 0], [0, 0, 0]], dtype=torch.float64))
        for level in batch.faces:
            normals = turn @ level.normals
            distance = torch.linalg.norm(normals - level.normals, dim=0)
            expected = float((((distance**2 + 0.05**2) ** 0.5 - 0.05) * level.weights).sum())
            positions = batch.targets @ turn.T
            assert float(level.error(positions)) == pytest.approx(expected, rel=1e-6)
    outputs = [batch.targets[: len(weight)] + 0.01 * torch.sin(9 * batch.targets[: len(weight)])
               for weight in batch.weights]
    parts = [[one.targets[: len(weight)] + 0.01 * torch.sin(9 * one.targets[: len(weight)]) for weight in one.weights]
             for one in alone]
    whole, without = (float(batch.loss(outputs, normals=weight)) for weight in (0.3, 0))
    added = sum(float(level.error(out)) for level, out in zip(batch.faces, outputs))
    assert whole == pytest.approx(without + 0.3 * added, rel=1e-9)
    assert added > 0.01
    assert whole == pytest.approx(sum(float(one.loss(out, normals=0.3)) for one, out in zip(alone, parts)), rel=1e-6)


def test_faces_without_area_spoil_no_gradient():
    vertices, faces = shapes.grid()
    batch = batch_pairs([loop_pair(vertices, faces)], normals=True)
    flat = torch.zeros_like(batch.targets, requires_grad=True)  # all in one place
    (gradient,) = torch.autograd.grad(batch.faces[-1].error(flat), flat)
    assert torch.isfinite(gradient).all()


@pytest.mark.parametrize("weighting, normals", [("vertices", 0.0), ("areas", 0.0), ("vertices", 0.1)])
def test_training_and_validation_weigh_errors_alike(files, tmp_path, weighting, normals):
    rows, pairs = [], load_pairs(files[0][0])
    config = replace(CONFIG, epochs=1, batch=len(pairs), weighting=weighting, normals=normals)
    result = train(files[0], files[0], tmp_path / "run", config, on_epoch=rows.append)
    batches = [batch_of([pair], config, torch.device("cpu")) for pair in pairs]
    torch.manual_seed(config.seed)
    assert rows[0]["training_loss"] == pytest.approx(validate(NeuralSubdivision(), batches, config), rel=1e-4)
    network = NeuralSubdivision()  # the result's bounds displacements
    network.load_state_dict(result.model.network.state_dict())
    assert rows[0]["validation_loss"] == pytest.approx(validate(network, batches, config), rel=1e-4)


@pytest.mark.parametrize("given", ["pairs.safetensors", iter([])])
def test_pairs_that_are_no_list_of_files_are_named(given, tmp_path):
    with pytest.raises(PairFileError, match="Give a list of pair files"):
        train(given, [], tmp_path / "run", CONFIG)


def test_a_folder_of_pairs_is_named(tmp_path):
    with pytest.raises(PairFileError, match="is a folder"):
        train([tmp_path], [], tmp_path / "run", CONFIG)


def test_the_model_has_the_loss_that_it_has_in_use(files, tmp_path):
    """Its bounds are not the training's; the card says both losses."""
    result = train(*files, tmp_path / "run", replace(CONFIG, bound=(0.01, 0.01)))
    model = Subdivider.load(tmp_path / "run" / "model.safetensors", device="cpu")
    validation = [batch_of([pair], CONFIG, torch.device("cpu")) for pair in load_pairs(files[1][0])]
    in_use = validate(model.network, validation, CONFIG)
    assert model.card["scores"] == {"validation_loss": result.best_loss, "validation_epoch": result.best_epoch,
                                    "validation_loss_in_use": pytest.approx(in_use, rel=1e-6)}
    assert in_use > 1.01 * result.best_loss
    assert result.loss_in_use == model.card["scores"]["validation_loss_in_use"]


def test_without_held_out_pairs_the_loss_is_called_that_of_the_training(files, tmp_path):
    rows: list[dict] = []
    result = train(files[0], [], tmp_path / "run", CONFIG, on_epoch=rows.append)
    assert result.model.card["scores"].keys() == {"training_loss", "training_epoch"}
    assert result.loss_in_use is None
    assert all(np.isnan(row["validation_loss"]) and np.isfinite(row["best_loss"]) for row in rows)


def test_the_card_has_the_scale_of_the_pairs(files, tmp_path):
    pairs = [scaled(pair, 100.0) for pair in load_pairs(files[0][0])]
    save_pairs(pairs, tmp_path / "large.safetensors", {})
    card = train([tmp_path / "large.safetensors"], [], tmp_path / "run", CONFIG).model.card
    boxes = [np.ptp(pair.positions("on_surface"), axis=0).max() for pair in pairs]
    assert card["scale"]["box"] == pytest.approx(np.mean(boxes))
    assert 0.05 < card["scale"]["edge"] / card["scale"]["box"] < 1


def test_resuming_a_finished_run_writes_its_model(files, tmp_path):
    train(*files, tmp_path / "run", CONFIG)
    (tmp_path / "run" / "model.safetensors").unlink()
    train(*files, tmp_path / "run", replace(CONFIG, bound=None), resume=True)
    assert Subdivider.load(tmp_path / "run" / "model.safetensors", device="cpu").network.plan.bound is None


def test_pairs_without_decimated_vertices_are_refused_before_a_folder_is_made(files, tmp_path):
    with pytest.raises(PairFileError, match="no decimated positions"):
        train(*files, tmp_path / "run", replace(CONFIG, input="decimated"))
    assert not (tmp_path / "run").exists()


def test_a_device_may_have_a_number(files, tmp_path):
    assert train(*files, tmp_path / "run", replace(CONFIG, device="cpu:0", epochs=1)).epochs == 1
