"""What the experiments make by themselves: the list, and fine shapes to train on."""

from __future__ import annotations

import ast
import importlib

import numpy as np
import pytest
import torch
from experiments import sources, tables, variants
from experiments.__main__ import experiments, summary
from experiments.analytic import even_pairs
from experiments.common import HERE, add_result, parser_of, read_results, write_results
from experiments.measures import volume
from scipy.optimize import least_squares

import shapes
from neusub import Mesh, Subdivider, TrainingConfig
from neusub.generation import batch_pairs
from neusub.metrics import face_normals
from test_training import loop_pair


def test_every_experiment_is_listed():
    known = experiments()
    assert {"table2", "fixed_inputs", "default", "robustness", "manmade"} <= set(known)
    assert not {"common", "sources", "analytic"} & set(known)
    assert summary(known["table2"]).endswith("all the others.  [tab:quantitative]")


@pytest.mark.parametrize("name", sorted(set(experiments()) - {"tables", "readme_pictures"}))
def test_every_experiment_has_a_quick_run(name, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", [name, "--help"])
    with pytest.raises(SystemExit, match="0"):
        importlib.import_module(f"experiments.{name}").main()
    assert "--quick" in capsys.readouterr().out


@pytest.mark.parametrize("path", sorted((HERE.parent / "src/neusub/weights").glob("*.safetensors")),
                         ids=lambda path: path.stem)
def test_shipped_weights_name_the_authors_of_their_sources(path):
    for source in Subdivider.load(path).card["sources"]:
        assert source["licence"]
        assert source["file"].startswith("experiments/") or source["author"]


def test_results_are_added_to_and_kept_apart_by_seed(tmp_path, monkeypatch):
    monkeypatch.setattr("experiments.common.RESULTS", tmp_path)
    parser = parser_of("experiments x", "", "less", trains=True)
    for words in ([], ["--seed", "1"], ["--seed", "2", "--quick"]):
        options = parser.parse_args(words)
        add_result("sums", ["of", "two"], {"is": options.seed}, options)
        write_results("whole", {"is": options.seed}, options)
    assert read_results("sums") == {"of": {"two": {"is": 0}, "two, seed 1": {"is": 1}}}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["sums.json", "whole-seed1.json", "whole.json"]


@pytest.mark.parametrize("path", sorted(path for folder in ("experiments", "benchmarks", "examples")
                                        for path in (HERE.parent / folder).glob("*.py")), ids=lambda path: path.stem)
def test_what_experiments_and_examples_take_from_the_package_is_public(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "neusub":
            public = importlib.import_module(node.module).__all__
            assert {name.name for name in node.names} <= set(public), node.module
        elif isinstance(node, ast.Attribute):
            assert not node.attr.startswith("_") or node.attr.startswith("__"), node.attr


@pytest.mark.parametrize("number", range(6))
def test_solids_are_closed_look_outwards_and_depend_on_their_number_alone(number):
    solid = sources.solid(number)
    assert not solid.topology.is_boundary_edge.any()
    assert volume(solid) > 0
    np.testing.assert_array_equal(solid.vertices, sources.solid(number).vertices)
    assert not np.array_equal(solid.vertices, sources.solid(number, seed=1).vertices)


def off_ellipsoid(unknown, points):
    return ((points / unknown[:3]) ** 2).sum(axis=1) - 1


def off_torus(unknown, points):
    """Stretched along its axes; the last is the tube's radius, the larger one being 1."""
    x2, y2, z2 = (points / unknown[:3]).T ** 2
    return (np.sqrt(x2 + y2) - 1) ** 2 + z2 - unknown[3] ** 2


def test_even_grids_are_closed_look_outwards_and_have_exact_targets():
    for pair in even_pairs(12, seed=0, levels=2):
        mesh = Mesh(pair.positions("on_surface").astype(float), pair.faces)
        assert not mesh.topology.is_boundary_edge.any()
        euler = len(mesh.vertices) - len(mesh.topology.edges) + len(mesh.faces)
        assert euler == (0 if "torus" in pair.name else 2)
        assert volume(mesh) > 0
        points = pair.targets.astype(float) / np.ptp(pair.targets)
        surface = off_torus if "torus" in pair.name else off_ellipsoid
        of_coarse = least_squares(surface, [0.35, 0.35, 0.35, 0.4], args=(points[: pair.level_sizes[0]],)).x
        np.testing.assert_allclose(surface(of_coarse, points), 0, atol=1e-5)


@pytest.mark.parametrize("make", [sources.lathe, sources.extrusion])
def test_solids_are_sharp(make):
    solid = make(np.random.default_rng(0))
    left, right = (solid.topology.edge_halfedges // 3).T
    normals = face_normals(solid)
    assert ((normals[left] * normals[right]).sum(axis=1) < np.cos(np.radians(40))).sum() > 50


def test_bending_folds_space_nowhere():
    """By the Jacobian, from triples of points around each of many."""
    points, step = np.random.default_rng(1).random((2000, 3)), 1e-5
    corners = np.stack([points, *(points + step * axis for axis in np.eye(3))], axis=1).reshape(-1, 3)
    faces = np.concatenate([np.arange(8000).reshape(-1, 4)[:, :3], np.arange(8000).reshape(-1, 4)[:, [0, 2, 3]]])
    for seed in range(5):
        moved = sources.bent(Mesh(corners, faces), np.random.default_rng(seed)).vertices.reshape(-1, 4, 3)
        assert np.linalg.det((moved[:, 1:] - moved[:, :1]) / step).min() > 0


def test_stretching_keeps_the_orientation():
    ball = Mesh(*shapes.icosphere(2))
    for seed in range(5):
        assert volume(sources.stretched(ball, np.random.default_rng(seed))) > 0


@pytest.mark.parametrize("page", tables.pages(), ids=lambda page: page.name)
def test_the_tables_of_the_documentation_have_the_numbers_of_the_results(page):
    text = page.read_text()
    assert tables.renewed(text) == text, "python -m experiments tables"


def test_each_table_stands_on_a_page():
    text = "".join(page.read_text() for page in tables.pages())
    assert {name for name in tables.TABLES if f"<!-- table {name} -->" in text} == set(tables.TABLES)


def test_a_fit_that_was_stopped_goes_on_as_if_it_had_not_been(tmp_path, monkeypatch):
    batches = [batch_pairs([loop_pair(*shape)]) for shape in (shapes.torus(6, 5), shapes.icosahedron())]
    config, file = TrainingConfig(epochs=5, threads=1), tmp_path / "fit.pt"
    whole = variants.fit(variants.NETWORKS["paper"], batches, batches, config)
    monkeypatch.setattr(variants, "KEPT_EVERY", 2)
    set_rate = variants.set_rate

    def stops(adam, config, epoch):
        if epoch == 3:
            raise KeyboardInterrupt
        set_rate(adam, config, epoch)

    monkeypatch.setattr(variants, "set_rate", stops)
    with pytest.raises(KeyboardInterrupt):
        variants.fit(variants.NETWORKS["paper"], batches, batches, config, file)
    monkeypatch.setattr(variants, "set_rate", set_rate)
    resumed = variants.fit(variants.NETWORKS["paper"], batches, batches, config, file)
    assert np.array_equal(resumed.losses, whole.losses)
    assert np.array_equal(resumed.errors, whole.errors)
    weights = zip(resumed.network.state_dict().values(), whole.network.state_dict().values())
    assert all(torch.equal(a, b) for a, b in weights)
    assert not file.exists()
