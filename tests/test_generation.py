"""Truths of pair files and batches."""

import numpy as np
import pytest

import shapes
from neusub.errors import PairFileError
from neusub.generation import Pair, batch_pairs, check_pair, load_pairs, read_header, save_pairs, shortened
from neusub.importing import import_pairs
from test_network import make_pair


@pytest.fixture
def pairs() -> list[Pair]:
    return [make_pair(*shapes.torus(6, 5), 0), make_pair(*shapes.icosahedron(), 1)]


def test_pairs_survive_a_file_and_the_header_says_what_they_are(pairs, tmp_path):
    path = tmp_path / "pairs.safetensors"
    save_pairs(pairs, path, {"source": "torus", "licence": "CC0"})
    for was, now in zip(pairs, load_pairs(path)):
        assert np.array_equal(was.faces, now.faces)
        assert np.array_equal(was.targets, now.targets)
        assert was.level_sizes == now.level_sizes
    header = read_header(path)
    assert (header["source"], header["licence"], header["count"], header["levels"]) == ("torus", "CC0", 2, 2)
    assert [p.name for p in tmp_path.iterdir()] == ["pairs.safetensors"]


def test_a_file_without_decimated_positions_says_so(pairs):
    with pytest.raises(PairFileError, match="no decimated positions"):
        pairs[0].positions("decimated")


def test_a_broken_file_is_a_named_error(pairs, tmp_path):
    path = tmp_path / "pairs.safetensors"
    save_pairs(pairs, path, {})
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(PairFileError, match="not a readable"):
        load_pairs(path)
    with pytest.raises(PairFileError, match="no such file"):
        load_pairs(tmp_path / "absent.safetensors")


def test_targets_that_do_not_fit_their_faces_are_a_named_error(pairs, tmp_path):
    wrong = Pair(pairs[0].faces, pairs[0].targets[:-1], pairs[0].level_sizes)
    save_pairs([wrong], tmp_path / "p.safetensors", {})
    with pytest.raises(PairFileError, match="its targets have"):
        load_pairs(tmp_path / "p.safetensors")


@pytest.mark.parametrize("index", [-1, 10**6])
def test_a_face_of_vertices_that_there_are_not_is_a_named_error(pairs, index):
    faces = pairs[0].faces.copy()
    faces[3, 1] = index
    with pytest.raises(PairFileError, match="is not one of its"):
        check_pair(Pair(faces, pairs[0].targets, pairs[0].level_sizes))


def test_a_shortened_pair_has_the_prefix_of_the_targets(pairs):
    short = shortened(pairs[0], 1)
    assert np.array_equal(short.targets, pairs[0].targets[: pairs[0].level_sizes[1]])
    assert shortened(pairs[0], 3) is pairs[0]


def write_obj(path, vertices, faces):
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    path.write_text("\n".join(lines) + "\n")


def test_folders_of_obj_levels_are_imported(pairs, tmp_path):

    for level in (0, 1, 2, "_old"):
        (tmp_path / f"in/subd{level}").mkdir(parents=True)
    for k, pair in enumerate(pairs):
        connectivity = [t.faces for t in pair.topologies] + [pair.topologies[-1].refined_faces]
        for level, size in enumerate(pair.level_sizes):
            write_obj(tmp_path / f"in/subd{level}/{k:03d}.obj", pair.targets[:size], connectivity[level])
    (path,) = import_pairs(tmp_path / "in", tmp_path / "out")
    for was, now in zip(pairs, load_pairs(path)):
        assert np.array_equal(was.faces, now.faces)
        assert np.allclose(was.targets, now.targets, atol=1e-6)
    (tmp_path / "out" / "manifest.json").write_text("{}")
    with pytest.raises(PairFileError, match="holds pairs of other meshes already"):
        import_pairs(tmp_path / "in", tmp_path / "out")


def test_new_vertices_of_obj_levels_may_be_in_any_order(pairs, tmp_path):
    """As other software numbers them: the pair has the order of `topology.py` all the same."""
    pair, rng = pairs[0], np.random.default_rng(0)
    connectivity = [t.faces for t in pair.topologies] + [pair.topologies[-1].refined_faces]
    place = np.arange(pair.level_sizes[-1])  # in the files, of each vertex
    for before, size in zip(pair.level_sizes, pair.level_sizes[1:]):
        place[before:size] = rng.permutation(np.arange(before, size))
    points = np.empty_like(pair.targets)
    points[place] = pair.targets
    for level, size in enumerate(pair.level_sizes):
        (tmp_path / f"in/subd{level}").mkdir(parents=True)
        faces = rng.permutation(np.roll(place[connectivity[level]], level, axis=1))
        write_obj(tmp_path / f"in/subd{level}/a.obj", points[:size], faces if level else connectivity[0])
    (now,) = load_pairs(import_pairs(tmp_path / "in", tmp_path / "out")[0])
    assert np.array_equal(now.faces, pair.faces)
    np.testing.assert_allclose(now.targets, pair.targets, atol=1e-6)


@pytest.mark.parametrize("break_faces", [lambda faces: faces[:, ::-1], lambda faces: faces[:-1],
                                         lambda faces: np.where(faces == faces.max(), faces.max() - 1, faces)])
def test_obj_levels_that_are_not_refinements_are_refused(pairs, tmp_path, break_faces):
    pair = pairs[0]
    for level, faces in enumerate((pair.faces, break_faces(pair.topologies[0].refined_faces))):
        (tmp_path / f"in/subd{level}").mkdir(parents=True)
        write_obj(tmp_path / f"in/subd{level}/a.obj", pair.targets[: pair.level_sizes[level]], faces)
    with pytest.raises(PairFileError, match=r"subd1/a\.obj: it is not the level before with each face split"):
        import_pairs(tmp_path / "in", tmp_path / "out")


def test_a_batch_of_several_depths_is_a_named_error(pairs):
    with pytest.raises(PairFileError, match=r"a batch of pairs of \[1, 2\] levels"):
        batch_pairs([pairs[0], shortened(pairs[1], 1)])
    with pytest.raises(PairFileError, match="a batch of pairs of no levels"):
        batch_pairs([])


def test_the_authors_archive_gives_200_and_10_pairs(elephant, tmp_path):
    train, validation = import_pairs(elephant, tmp_path, licence="MPL-2.0")
    assert (read_header(train)["count"], read_header(validation)["count"]) == (200, 10)
    data = np.load(elephant)
    first = load_pairs(train)[0]
    assert np.array_equal(first.targets, data["train_V2"][: data["train_nV"][0, 2]])


def test_a_source_of_another_kind_is_a_named_error(tmp_path):
    with pytest.raises(PairFileError, match="neither an npz"):
        import_pairs(tmp_path / "nothing", tmp_path / "out")


def test_a_broken_npz_is_a_named_error(tmp_path):
    whole = {"train_V2": np.zeros((6, 3)), "train_F0": np.array([[0, 1, 2]]), "train_nF0": np.array([1])}
    np.savez(tmp_path / "lacks.npz", **whole)
    data = (tmp_path / "lacks.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(data[: len(data) // 2])
    (tmp_path / "empty.npz").write_bytes(b"")
    for name, message in (("lacks", "train_nV"), ("cut", "not a readable npz"), ("empty", "not a readable npz")):
        with pytest.raises(PairFileError, match=message):
            import_pairs(tmp_path / f"{name}.npz", tmp_path / "out")
