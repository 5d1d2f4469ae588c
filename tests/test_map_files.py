"""Maps in files: the same answers after a round trip, and a named error for what is no map."""

import json

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

import shapes
from decimatable import SHAPES, decimated
from neusub.errors import ParameterizationError
from neusub.mesh import Mesh
from neusub.selfparam import SelfParameterization, decimate
from test_selfparam_points import EACH_STRATEGY, random_points


def test_a_saved_map_gives_the_same_answers(tmp_path):
    box = shapes.uv_box()
    colors = np.random.default_rng(0).random((8, 3))
    result = decimate(Mesh(**box, colors=colors), n_vertices=6, strategy="removal", seed=3)
    result.save(tmp_path / "map.safetensors")
    loaded = SelfParameterization.load(tmp_path / "map.safetensors")
    points = random_points(len(result.faces)), random_points(12)
    for ours, theirs in ((result.to_fine(*points[0]), loaded.to_fine(*points[0])),
                         (result.to_coarse(*points[1]), loaded.to_coarse(*points[1]))):  # fmt: skip
        assert all(np.array_equal(a, b) for a, b in zip(ours, theirs))
    for name in ("faces", "decimated", "counts", "reached", "strategy", "seed"):
        assert np.array_equal(getattr(result, name), getattr(loaded, name))
    for name in ("vertices", "faces", "uv", "uv_faces", "colors"):
        assert np.array_equal(getattr(result.fine, name), getattr(loaded.fine, name))


def write_another_format(path):
    save_file({"faces": np.zeros((1, 3))}, path, metadata={"neusub": json.dumps({"format": "neusub-pairs-1"})})


def write_without_header(path):
    save_file({"faces": np.zeros((1, 3))}, path)


def write_without_arrays(path):
    save_file({"faces": np.zeros((1, 3))}, path, metadata={"neusub": json.dumps({"format": "neusub-map-1"})})


def write_text(path):
    path.write_text("v 0 0 0\nf 1 1 1\n")


def write_half(path):
    decimated("torus").save(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.mark.parametrize(("write", "message"), [
    (lambda path: None, "not a readable safetensors file"),
    (write_text, "not a readable safetensors file"),
    (write_half, "not a readable safetensors file"),
    (write_another_format, "the header's format is 'neusub-pairs-1', not 'neusub-map-1'"),
    (write_without_header, "the header's format is None, not 'neusub-map-1'"),
    (write_without_arrays, "charts"),
])  # fmt: skip
def test_a_file_that_holds_no_map_is_refused(tmp_path, write, message):
    path = tmp_path / "map.safetensors"
    write(path)
    with pytest.raises(ParameterizationError, match=rf"map\.safetensors: .*{message}"):
        SelfParameterization.load(path)


@EACH_STRATEGY
@pytest.mark.parametrize("name", SHAPES)
def test_what_was_saved_passes_its_checks(name, strategy, tmp_path):
    result = decimated(name, strategy)
    result.save(tmp_path / "map.safetensors")
    SelfParameterization.load(tmp_path / "map.safetensors")


def _first(row, value):
    def change(array):
        array.reshape(-1)[row] = value
        return array

    return change


@pytest.mark.parametrize(("name", "change", "message"), [
    ("charts.old", lambda array: array[:5], "charts.old has 5 rows, not"),
    ("charts.old", _first(0, 2**30), "charts.old names versions that are not there yet, or one twice"),
    ("charts.old", _first(1, -1), "charts.old names versions"),
    ("charts.made_by", lambda array: array[:400], "charts.made_by has 400 rows, not"),
    ("charts.made_by", _first(0, 0), "charts.made_by does not follow"),
    ("charts.consumed_at", _first(0, 2**30), "charts.consumed_at does not follow"),
    ("charts.starts", _first(0, 1), r"charts.starts does not begin at \(0, 0, 320\) and grow"),
    ("charts.before", _first(0, 60_000), "charts.before names local vertices or faces"),
    ("charts.after", _first(3, 60_000), "charts.after names local vertices or faces"),
    ("charts.uv", lambda array: array.astype(np.float32), "charts.uv is float32"),
    ("versions", _first(0, 0), "versions are not those that no chart consumed"),
    ("faces", _first(0, 10**6), "are not those of one mesh"),
    ("decimated", lambda array: array[:3], "are not those of one mesh"),
])
def test_a_map_whose_arrays_do_not_fit_together_is_a_named_error(name, change, message, tmp_path):
    """The compiled walks would read what is not theirs."""
    path = tmp_path / "map.safetensors"
    decimate(Mesh(*shapes.icosphere(2)), n_vertices=60).save(path)
    with safe_open(path, framework="numpy") as file:
        metadata, arrays = file.metadata(), {key: file.get_tensor(key).copy() for key in file.keys()}  # noqa: SIM118
    arrays[name] = np.ascontiguousarray(change(arrays[name]))
    save_file(arrays, path, metadata=metadata)
    with pytest.raises(ParameterizationError, match=message):
        SelfParameterization.load(path)
