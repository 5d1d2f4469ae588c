"""Which faces cross, and refinements in which none do."""

import numpy as np
import pytest
import torch
from experiments.measures import is_turned

import neusub
import shapes
from neusub import cli
from neusub.crossing import crossing_pairs, uncrossed
from neusub.mesh import Mesh
from neusub.subdivider import Subdivider
from test_cli import neusub_command
from test_network import random_network


def pierced_triangle() -> Mesh:
    """A tetrahedron's apex through one of the faces of another."""
    vertices, faces = shapes.tetrahedron()
    centre = vertices[faces[0]].mean(axis=0)
    away = centre - vertices.mean(axis=0)
    other = 0.3 * (vertices - vertices.mean(axis=0)) + centre + 0.4 * away
    return Mesh(np.concatenate([vertices, other]), np.concatenate([faces, faces + len(vertices)]))


def test_faces_that_pierce_each_other_are_found():
    mesh = pierced_triangle()
    pairs = crossing_pairs(mesh.vertices, mesh.faces)
    assert len(pairs) and (pairs[:, 0] == 0).all()  # face 0 and faces of the other tetrahedron
    assert (pairs[:, 1] >= 4).all()


@pytest.mark.parametrize("make", [shapes.icosphere, shapes.grid, shapes.uv_box, shapes.genus])
def test_neighbours_do_not_cross_even_in_one_plane(make):
    shape = make(2) if make is shapes.genus else make()
    vertices, faces = (shape["vertices"], shape["faces"]) if isinstance(shape, dict) else shape
    assert len(crossing_pairs(vertices, faces)) == 0


@pytest.mark.parametrize("make", [shapes.pocket, lambda: shapes.bumpy(shapes.torus(10, 8), 0.5)])
def test_a_scheme_that_pushes_the_surface_through_itself_is_held(make):
    mesh = Mesh(*make())
    free = neusub.subdivide(mesh, "butterfly", 2)
    held = neusub.subdivide(mesh, "butterfly", 2, uncross=True)
    assert len(crossing_pairs(free[-1].vertices, free[-1].faces)) > 0
    for level in held:
        assert len(crossing_pairs(level.vertices, level.faces)) == 0
    same = (free[-1].vertices == held[-1].vertices).all(axis=1)
    assert 0.3 < same.mean() < 1  # where nothing crosses, the scheme's own points


def pairs_of(mesh: Mesh) -> set[tuple[int, int]]:
    return {(a, b) for a, b in crossing_pairs(mesh.vertices, mesh.faces).tolist()}


def test_what_crosses_in_the_input_may_stay_and_nothing_comes_to_it():
    mesh = pierced_triangle()
    midpoints = neusub.subdivide(mesh, "midpoint", 1)[-1]
    noise = 0.3 * np.random.default_rng(0).standard_normal(midpoints.vertices.shape)
    noise[: len(mesh.vertices)] = 0
    wanted = midpoints.replace_vertices(midpoints.vertices + noise)
    held = pairs_of(uncrossed(mesh, [mesh, wanted])[-1])
    assert pairs_of(wanted) - pairs_of(midpoints)
    assert held and held <= pairs_of(midpoints)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("size", [0.15, 0.25, 0.35])
def test_loop_is_not_brought_the_crossings_of_midpoints(seed, size):
    """It smooths them away, and turns triangles over where they were."""
    vertices, faces = shapes.icosphere(1)
    mesh = Mesh(vertices + size * np.random.default_rng(seed).standard_normal(vertices.shape), faces)
    midpoints = pairs_of(neusub.subdivide(mesh, "midpoint", 1)[-1])
    free, held = (pairs_of(neusub.subdivide(mesh, "loop", 1, uncross=on)[-1]) for on in (False, True))
    assert held <= midpoints
    assert free - midpoints or len(held) <= len(free)


@pytest.mark.parametrize("make", [shapes.pocket, lambda: shapes.bumpy(shapes.torus(10, 8), 0.5),
                                  lambda: shapes.bumpy(shapes.grid(6, 5), 0.2)])
def test_what_is_taken_back_turns_nothing_over(make):
    """Vertices that go back by different shares could turn over what neither the scheme nor midpoints do."""
    mesh = Mesh(*make())
    network = random_network(dtype=torch.float64, vectors=2, relative=True, unturned=True)
    card = {"architecture": {}, "input": "on_surface", "scale": {"box": 1.0, "edge": 1.0}}
    levels = Subdivider(network, card).subdivide(mesh)
    held = uncrossed(mesh, levels)
    assert not any(is_turned(level, mesh).any() for level in (*held[1:], *levels[1:]))
    assert len(pairs_of(held[-1])) == 0
    assert not any(is_turned(level, mesh).any() for level in neusub.subdivide(mesh, "butterfly", uncross=True))


@pytest.mark.parametrize("scheme", ["butterfly", "neural"])
def test_creases_and_levels_of_the_limit_do_not_cross_either(scheme):
    mesh = Mesh(*shapes.bumpy(shapes.torus(10, 8), 0.5))
    levels = neusub.subdivide(mesh, scheme, 1, crease_angle=60, limit_levels=1, uncross=True)
    assert [len(level.faces) for level in levels] == [160, 640, 2560]
    assert not any(pairs_of(level) for level in levels)
    assert not any(is_turned(level, mesh).any() for level in levels[1:])


def facing():
    """Two icosahedra face to face, closer than either bulges."""
    vertices, faces = shapes.icosahedron()
    other = 2.02 * vertices[faces[0]].mean(axis=0) - vertices
    return np.concatenate([vertices, other]), np.concatenate([faces, faces[:, ::-1] + len(vertices)])


@pytest.mark.parametrize(("options", "is_large", "is_free"), [
    ([], False, True), ([], True, False), (["--uncross", "never"], False, False), (["--uncross", "always"], True, True),
    (["--scheme", "butterfly"], False, False), (["--scheme", "butterfly", "--uncross", "always"], False, True),
])
def test_the_command_does_it_by_itself_on_cages(options, is_large, is_free, tmp_path, capsys, monkeypatch):
    mesh = Mesh(*(shapes.bumpy(shapes.torus(10, 8), 0.5) if "butterfly" in options else facing()))
    neusub.save(mesh, tmp_path / "in.ply")
    monkeypatch.setattr(cli, "QUICK", len(mesh.faces) * 4**2 - is_large)
    assert neusub_command(capsys, "subdivide", tmp_path / "in.ply", "-o", tmp_path / "out.ply", *options)[0] == 0
    assert (len(pairs_of(neusub.load(tmp_path / "out.ply"))) == 0) == is_free


def test_where_nothing_crosses_nothing_changes():
    mesh = Mesh(*shapes.torus())
    for free, held in zip(neusub.subdivide(mesh), neusub.subdivide(mesh, uncross=True)):
        np.testing.assert_array_equal(free.vertices, held.vertices)
