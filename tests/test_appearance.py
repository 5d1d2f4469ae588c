"""Truths of the quadrics over attributes."""

import numpy as np

import shapes
from neusub.mesh import Mesh
from neusub.selfparam import decimate
from neusub.selfparam.appearance import affine_pieces, attribute_quadrics, seam_holds
from neusub.selfparam.placement import evaluate
from neusub.selfparam.surface import FIXED, FREE, ON_SEAM


def test_pieces_reproduce_an_affine_function():
    vertices, faces = shapes.bumpy(shapes.icosphere(1))
    values = vertices @ [1.0, -2.0, 0.5] + 3
    gradient, offset = affine_pieces(vertices[faces], values[faces])
    for corner in range(3):
        at = (gradient * vertices[faces[:, corner]]).sum(axis=1) + offset
        np.testing.assert_allclose(at, values[faces[:, corner]], atol=1e-12)


def test_an_attribute_that_is_affine_in_space_costs_nothing_on_a_flat_patch():
    vertices, faces = shapes.grid(6, 5)
    colors = np.stack([vertices[:, 0] / 5, vertices[:, 1] / 4, 0.5 + 0 * vertices[:, 0]], axis=1)
    quadrics, gradients = attribute_quadrics(Mesh(vertices, faces, colors=colors), vertices)
    quadric = quadrics.sum(axis=0)
    m, n, total = gradients.sum(axis=0)[:, :3], gradients.sum(axis=0)[:, 3], gradients.sum(axis=0)[:, 4]
    cost = evaluate(quadric, 1.3, 2.1, 0.0) - ((m @ [1.3, 2.1, 0.0] + n) ** 2 / total).sum()
    assert abs(cost) < 1e-9


def test_colours_survive_where_the_quadrics_of_space_see_nothing():
    vertices, faces = shapes.grid(30, 30)
    inside = np.abs(vertices[:, 0] - 14) + np.abs(vertices[:, 1] - 14) < 9
    mesh = Mesh(vertices, faces, colors=np.repeat(inside[:, None].astype(float), 3, axis=1))
    rng = np.random.default_rng(0)
    at, barycentric = rng.integers(0, len(faces), 5000), rng.dirichlet([1, 1, 1], 5000)
    truth = np.einsum("nk,nkc->nc", barycentric, mesh.colors[faces[at]])
    error = {}
    for strategy in ("quadric", "appearance"):
        result = decimate(mesh, n_faces=150, strategy=strategy)
        coarse, place = result.to_coarse(at, barycentric)
        colors = result.transfer(mesh.colors)[result.faces[coarse]]
        error[strategy] = np.abs(np.einsum("nk,nkc->nc", place, colors) - truth).mean()
    assert error["appearance"] < 0.2 * error["quadric"]


def boxed() -> Mesh:
    """A cube whose sides are charts of their own, finely cut."""
    mesh = Mesh(**shapes.uv_box())
    for _ in range(3):
        mesh = mesh.refined(np.concatenate([mesh.vertices, mesh.vertices[mesh.topology.edges].mean(axis=1)]))
    return mesh


def test_seams_hold_their_vertices_and_branches_are_fixed():
    mesh = boxed()
    holds, is_seam = seam_holds(mesh)
    x = np.isin(mesh.vertices, [0, 1]).sum(axis=1)  # on how many of the cube's sides
    np.testing.assert_array_equal(holds, np.select([x == 1, x == 2], [FREE, ON_SEAM], FIXED))
    assert is_seam.sum() == 2 * 12 * 8  # both half-edges of eight edges along each of twelve


def test_seams_stay_on_edges_and_few_faces_lie_across_them():
    mesh = boxed()
    across = {}
    for strategy in ("uniform", "appearance"):
        result = decimate(mesh, n_faces=60, strategy=strategy)
        across[strategy] = result.transfer_corners(mesh.uv, mesh.uv_faces, levels=1)[2].mean()
    x = np.isclose(result.decimated, [0.0], atol=1e-9) | np.isclose(result.decimated, [1.0], atol=1e-9)
    assert x.any(axis=1).all()  # every vertex is on the cube
    # Around the cube's corners no ring lies flat, and an edge along the seam maps to a line beside it.
    assert across["appearance"] < 0.6 * across["uniform"]
