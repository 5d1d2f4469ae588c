"""Meshes for the tests of decimation and of the map: named ones, and a hypothesis strategy of nasty small ones."""

from functools import cache

from hypothesis import strategies as st

import shapes
from neusub.mesh import Mesh
from neusub.selfparam import SelfParameterization, decimate

SHAPES = {
    "sphere": shapes.bumpy(shapes.icosphere(3)),
    "torus": shapes.bumpy(shapes.torus(24, 16)),
    "genus 2": shapes.bumpy(shapes.refined(shapes.genus(2), 2)),
    "genus 3": shapes.bumpy(shapes.refined(shapes.genus(3), 1)),
    "patch": shapes.bumpy(shapes.grid(20, 15)),
    "cylinder": shapes.bumpy(shapes.open_cylinder(24, 12)),
    "sphere with holes": shapes.punctured(shapes.bumpy(shapes.icosphere(3)), [0, 100, 300, 500]),
    "two components": shapes.bumpy(shapes.refined(shapes.two_components(), 2)),
    "stretched": shapes.stretched(shapes.bumpy(shapes.icosphere(3))),
}
CLOSED = [name for name in SHAPES if name not in ("patch", "cylinder", "sphere with holes")]
OPEN = [name for name in SHAPES if name not in CLOSED]


@cache
def mesh_of(name: str) -> Mesh:
    return Mesh(*SHAPES[name])


@cache
def decimated(name: str, strategy: str = "quadric", n_vertices: int = 80) -> SelfParameterization:
    return decimate(mesh_of(name), n_vertices=n_vertices, strategy=strategy)


BASES = {
    "sphere": shapes.icosphere(1),
    "torus": shapes.torus(8, 6),
    "genus 2": shapes.genus(2),
    "genus 3": shapes.genus(3),
    "patch": shapes.grid(7, 6),
    "cylinder": shapes.open_cylinder(8, 5),
}


@st.composite
def meshes(draw, is_degenerate: bool = False) -> Mesh:
    """Genus 0 to 3, noisy, perhaps with holes, stretched 50:1; degenerate: perhaps with edges without length."""
    seed = draw(st.integers(0, 2**32 - 1))
    shape = BASES[draw(st.sampled_from(list(BASES)))]
    shape = shapes.punctured(shape, draw(st.lists(st.integers(0, len(shape[0]) - 1), max_size=3)))
    shape = shapes.bumpy(shape, draw(st.floats(0, 0.9)), seed)
    if draw(st.booleans()):
        shape = shapes.stretched(shape)
    if is_degenerate:
        shape = shapes.with_null_edges(shape, draw(st.integers(0, 5)), seed)
        shape = shapes.with_cluster(shape, seed % len(shape[0]), draw(st.integers(1, 16)))
    return Mesh(*shape)
