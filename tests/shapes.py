"""Small meshes with known properties: `(vertices, faces)`, faces counter-clockwise seen from outside.

The second half is bad on purpose; each name says how.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from neusub.topology import build_topology

Shape = tuple[ndarray, ndarray]


POCKET = 0.05  # radius of the bubble of `pocket`
POCKET_HEIGHT = 1 - 1.05 * POCKET


def _shape(vertices: object, faces: object) -> Shape:
    return np.array(vertices, dtype=np.float64), np.array(faces, dtype=np.int64)


def tetrahedron() -> Shape:
    return _shape([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])


def cube() -> Shape:
    """Corners of the unit cube; vertex 4 x + 2 y + z."""
    vertices = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return _shape(vertices, [t for a, b, c, d in quads for t in ([a, b, c], [a, c, d])])


def icosahedron() -> Shape:
    """Circumradius 1."""
    p = (1 + 5**0.5) / 2
    vertices = [[-1, p, 0], [1, p, 0], [-1, -p, 0], [1, -p, 0], [0, -1, p], [0, 1, p], [0, -1, -p], [0, 1, -p]]
    vertices += [[p, 0, -1], [p, 0, 1], [-p, 0, -1], [-p, 0, 1]]
    faces = [[0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4], [11, 10, 2]]
    faces += [[10, 7, 6], [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9], [4, 9, 5], [2, 4, 11]]
    faces += [[6, 2, 10], [8, 6, 7], [9, 8, 1]]
    vertices, faces = _shape(vertices, faces)
    return vertices / np.linalg.norm(vertices[0]), faces


def icosphere(levels: int = 2) -> Shape:
    vertices, faces = icosahedron()
    for _ in range(levels):
        topology = build_topology(faces, len(vertices))
        vertices = np.concatenate([vertices, vertices[topology.edges].mean(axis=1)])
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
        faces = topology.refined_faces
    return vertices, faces


def _wrapped_grid(n: int, m: int, wrap_n: bool, wrap_m: bool) -> ndarray:
    """Faces over (n x m) vertices, vertex i m + j; a wrapped direction joins its last row to its first."""
    i, j = np.meshgrid(np.arange(n if wrap_n else n - 1), np.arange(m if wrap_m else m - 1), indexing="ij")
    a, b = i * m + j, (i + 1) % n * m + j
    c, d = (i + 1) % n * m + (j + 1) % m, i * m + (j + 1) % m
    return np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2).reshape(-1, 3).astype(np.int64)


def torus(n: int = 12, m: int = 8) -> Shape:
    """Radii 1 and 0.4."""
    u, v = np.meshgrid(2 * np.pi * np.arange(n) / n, 2 * np.pi * np.arange(m) / m, indexing="ij")
    r = 1 + 0.4 * np.cos(v)
    vertices = np.stack([r * np.cos(u), r * np.sin(u), 0.4 * np.sin(v)], axis=-1).reshape(-1, 3)
    return vertices, _wrapped_grid(n, m, True, True)


def voxels(cells: set[tuple[int, int, int]]) -> Shape:
    """The border of a set of unit cubes."""
    numbers: dict[tuple[int, ...], int] = {}
    faces = []
    for cell in sorted(cells):
        for axis in range(3):
            for side in (0, 1):
                step = np.eye(3, dtype=int)
                if tuple(cell + (2 * side - 1) * step[axis]) in cells:
                    continue
                u, v = step[(axis + 1) % 3], step[(axis + 2) % 3]
                start = cell + side * step[axis]
                corners = [start, start + u, start + u + v, start + v][:: 2 * side - 1]
                a, b, c, d = (numbers.setdefault(tuple(map(int, corner)), len(numbers)) for corner in corners)
                faces.extend([[a, b, c], [a, c, d]])
    return _shape(list(numbers), faces)


def genus(g: int) -> Shape:
    """Closed and connected with g handles: the border of a bar of (2 g + 1) x 3 x 1 unit cubes with g holes."""
    return voxels({(x, y, 0) for x in range(2 * g + 1) for y in range(3)} - {(2 * k + 1, 1, 0) for k in range(g)})


def grid(n: int = 5, m: int = 4) -> Shape:
    """Flat open patch of n x m vertices, normals +z."""
    x, y = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3).astype(np.float64)
    return vertices, _wrapped_grid(n, m, False, False)


def open_cylinder(n: int = 8, m: int = 4) -> Shape:
    u, z = np.meshgrid(2 * np.pi * np.arange(n) / n, np.arange(m), indexing="ij")
    return np.stack([np.cos(u), np.sin(u), z], axis=-1).reshape(-1, 3), _wrapped_grid(n, m, True, False)


def cone(n: int = 8) -> Shape:
    """Open at its base; the apex is the last vertex."""
    u = 2 * np.pi * np.arange(n) / n
    vertices = np.concatenate([np.stack([np.cos(u), np.sin(u), 0 * u], axis=1), [[0, 0, 1]]])
    return vertices, np.stack([np.arange(n), (np.arange(n) + 1) % n, np.full(n, n)], axis=1)


def pocket(n: int = 24) -> Shape:
    """A sphere with a small bubble inside it, open to the outside through a narrow neck, like an eye behind its lids.

    A profile turned around the z axis, with a little noise; the bubble's centre is (0, 0, POCKET_HEIGHT).
    """
    down = np.linspace(0, 1, n)[1:]
    outer = np.stack([np.sin(np.pi * 0.998 * down), -np.cos(np.pi * 0.998 * down)], axis=1)
    angle = np.pi * np.linspace(np.arcsin(outer[-1, 0] / POCKET) / np.pi, 1, 20)[1:-1]
    inner = np.stack([POCKET * np.sin(angle), POCKET_HEIGHT + POCKET * np.cos(angle)], axis=1)
    radius, height = np.concatenate([outer, inner]).T[:, :, None]
    turn = 2 * np.pi * np.arange(n) / n
    rings = np.stack(np.broadcast_arrays(radius * np.cos(turn), radius * np.sin(turn), height), axis=-1).reshape(-1, 3)
    faces = _wrapped_grid(len(radius), n, False, True)[:, ::-1]
    first, around = len(rings), np.arange(n)
    last = first - n + around
    bottom = np.stack([np.full(n, first), (around + 1) % n, around], axis=1)
    top = np.stack([np.full(n, first + 1), last, first - n + (around + 1) % n], axis=1)
    poles = [[0, 0, -1], [0, 0, POCKET_HEIGHT - POCKET]]
    vertices = np.concatenate([rings, poles])
    noise = 1e-3 * POCKET * np.random.default_rng(0).standard_normal(vertices.shape)
    return _shape(vertices + noise, np.concatenate([faces, bottom, top]))


def two_components() -> Shape:
    (a, f), (b, g) = icosahedron(), tetrahedron()
    return np.concatenate([a, b + 5]), np.concatenate([f, g + len(a)])


def uv_box() -> dict[str, ndarray]:
    """The cube with each side on the whole unit square, as keyword arguments of `Mesh`: each edge between sides is
    a seam."""
    vertices, faces = cube()
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
    side = np.arange(6).repeat(2)[:, None] * 4
    return {
        "vertices": vertices,
        "faces": faces,
        "uv": np.concatenate([uv * 0.5 + 0.01 * k for k in range(6)]),
        "uv_faces": np.array([[0, 1, 2], [0, 2, 3]] * 6) + side,
    }


# Large enough to decimate; the last six change any shape.


def disc(levels: int = 3) -> Shape:
    """Flat and round, normals +z: its boundary turns by the same few degrees at every vertex."""
    vertices, faces = refined(cone(8), levels)
    vertices = vertices * [1, 1, 0]
    on_border = build_topology(faces, len(vertices)).is_boundary_vertex
    vertices[on_border] /= np.linalg.norm(vertices[on_border], axis=1, keepdims=True)
    return vertices, faces


def spiral_stair(turns: float = 1.25, levels: int = 1) -> Shape:
    """A fan that winds more than once around its boundary vertex, climbing: flat, it would lie upon itself."""
    n = round(8 * turns) + 1
    u = 2 * np.pi * turns * np.linspace(0, 1, n)
    vertices = np.concatenate([np.stack([np.cos(u), np.sin(u), 0.2 * u], axis=1), [[0, 0, 0.1 * u[-1]]]])
    faces = np.stack([np.arange(n - 1), np.arange(1, n), np.full(n - 1, n)], axis=1)
    return refined((vertices, faces), levels)


def refined(shape: Shape, levels: int = 1) -> Shape:
    """Midpoint subdivision: the same surface with more faces."""
    vertices, faces = shape
    for _ in range(levels):
        topology = build_topology(faces, len(vertices))
        vertices = np.concatenate([vertices, vertices[topology.edges].mean(axis=1)])
        faces = topology.refined_faces
    return vertices, faces


def bumpy(shape: Shape, size: float = 0.2, seed: int = 0) -> Shape:
    """Every vertex moved at random, by up to `size` of the shortest edge, so that no two edges are alike."""
    vertices, faces = shape
    edges = vertices[faces] - vertices[faces[:, [1, 2, 0]]]
    reach = size * np.sqrt((edges**2).sum(axis=2).min())
    direction = np.random.default_rng(seed).normal(size=vertices.shape)
    return vertices + reach * direction / np.linalg.norm(direction, axis=1, keepdims=True).clip(1), faces


def stretched(shape: Shape, times: float = 50.0) -> Shape:
    """So much longer along a diagonal of space."""
    vertices, faces = shape
    axis = np.array([1.0, 2.0, 2.0]) / 3
    return vertices + (times - 1) * (vertices @ axis)[:, None] * axis, faces


def with_gap_closed(shape: Shape, f: int) -> Shape:
    """With a vertex in the middle of face f's first edge, and a face without area between it and that edge."""
    vertices, faces = shape
    a, b, c = faces[f]
    m, others = len(vertices), np.delete(faces, f, axis=0)
    vertices = np.vstack([vertices, (vertices[a] + vertices[b]) / 2])
    return vertices, np.vstack([others, [[a, m, c], [m, b, c], [a, b, m]]])


def punctured(shape: Shape, at: list[int]) -> Shape:
    """Without the faces around some vertices; one whose hole would touch a boundary or another hole is passed over."""
    vertices, faces = shape
    taken = build_topology(faces, len(vertices)).is_boundary_vertex
    is_gone = np.zeros(len(faces), dtype=bool)
    for v in at:
        star = (faces == v).any(axis=1)
        if not taken[faces[star]].any():
            taken[faces[star]] = True
            is_gone |= star
    kept, corners = np.unique(faces[~is_gone], return_inverse=True)
    return vertices[kept], corners.reshape(-1, 3)


def with_null_edges(shape: Shape, count: int, seed: int = 0) -> Shape:
    """With up to so many edges without length, drawn at random, no two of them at one vertex."""
    vertices, faces = shape[0].copy(), shape[1]
    taken = np.zeros(len(vertices), dtype=bool)
    for a, b in np.random.default_rng(seed).permutation(build_topology(faces, len(vertices)).edges).tolist():
        if count > 0 and not taken[[a, b]].any():
            taken[[a, b]] = True
            vertices[b] = vertices[a]
            count -= 1
    return vertices, faces


def with_cluster(shape: Shape, at: int, count: int) -> Shape:
    """With so many vertices on one point: vertex `at` and those around it, ring by ring."""
    vertices, faces = shape[0].copy(), shape[1]
    edges = build_topology(faces, len(vertices)).edges
    cluster = [at]
    for v in cluster:
        cluster += [w for w in edges[(edges == v).any(axis=1)].reshape(-1).tolist() if w not in [*cluster, v]]
        if len(cluster) >= count:
            break
    vertices[cluster[:count]] = vertices[at]
    return vertices, faces


# Legal, but hard.


def all_flipped() -> Shape:
    vertices, faces = icosahedron()
    return vertices, faces[:, ::-1].copy()


def coincident_vertices() -> Shape:
    """A grid in which vertex 6 lies where vertex 5 does: two faces have no area."""
    vertices, faces = grid()
    vertices[6] = vertices[5]
    return vertices, faces


def collinear_face() -> Shape:
    """Face 0 has three different corners on one line."""
    return _shape([[0, 0, 0], [1, 0, 0], [2, 0, 0], [1, -1, 0]], [[0, 1, 2], [1, 0, 3], [2, 1, 3]])


# Bad.


def fin_on_edge() -> Shape:
    vertices, faces = icosahedron()
    return np.concatenate([vertices, [[0.0, 3.0, 0.0]]]), np.concatenate([faces, [[0, 1, 12]]])


def two_tetrahedra_sharing_edge() -> Shape:
    vertices, faces = tetrahedron()
    other = np.array([0, 1, 4, 5])[faces]
    return np.concatenate([vertices, [[3.0, 1.0, 0.0], [3.0, -1.0, 0.5]]]), np.concatenate([faces, other])


def bow_tie() -> Shape:
    return _shape([[0, 0, 0], [1, 0, 0], [1, 1, 0], [-1, 0, 0], [-1, -1, 0]], [[0, 1, 2], [0, 3, 4]])


def duplicate_face() -> Shape:
    vertices, faces = icosahedron()
    return vertices, np.concatenate([faces, np.roll(faces[3:4], 1, axis=1)])


def double_sided_square() -> Shape:
    faces = [[0, 1, 2], [0, 2, 3]]
    return _shape([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], faces + [face[::-1] for face in faces])


def with_nan() -> Shape:
    vertices, faces = icosahedron()
    vertices[7, 1] = np.nan
    return vertices, faces


def with_inf() -> Shape:
    vertices, faces = icosahedron()
    vertices[7, 1] = np.inf
    return vertices, faces


def too_far() -> Shape:
    vertices, faces = icosahedron()
    vertices[7, 1] = -1e76
    return vertices, faces


def flipped_face() -> Shape:
    vertices, faces = icosahedron()
    faces[4] = faces[4, ::-1]
    return vertices, faces


def moebius(n: int = 12) -> Shape:
    u = 2 * np.pi * np.arange(n) / n
    ends = [np.stack([(1 + s * np.cos(u / 2)) * np.cos(u), (1 + s * np.cos(u / 2)) * np.sin(u), s * np.sin(u / 2)], 1)
            for s in (-0.4, 0.4)]  # fmt: skip
    faces = []
    for i in range(n):
        a, b, c, d = i, (i + 1) % n, n + (i + 1) % n, n + i
        if i == n - 1:
            b, c = c, b
        faces += [[a, b, c], [a, c, d]]
    return _shape(np.concatenate(ends), faces)


def index_out_of_range() -> Shape:
    vertices, faces = icosahedron()
    faces[5, 2] = 12
    return vertices, faces


def negative_index() -> Shape:
    vertices, faces = icosahedron()
    faces[5, 2] = -1
    return vertices, faces


def repeated_vertex() -> Shape:
    vertices, faces = icosahedron()
    return vertices, np.concatenate([faces, [[2, 2, 5]]])


def isolated_first_last() -> Shape:
    vertices, faces = icosahedron()
    return np.concatenate([[[9.0, 9, 9]], vertices, [[8.0, 8, 8]]]), faces + 1


def no_faces() -> Shape:
    return icosahedron()[0], np.zeros((0, 3), dtype=np.int64)
