"""Truths of making training pairs: exact targets, the same bytes whatever the workers, whole files in the end."""

import json
import os
from dataclasses import replace
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest

import neusub
import shapes
from neusub import discretization
from neusub.configuration import PairConfig, TrainingConfig
from neusub.discretization import PairStream, in_unit_box, make_pair, make_pairs
from neusub.errors import DecimationError, NeusubError, PairFileError
from neusub.generation import load_pairs, pair_files, read_header
from neusub.mesh import Mesh
from neusub.metrics import point_distance
from neusub.training import train

CONFIG = PairConfig(per_mesh=3, vertices=(30, 50))


@pytest.fixture
def sources(tmp_path):
    paths = [tmp_path / "ball.ply", tmp_path / "ring.ply"]
    neusub.save(Mesh(*shapes.bumpy(shapes.icosphere(3))), paths[0])
    neusub.save(Mesh(*shapes.torus(24, 16)), paths[1])
    return paths


def contents(folder) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_every_target_lies_on_the_fine_surface_and_the_decimated_vertices_beside_it():
    fine = in_unit_box(Mesh(*shapes.bumpy(shapes.icosphere(3))))
    pair, result = make_pair(fine, CONFIG, np.random.default_rng(0))
    # Targets are stored as float32, whose rounding in the unit box is 6e-8.
    assert point_distance(pair.targets.astype(np.float64), fine)[0].max() < 2e-7
    assert 30 <= pair.level_sizes[0] <= 50
    assert len(pair.targets) == pair.level_sizes[2]
    np.testing.assert_allclose(pair.decimated, result.decimated, atol=1e-7)
    assert 1e-3 < point_distance(result.decimated, fine)[0].max() < 0.2


def test_the_source_fills_the_unit_box():
    box = in_unit_box(Mesh(*shapes.torus(24, 16)))
    np.testing.assert_allclose(box.vertices.min(axis=0), 0, atol=1e-15)
    assert np.ptp(box.vertices, axis=0).max() == pytest.approx(1)


def test_the_same_seed_gives_the_same_bytes_whatever_the_workers(sources, tmp_path):
    config = replace(CONFIG, per_mesh=12, validation=3)
    make_pairs(sources, tmp_path / "one", config, workers=1)
    make_pairs(sources, tmp_path / "two", config, workers=2)
    make_pairs(sources, tmp_path / "other", replace(config, seed=1), workers=2)
    one, two, other = (contents(tmp_path / name) for name in ("one", "two", "other"))
    assert sorted(one) == ["ball.train.safetensors", "ball.validation.safetensors", "manifest.json",
                           "ring.train.safetensors", "ring.validation.safetensors"]
    assert one == two
    assert all(one[name] != other[name] for name in one)


def test_training_and_validation_pairs_have_seeds_of_their_own(sources, tmp_path):
    report = make_pairs(sources[:1], tmp_path / "pairs", replace(CONFIG, validation=3))
    train_pairs, held_out = load_pairs(report.train[0]), load_pairs(report.validation[0])
    sizes = {len(a.targets) for a in train_pairs} & {len(b.targets) for b in held_out}
    for a in train_pairs:
        for b in held_out:
            assert len(a.targets) not in sizes or not np.array_equal(a.targets, b.targets)


def test_an_interrupted_call_goes_on_and_ends_with_the_same_files(sources, tmp_path, monkeypatch):
    config = replace(CONFIG, per_mesh=25)
    make_pairs(sources, tmp_path / "whole", config, workers=1)
    calls = []

    def stop_at_the_fourth(task, *rest):
        calls.append(task)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return real(task, *rest)

    real = discretization.run_task
    monkeypatch.setattr(discretization, "run_task", stop_at_the_fourth)
    with pytest.raises(KeyboardInterrupt):
        make_pairs(sources, tmp_path / "halted", config, workers=1)
    parts = list((tmp_path / "halted" / ".parts").iterdir())
    assert len(parts) == 3 and not (tmp_path / "halted" / "manifest.json").exists()
    killed = tmp_path / "halted" / ".ball.train.part99.safetensors"
    killed.write_bytes(b"what a kill left half written")
    os.utime(killed, (0, 0))
    monkeypatch.setattr(discretization, "run_task", real)
    done = []
    make_pairs(sources, tmp_path / "halted", config, workers=1, on_task=lambda done_, all_: done.append((done_, all_)))
    assert contents(tmp_path / "halted") == contents(tmp_path / "whole")
    assert done[-1] == (6, 6)


def test_two_calls_in_one_folder_do_not_disturb_each_other(sources, tmp_path):
    """The second begins and ends while the first is at work."""
    config = replace(CONFIG, per_mesh=25)
    make_pairs(sources, tmp_path / "whole", config, workers=1)

    def call_again(done, _):
        if done == 2:
            make_pairs(sources, tmp_path / "pairs", config, workers=1)
            assert contents(tmp_path / "pairs") == contents(tmp_path / "whole")

    make_pairs(sources, tmp_path / "pairs", config, workers=1, on_task=call_again)
    assert contents(tmp_path / "pairs") == contents(tmp_path / "whole")
    assert not (tmp_path / "pairs" / ".parts").exists()
    assert not list((tmp_path / "pairs").glob(".*"))


def test_total_spreads_evenly_over_the_sources():
    assert PairConfig(total=200, validation=10).counts(3) == {"train": [67, 67, 66], "validation": [4, 3, 3]}
    assert PairConfig(per_mesh=5).counts(2) == {"train": [5, 5], "validation": [0, 0]}


@pytest.mark.filterwarnings("ignore:.*tasks which were still being processed")  # joblib, as the strict call stops
def test_a_source_that_fails_is_listed_with_its_reason_and_the_others_go_on(sources, tmp_path):
    bad = tmp_path / "bad.obj"
    bad.write_text("v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n")
    report = make_pairs([bad, tmp_path / "missing.obj", sources[0]], tmp_path / "pairs", CONFIG)
    assert [path.name for path in report.train] == ["ball.train.safetensors"]
    assert report.failed["bad.obj"].startswith("NonFiniteError: vertex 2")
    assert "missing.obj does not exist" in report.failed["missing.obj"]
    assert json.loads(report.manifest.read_text())["failed"] == report.failed
    with pytest.raises(NeusubError, match="vertex 2"):
        make_pairs([bad, sources[0]], tmp_path / "strict", CONFIG, strict=True)
    with pytest.raises(NeusubError, match=r"missing\.obj does not exist"):
        make_pairs([tmp_path / "missing.obj", sources[0]], tmp_path / "strict", CONFIG, strict=True)


def test_a_size_that_cannot_be_reached_says_what_stopped_it(tmp_path):
    solid = in_unit_box(Mesh(*shapes.genus(3)))
    with pytest.raises(DecimationError, match=r"vertices are left of \d+, 4 were asked for; refused: .*link condition"):
        make_pair(solid, PairConfig(per_mesh=1, vertices=(4, 4)), np.random.default_rng(0))


def test_the_report_has_the_numbers_by_which_pairs_are_compared(sources, tmp_path):
    report = make_pairs(sources, tmp_path / "pairs", CONFIG)
    numbers = read_header(report.train[0])["report"]
    assert 0 < numbers["quality_low"] < numbers["quality_median"] <= 1
    assert 0 < numbers["area_variation"] < 2
    assert 1 <= numbers["conformal_median"] <= numbers["conformal_high"] <= numbers["conformal_worst"]
    assert numbers["flipped"] < 0.01 and numbers["degenerate"] < 0.01


def test_a_folder_of_other_options_is_refused(sources, tmp_path):
    make_pairs(sources, tmp_path / "pairs", CONFIG)
    with pytest.raises(PairFileError, match="was made with the options"):
        make_pairs(sources, tmp_path / "pairs", replace(CONFIG, seed=1))


def test_two_sources_of_one_name_and_no_source_are_refused(sources, tmp_path):
    with pytest.raises(PairFileError, match="several sources have this name"):
        make_pairs([sources[0], tmp_path / "elsewhere" / "ball.ply"], tmp_path / "pairs", CONFIG)
    with pytest.raises(PairFileError, match="no sources"):
        make_pairs([], tmp_path / "pairs", CONFIG)
    with pytest.raises(PairFileError, match=r"a single str\. Give a list"):
        make_pairs(str(sources[0]), tmp_path / "pairs", CONFIG)


def test_a_folder_with_one_more_source_becomes_what_a_fresh_one_would(sources, tmp_path):
    config = PairConfig(total=12, validation=2, vertices=(30, 50))
    make_pairs(sources[:1], tmp_path / "grown", config, workers=1)
    assert read_header(tmp_path / "grown" / "ball.train.safetensors")["count"] == 12
    for name in ("grown", "fresh"):
        make_pairs(sources, tmp_path / name, config, workers=1)
    assert contents(tmp_path / "grown") == contents(tmp_path / "fresh")
    assert read_header(tmp_path / "grown" / "ball.train.safetensors")["count"] == 6


def test_a_licence_that_is_given_later_goes_into_the_headers(sources, tmp_path):
    for name, licences in (("one", ["not stated", "CC0"]), ("two", ["CC0"])):
        for licence in licences:
            make_pairs(sources[:1], tmp_path / name, CONFIG, workers=1, licence=licence)
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
    assert read_header(tmp_path / "one" / "ball.train.safetensors")["licence"] == "CC0"


@pytest.mark.parametrize("options, message", [
    ({}, "give exactly one"),
    ({"per_mesh": 1, "total": 2}, "give exactly one"),
    ({"total": 0}, "at least 1"),
    ({"total": 1, "validation": -1}, "at least 0"),
    ({"total": 1, "seed": -1}, "seed = -1: take at least 0"),
    ({"total": 1, "vertices": (300, 150)}, "a range"),
])
def test_options_that_make_no_sense_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        PairConfig(**options)


def test_a_stream_gives_the_same_pairs_in_the_same_order_whatever_the_workers():
    meshes = [Mesh(*shapes.icosphere(3)), Mesh(*shapes.torus(24, 16))]
    one = list(islice(PairStream(meshes, CONFIG, workers=1), 5))
    two = list(islice(PairStream(meshes, CONFIG, workers=2, ahead=3), 5))
    assert [pair.name for pair in one] == ["0[0]", "1[1]", "0[2]", "1[3]", "0[4]"]
    for a, b in zip(one, two):
        np.testing.assert_array_equal(a.targets, b.targets)
        np.testing.assert_array_equal(a.faces, b.faces)
    assert not np.array_equal(one[0].faces, one[2].faces)


def test_a_stream_keeps_at_least_one_pair_ready():
    with pytest.raises(ValueError, match="ahead = 0"):
        PairStream([Mesh(*shapes.torus(24, 16))], ahead=0)


def test_workers_of_a_loader_share_the_pairs_of_a_stream(monkeypatch):
    stream, names = PairStream([Mesh(*shapes.icosphere(3))], CONFIG, workers=1, ahead=2), []
    for worker in range(2):
        told = SimpleNamespace(id=worker, num_workers=2)
        monkeypatch.setattr("neusub.discretization.get_worker_info", lambda told=told: told)
        names.append([pair.name for pair in islice(stream, 3)])
    assert names == [["0[0]", "0[2]", "0[4]"], ["0[1]", "0[3]", "0[5]"]]


@pytest.mark.parametrize("kind", ["on_surface", "decimated"])
def test_the_pairs_train_a_network(sources, tmp_path, kind):
    make_pairs(sources, tmp_path / "pairs", replace(CONFIG, validation=2), licence="CC0")
    config = TrainingConfig(epochs=2, batch=3, input=kind, device="cpu")
    result = train(*pair_files(tmp_path / "pairs"), tmp_path / "run", config)
    assert np.isfinite(result.best_loss)
    assert result.model.card["input"] == kind
    assert result.model.card["licence"] == "CC0"
