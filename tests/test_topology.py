"""Truths of edges, half-edges and the refinement."""

import numpy as np
import pytest

import shapes
from neusub.topology import build_topology, connected_components, counting_order, refined_topology, topology_levels

CLOSED = {"tetrahedron": shapes.tetrahedron(), "icosahedron": shapes.icosahedron(), "torus": shapes.torus(7, 5),
          "genus 2": shapes.genus(2)}
ALL = {**CLOSED, "grid": shapes.grid(4, 3), "open cylinder": shapes.open_cylinder(6, 2)}


def euler(faces: np.ndarray, n_vertices: int) -> int:
    return n_vertices - len(build_topology(faces, n_vertices).edges) + len(faces)


@pytest.mark.parametrize("name", ALL)
def test_edges_are_the_sorted_unique_pairs(name):
    vertices, faces = ALL[name]
    pairs = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert np.array_equal(build_topology(faces, len(vertices)).edges, np.unique(pairs, axis=0))


def test_counting_gives_the_stable_order():
    keys = np.random.default_rng(0).integers(0, 50, 1000)
    assert np.array_equal(counting_order(keys, 50), np.argsort(keys, kind="stable"))
    assert len(counting_order(keys[:0], 50)) == 0


@pytest.mark.parametrize("key", [-1, 50, 10**9])
def test_a_key_out_of_range_is_an_error_and_no_crash(key):
    with pytest.raises(IndexError, match="keys go from"):
        counting_order(np.array([0, key, 3]), 50)


@pytest.mark.parametrize("name", ALL)
def test_refinement_keeps_eulers_number_and_the_boundary_loops(name):
    vertices, faces = ALL[name]
    topology = build_topology(faces, len(vertices))
    finer = build_topology(topology.refined_faces, len(vertices) + len(topology.edges))
    assert euler(finer.faces, finer.n_vertices) == euler(faces, len(vertices))
    assert finer.is_boundary_edge.sum() == 2 * topology.is_boundary_edge.sum()


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("renumbered", [False, True])
def test_refined_topology_is_what_is_built_from_the_refined_faces(name, renumbered):
    vertices, faces = ALL[name]
    if renumbered:
        faces = np.random.default_rng(1).permutation(len(vertices))[faces]
    topology = build_topology(faces, len(vertices))
    for _ in range(2):
        built = build_topology(topology.refined_faces, topology.n_vertices + len(topology.edges))
        topology = refined_topology(topology)
        assert topology.n_vertices == built.n_vertices
        for part in ("faces", "edges", "face_edges", "edge_halfedges"):
            assert np.array_equal(getattr(topology, part), getattr(built, part)), part
            assert getattr(topology, part).dtype == getattr(built, part).dtype


@pytest.mark.parametrize("name", ALL)
def test_twins_run_the_other_way_along_the_same_edge(name):
    vertices, faces = ALL[name]
    topology = build_topology(faces, len(vertices))
    tail, head = faces.reshape(-1), faces[:, [1, 2, 0]].reshape(-1)
    inner = topology.twins >= 0
    assert np.array_equal(tail[inner], head[topology.twins[inner]])
    assert np.array_equal(topology.twins[topology.twins[inner]], np.flatnonzero(inner))
    assert (~inner).sum() == topology.is_boundary_edge.sum()


@pytest.mark.parametrize("name", ALL)
def test_half_flaps_have_the_left_face_left_and_the_right_face_right(name):
    vertices, faces = ALL[name]
    cycles = {tuple(np.roll(face, k)) for face in faces.tolist() for k in range(3)}
    for v0, v1, v2, v3 in build_topology(faces, len(vertices)).flaps.tolist():
        assert v2 < 0 or (v0, v1, v2) in cycles
        assert v3 < 0 or (v1, v0, v3) in cycles
        assert v2 >= 0 or v3 >= 0


def test_a_triangle_refines_into_the_four_documented_blocks():
    faces = np.array([[0, 1, 2]])
    # Edges (0, 1), (0, 2), (1, 2) have the midpoints 3, 4, 5.
    assert build_topology(faces, 3).refined_faces.tolist() == [[0, 3, 4], [1, 5, 3], [2, 4, 5], [5, 4, 3]]


def test_components_are_counted_and_numbered_by_their_first_vertex():
    vertices, faces = shapes.two_components()
    count, component = connected_components(faces, len(vertices))
    assert count == 2
    assert component[0] == 0
    assert (component[faces] == component[faces[:, :1]]).all()


def test_levels_have_the_reference_numbering(golden):
    for path in sorted(golden.glob("[tv]*_*[0-9ey].npz")):
        data = np.load(path)
        if "input_F" not in data:
            continue
        topologies, faces = topology_levels(data["input_F"], len(data["input_V"]), 2)
        assert np.array_equal(faces, data["out_F_level2"])
        assert np.array_equal(topologies[1].faces, data["out_F_level1"])
        for level, topology in enumerate(topologies):
            flaps = {tuple(row) for row in topology.flaps.tolist()}
            assert flaps == {tuple(row) for row in data[f"halfflaps_level{level}"].tolist()}
