"""Loop's limit surface: its points and normals."""

from __future__ import annotations

import numpy as np
import pytest

from neusub import schemes
from neusub.creases import refine_creases
from neusub.topology import build_topology
from patches import OPEN, ROUNDING, bipyramid, each_shape, icosahedron, noisy, refined, some_creases


@each_shape
@pytest.mark.parametrize("weights", ["loop", "warren"])
@pytest.mark.parametrize("with_creases", [False, True])
def test_limit_is_the_same_from_every_level(vertices, faces, weights, with_creases):
    vertices, topology = noisy(vertices, 0.02), build_topology(faces, len(vertices))
    creases = some_creases(topology) if with_creases else np.zeros(len(topology.edges), dtype=bool)
    fine = schemes.subdivision_matrix(topology, "loop", weights=weights, creases=creases) @ vertices
    finer = build_topology(topology.refined_faces, len(fine))
    position, normal = schemes.loop_limit(topology, vertices, weights=weights, creases=creases)
    creases_fine = refine_creases(topology, creases, finer)
    again, normal_again = schemes.loop_limit(finer, fine, weights=weights, creases=creases_fine)
    np.testing.assert_allclose(again[: len(vertices)], position, atol=ROUNDING)
    # A corner has no tangent plane: its normal is a mean over faces, which refinement may change.
    sharp = topology.edges[creases | topology.is_boundary_edge]
    has_tangents = np.bincount(sharp.reshape(-1), minlength=len(vertices)) < 3
    # Rounding of the tangents, divided by their length.
    np.testing.assert_allclose(normal_again[: len(vertices)][has_tangents], normal[has_tangents], atol=1e-10)


def test_limit_normals_of_a_sphere_point_outwards():
    vertices, faces = refined(*icosahedron(), 3)
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    position, normal = schemes.loop_limit(build_topology(faces, len(vertices)), vertices)
    outwards = position / np.linalg.norm(position, axis=1, keepdims=True)
    assert (normal * outwards).sum(axis=1).min() > np.cos(np.deg2rad(0.5))


@pytest.mark.parametrize("vertices, faces", OPEN.values(), ids=OPEN.keys())
def test_limit_normals_of_a_flat_patch_point_up(vertices, faces):
    _, normal = schemes.loop_limit(build_topology(faces, len(vertices)), vertices)
    np.testing.assert_allclose(normal, np.broadcast_to([0, 0, 1], normal.shape), atol=ROUNDING)


def test_limit_is_where_many_levels_end():
    vertices, faces = bipyramid(7)
    topology = build_topology(faces, 9)
    position, normal = schemes.loop_limit(topology, vertices)
    last = schemes.subdivision_operator(topology, "loop", 6).apply(vertices)[-1][:9]
    np.testing.assert_allclose(last, position, atol=1e-3)  # the distance falls by about four per level
    np.testing.assert_allclose(normal[7:], [[0, 0, 1], [0, 0, -1]], atol=ROUNDING)
