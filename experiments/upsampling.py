"""Points instead of subdivision: sample the coarse mesh, upsample the points, reconstruct a surface.

    pip install pymeshlab
    python -m experiments upsampling TOSCA MESHES --inputs tosca8_coarse.npz [--quick]

TOSCA is the folder of <category>.npz, MESHES the one that holds INDEX.csv, for the picture.  The paper takes 5000
points, uniform or farthest ones, a network that was trained on statues and gives 16 times as many, and screened
Poisson.  Here moving least squares (APSS, Guennebaud and Gross 2007) upsample, 16 times too; pymeshlab has them, the
normals and Kazhdan's screened Poisson.  Two levels of subdivision also give 16 times as many vertices.  The eight fixed
inputs with vertices on the surface; H and M in TOSCA's units; seconds of the processor.  Writes results/upsampling.json
and docs/reproduction/upsampling.webp; --quick takes two shapes, and writes nothing.

Points alone tell no inside: normals are estimated.  One row takes the coarse mesh's normals instead, to tell apart what
is lost with them and what is lost with the triangles.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import igl
import numpy as np
from numpy import ndarray
from scipy.spatial import cKDTree

import neusub
from experiments import measures
from experiments.common import TOSCA, fixed_inputs, fixed_reference, parsed, parser_of, provenance, write_results
from experiments.drawing import BACK, UP, panel, titled, write_panels
from experiments.measures import mean_of, score
from neusub.map_pictures import View
from neusub.metrics import sample_surface
from neusub.topology import connected_components

SHOWS = ("fig:ptUpsample", "app:pointUpsample")
LEVELS, TIMES = 2, 16
SAMPLES = 5_000  # the paper's
CANDIDATES = 4  # of them for each farthest point
NEIGHBOURS = 10  # of which a point's normal and spacing are estimated
DEPTH = 8  # of Poisson's octree, pymeshlab's own
SUBDIVIDED = ("elephant", "default", "butterfly")
DRAWN, COARSE = "organic/oded_spot.ply", 402  # as many vertices as the fixed inputs have


# --- samples -----------------------------------------------------------------------------------------------------


def vertices(mesh: neusub.Mesh) -> ndarray:
    return mesh.vertices


def uniform(mesh: neusub.Mesh) -> ndarray:
    return sample_surface(mesh, SAMPLES, np.random.default_rng(0))[0]


def farthest(mesh: neusub.Mesh) -> ndarray:
    """Each next point is the candidate that is farthest from those before it."""
    points = sample_surface(mesh, CANDIDATES * SAMPLES, np.random.default_rng(0))[0]
    chosen, away = np.zeros(SAMPLES, dtype=np.int64), np.full(len(points), np.inf)
    for k in range(1, SAMPLES):
        away = np.minimum(away, ((points - points[chosen[k - 1]]) ** 2).sum(axis=1))
        chosen[k] = away.argmax()
    return points[chosen]


SAMPLERS: dict[str, Callable[[neusub.Mesh], ndarray]] = {
    "coarse vertices": vertices, "coarse vertices, true normals": vertices, "5000 uniform points": uniform,
    "5000 farthest points": farthest}


# --- points to a surface -----------------------------------------------------------------------------------------


def upsampled(points: ndarray, normals: ndarray) -> tuple[ndarray, ndarray]:
    """TIMES as many points and their normals: a disk around each point, in its tangent plane, is moved onto the surface
    that moving least squares fit to all points."""
    import pymeshlab

    spacing = cKDTree(points).query(points, k=NEIGHBOURS)[0][:, -1] / 2
    across = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(normals, across)
    turn = np.arange(TIMES) * np.pi * (3 - np.sqrt(5))  # a sunflower's, even over the disk
    radius = np.sqrt(np.arange(TIMES) / TIMES)
    disk = np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    offsets = disk[:, :1] * across[:, None] + disk[:, 1:] * along[:, None]
    proxies = (points[:, None] + spacing[:, None, None] * offsets).reshape(-1, 3)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(points, v_normals_matrix=normals))
    meshes.add_mesh(pymeshlab.Mesh(proxies, v_normals_matrix=np.repeat(normals, TIMES, axis=0)))
    meshes.set_current_mesh(0)  # the filter crashes where the current mesh is not the control mesh
    meshes.compute_mls_projection_apss(controlmesh=0, proxymesh=1)
    return meshes.mesh(1).vertex_matrix(), meshes.mesh(1).vertex_normal_matrix()


def oriented_normals(points: ndarray) -> ndarray:
    """Planes through the neighbours, their sides made consistent from point to point (Hoppe et al. 1992), outwards."""
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(points))
    meshes.compute_normal_for_point_clouds(k=NEIGHBOURS)
    normals = meshes.current_mesh().vertex_normal_matrix()
    return normals * np.sign((normals * (points - points.mean(axis=0))).sum())


def true_normals(mesh: neusub.Mesh) -> ndarray:
    return igl.per_vertex_normals(np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces))


def outwards(mesh: neusub.Mesh) -> float:
    """Percent of the normals estimated at the vertices that are on the right side."""
    return 100 * float(((oriented_normals(mesh.vertices) * true_normals(mesh)).sum(axis=1) > 0).mean())


def reconstructed(points: ndarray, normals: ndarray) -> neusub.Mesh:
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(points, v_normals_matrix=normals))
    meshes.generate_surface_reconstruction_screened_poisson(depth=DEPTH, threads=1)
    surface = meshes.current_mesh()
    return neusub.Mesh(surface.vertex_matrix(), surface.face_matrix().astype(np.int64))


def refined(mesh: neusub.Mesh, method: str) -> neusub.Mesh:
    if method in SAMPLERS:
        points = SAMPLERS[method](mesh)
        normals = true_normals(mesh) if method.endswith("true normals") else oriented_normals(points)
        return reconstructed(*upsampled(points, normals))
    return measures.refined(mesh, method, LEVELS)[-1]


# --- what is measured --------------------------------------------------------------------------------------------


def numbers_of(mesh: neusub.Mesh, method: str, reference: neusub.Mesh) -> dict:
    start = time.process_time()
    result = refined(neusub.Mesh(mesh.vertices, mesh.faces), method)  # without the topology
    seconds = time.process_time() - start
    topology = neusub.info(result)  # where its normals disagree, Poisson's surface can run into the box and be open
    component = connected_components(result.faces, len(result.vertices))[1]
    h, m = score(result, reference)
    return {"H": h, "M": m, "seconds": seconds, "vertices": len(result.vertices), "components": topology.components,
            "genus": topology.genus, "boundary_loops": topology.boundary_loops,
            "outside_the_largest_percent": 100 * (1 - float(np.bincount(component).max() / len(component)))}


def table(options: argparse.Namespace, names: list[str]) -> dict:
    rows: dict = {method: {} for method in (*SUBDIVIDED, *SAMPLERS)}
    meshes = fixed_inputs(options.inputs, "on_surface")
    for name in names:
        reference = fixed_reference(options.tosca, name)
        for method in rows:
            rows[method][name] = numbers_of(meshes[name], method, reference)
            print(name, method, *(f"{key} {value:.4g}" for key, value in rows[method][name].items()), flush=True)
    return {method: {**mean_of(shapes), "shapes": shapes} for method, shapes in rows.items()}


# --- the picture -------------------------------------------------------------------------------------------------


def draw(folder: Path) -> Path:
    fine = neusub.load(folder / DRAWN)
    coarse = neusub.decimate(fine, n_vertices=COARSE).on_surface
    view = View(fine, (330, 350), BACK, UP)
    titles = {"elephant": "network, two levels", **{method: method for method in SAMPLERS}}
    panels = [titled(panel(coarse, view, edges=True), f"coarse, {len(coarse.vertices)} vertices")]
    panels += [titled(panel(refined(coarse, method), view), title) for method, title in titles.items()]
    return write_panels("upsampling", [panels[:3], panels[3:]])


def main() -> None:
    parser = parser_of("experiments upsampling", __doc__, "two shapes")
    parser.add_argument("tosca", type=Path)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--inputs", type=Path, required=True, help="tosca8_coarse.npz, the eight fixed inputs")
    options = parsed(parser)
    meshes = fixed_inputs(options.inputs, "on_surface")
    names = list(meshes)[: 2 if options.quick else None]
    rows = table(options, names)
    right = {name: outwards(meshes[name]) for name in names}
    for method, row in rows.items():
        print(f"{method:30s}", *(f"{key} {value:.4g}" for key, value in row.items() if key != "shapes"))
    print("percent of the normals at the coarse vertices on the right side", right)
    if not options.quick:
        print(draw(options.meshes))
    write_results("upsampling", {"citation": TOSCA, **provenance(options), "methods": rows,
                                 "normals_on_the_right_side_percent": right}, options)


if __name__ == "__main__":
    main()
