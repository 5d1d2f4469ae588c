"""Subdivide real coarse meshes with the shipped weights, beside Loop and butterfly, and draw them all.

    python examples/demo.py --output demo
"""

from __future__ import annotations

import argparse
import sys
import time
from io import BytesIO
from pathlib import Path

import igl
import numpy as np
import pyvista
from PIL import Image

import neusub
from neusub import Mesh
from neusub.io import read
from neusub.mesh import Material
from neusub.repair import repair

SCHEMES = ("loop", "butterfly", "neural")


def low_poly_models() -> dict[str, Mesh]:
    """Artists' models that come inside pyvista: an ant in 15 closed parts, an open airplane.

    The airplane has an edge with three faces and six vertices with two fans, which repair takes apart.
    """
    from pyvista import examples

    airplane, report = repair(read(examples.planefile), split_edges=True, split_vertices=True)
    sys.stdout.write("".join(f"airplane: {line}\n" for line in report))
    return {"ant": neusub.load(examples.antfile), "airplane": airplane}


def blob() -> Mesh:
    """A smooth closed surface of 15,000 faces: a level set of a few soft spheres."""
    centres = np.array([[0, 0, 0], [0.9, 0.2, 0.1], [-0.8, 0.4, 0.2], [0.2, -0.3, 0.9], [-0.1, 0.9, -0.3],
                        [0.3, -0.8, -0.5]])
    radii = np.array([0.75, 0.45, 0.5, 0.4, 0.45, 0.5])
    grid = pyvista.ImageData(dimensions=(80, 80, 80), spacing=(0.05,) * 3, origin=(-1.975,) * 3)
    offsets = grid.points[:, None] - centres
    field = np.exp(-3 * (offsets**2).sum(-1) / radii**2).sum(-1)
    surface = grid.contour([0.12], scalars=field).clean(absolute=False, tolerance=1e-9)
    return Mesh(surface.points, surface.regular_faces.astype(np.int64))


def decimated_on_surface(fine: Mesh, faces: int) -> Mesh:
    """igl's decimation, each vertex then put onto the fine surface: the shipped weights are for such vertices."""
    vertices, coarse, *_ = igl.qslim(fine.vertices, fine.faces, faces)
    _, _, closest = igl.point_mesh_squared_distance(vertices, fine.vertices, fine.faces)
    return Mesh(closest, coarse.astype(np.int64))


def upright(mesh: Mesh, name: str) -> Mesh:
    """For the picture only: the airplane's z is up, the camera's y."""
    return mesh.replace_vertices(mesh.vertices[:, [1, 2, 0]]) if name == "airplane" else mesh


def textured_ring(n: int = 14, m: int = 8) -> Mesh:
    """A torus whose texture has a seam around and one along."""
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    u, v = 2 * np.pi * i / n, 2 * np.pi * j / m
    vertices = np.stack([(1 + 0.4 * np.cos(v)) * np.cos(u), (1 + 0.4 * np.cos(v)) * np.sin(u), 0.4 * np.sin(v)], -1)

    def quads(rows: int, columns: int, modulo: tuple[int, int]) -> np.ndarray:
        def at(a, b):
            return ((i + a) % modulo[0] * columns + (j + b) % modulo[1]).ravel()

        a, b, c, d = at(0, 0), at(1, 0), at(1, 1), at(0, 1)
        return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])

    s, t = np.meshgrid(np.arange(n + 1) / n, np.arange(m + 1) / m, indexing="ij")
    material = Material("checker", textures=(("map_Kd", "checker.png", checkerboard()),))
    return Mesh(vertices.reshape(-1, 3), quads(n, m, (n, m)), np.stack([s, t], -1).reshape(-1, 2),
                quads(n + 1, m + 1, (n + 1, m + 1)), face_data={"material": np.zeros(2 * n * m, np.int64)},
                materials=(material,))


def checkerboard(size: int = 512) -> bytes:
    """A PNG whose colours run along the checkerboard, so that a seam in the wrong place shows."""
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    dark = ((x * 16 // size + y * 8 // size) % 2)[..., None]
    colour = np.stack([60 + 180 * x / size, 120 + 100 * y / size, 230 - 150 * x / size], -1)
    file = BytesIO()
    Image.fromarray((colour * (1 - 0.55 * dark)).astype(np.uint8)).save(file, format="PNG")
    return file.getvalue()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("demo"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    model = neusub.Subdivider.load()
    fine = blob()
    inputs = {**low_poly_models(), "blob": decimated_on_surface(fine, 400), "ring": textured_ring()}
    panels, titles = [], []
    for name, mesh in inputs.items():
        panels.append(upright(mesh, name))
        titles.append(f"{name}, {len(mesh.faces)} faces")
        for scheme in SCHEMES:
            result = neusub.subdivide(mesh, scheme, 2, model=model)[-1]
            panels.append(upright(result, name))
            titles.append(scheme)
            path = folder / f"{name}_{scheme}.{'obj' if mesh.uv is not None else 'ply'}"
            neusub.save(result, path)
            line = f"{name:9s} {scheme:10s} {len(mesh.faces):6,} -> {len(result.faces):7,} faces   {path}"
            if name == "blob":
                error = neusub.distance(result, fine)
                line += f"   H {error.hausdorff:.4f}  M {error.mean:.5f}"
            sys.stdout.write(line + "\n")
    picture = folder / "comparison.png"
    neusub.render(panels, picture, titles=titles, columns=1 + len(SCHEMES))
    sys.stdout.write(f"picture: {picture}   ({time.perf_counter() - began:.1f} s)\n")


if __name__ == "__main__":
    main()
