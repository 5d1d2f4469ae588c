"""Which faces cross, and refinements in which none do."""

import numpy as np
import pytest

import neusub
import shapes
from neusub.crossing import crossing_pairs, uncrossed
from neusub.mesh import Mesh


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


def test_what_crosses_in_the_input_stays_and_ends_the_search():
    mesh = pierced_triangle()
    wanted = neusub.subdivide(mesh, "loop", 1)
    midpoints = neusub.subdivide(mesh, "midpoint", 1)[-1]
    allowed = {tuple(pair) for pair in crossing_pairs(midpoints.vertices, midpoints.faces).tolist()}
    held = uncrossed(mesh, wanted)[-1]
    assert {tuple(pair) for pair in crossing_pairs(held.vertices, held.faces).tolist()} <= allowed


def test_where_nothing_crosses_nothing_changes():
    mesh = Mesh(*shapes.torus())
    for free, held in zip(neusub.subdivide(mesh), neusub.subdivide(mesh, uncross=True)):
        np.testing.assert_array_equal(free.vertices, held.vertices)
