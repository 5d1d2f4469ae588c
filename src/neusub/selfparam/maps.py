"""MAPS (Lee, Sweldens, Schroeder, Cowsar and Dobkin 1998), for the comparison of the paper's `fig:uniformRemesh`.

    decimate_maps    levels, until the target is reached or one removes nothing
    remove_level     vertices that do not touch each other, flat ones of small rings first
    remove           flatten the ring of a vertex by z^a, retriangulate it, test, keep the chart

The map is that of `mapping.py`: a removal is a chart of the vertex's faces before and of the ring's triangles after.
It is plain Python, some 200 us a vertex: made to compare with, not to be used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64
from numba import njit
from numpy import ndarray

from neusub.compilation import COMPILED, INNER
from neusub.errors import DecimationError
from neusub.mesh import Mesh, check_is_mesh
from neusub.selfparam.criteria import (
    BOUNDARY,
    LEGAL,
    LINK,
    NORMAL,
    PLANE_AFTER,
    PLANE_BEFORE,
    QUALITY_PLANE,
    QUALITY_SPACE,
    REASONS,
    VALENCE,
    Criteria,
    dot_of_units,
    normal_of,
    plane_face,
    quality,
)
from neusub.selfparam.decimation import checked_targets, outgoing
from neusub.selfparam.flatten import THINNEST, flatten_ring
from neusub.selfparam.mapping import CAPACITY, Step, charts_of
from neusub.selfparam.parameterization import SelfParameterization
from neusub.selfparam.priorities import removal_order
from neusub.topology import build_topology

__all__ = ["decimate_maps"]


def decimate_maps(
    mesh: Mesh,
    *,
    n_vertices: int,
    weight: float = 0.5,
    max_valence: int = 12,
    criteria: Criteria | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> SelfParameterization:
    """Remove vertices level by level down to n_vertices, and keep a bijective map between both meshes.

    weight: of the ring's area in the order of removal; that of the curvature is 1 - weight.
    max_valence: vertices with more neighbours stay.  criteria: which removals are legal; by default as in `decimate`
    (the paper has none).  Flips in the plane are always refused, even without `plane_flips`.
    on_progress: called after each level with the vertices that are left, and the target.
    A target that cannot be reached gives a result with `reached=False` and the refused removals counted by reason.
    Raises: DecimationError for a target or a weight out of range, and where shapely is absent.
    Source: Lee et al. 1998, section 2 (levels and priorities) and 3 (flattening, retriangulation).
    """
    check_is_mesh(mesh)
    checked_targets(mesh, n_vertices, None)
    if not 0 <= weight <= 1:
        raise DecimationError(f"weight = {weight}: take a number from 0 to 1.")
    work = Work(mesh, max_valence, (criteria or Criteria()).packed(), triangulator())
    left = len(mesh.vertices)
    while left > n_vertices:
        removed = remove_level(work, weight, left - n_vertices)
        left -= len(removed)
        if on_progress:
            on_progress(left, n_vertices)
        if not removed:
            break
    return finish(mesh, work, left == n_vertices)


def triangulator() -> Any:
    """shapely, which has a constrained Delaunay triangulation since 2.1."""
    try:
        import shapely
    except ImportError:
        shapely = None
    if not hasattr(shapely, "constrained_delaunay_triangles"):
        found = f"shapely {shapely.__version__}" if shapely else "none"
        raise DecimationError(f"MAPS needs shapely >= 2.1, found {found}: run pip install 'neusub[maps]'.")
    return shapely


class Work:
    """The current mesh: all versions of its faces, and which of them is to the left of each directed edge."""

    def __init__(self, mesh: Mesh, max_valence: int, criteria: ndarray, shapely: Any):
        self.positions = np.ascontiguousarray(mesh.vertices, dtype=np.float64)
        self.corners: list[tuple[int, int, int]] = [(a, b, c) for a, b, c in mesh.faces.tolist()]
        self.face_of = {edge: f for f, face in enumerate(self.corners) for edge in sides(face)}
        self.is_alive = [True] * len(self.corners)
        self.steps: list[Step] = []
        self.counts = np.zeros(len(REASONS), np.int64)
        self.max_valence, self.criteria, self.shapely = min(max_valence, CAPACITY), criteria, shapely

    def versions(self) -> Int64[ndarray, " n"]:
        return np.flatnonzero(self.is_alive)

    def faces(self) -> Int64[ndarray, "n 3"]:
        return np.array([face for face, is_alive in zip(self.corners, self.is_alive) if is_alive])


def finish(mesh: Mesh, work: Work, reached: bool) -> SelfParameterization:
    kept, faces = np.unique(work.faces(), return_inverse=True)
    return SelfParameterization(
        fine=mesh,
        faces=faces.reshape(-1, 3).astype(np.int64),
        decimated=mesh.vertices[kept],
        versions=work.versions().astype(np.int32),
        charts=charts_of(len(mesh.faces), work.steps),
        reached=reached,
        counts={name: int(n) for name, n in zip(REASONS, work.counts)},
        strategy="maps",
    )


# --- one level ---------------------------------------------------------------------------------------------------


def remove_level(work: Work, weight: float, most: int) -> list[int]:
    """Remove a maximal independent set, at most so many vertices; those that are gone.

    Maximal among what can be removed: a vertex that is refused keeps none of its neighbours from being removed.
    """
    faces = work.faces()
    topology = build_topology(faces, len(work.positions))
    first = faces[:, [1, 2, 0]].reshape(-1)[outgoing(topology)].tolist()
    stars: dict[int, Star] = {}

    def neighbours(v: int) -> list[int]:
        stars[v] = star_of(work, v, first[v])
        return stars[v].ring

    def is_removed(v: int) -> bool:
        reason = remove(work, stars[v])
        work.counts[reason] += 1
        return reason == LEGAL

    order = removal_order(work.positions, topology, weight).tolist()
    return independent_set(order, neighbours, is_removed, most)


def independent_set(
    order: Iterable[int], neighbours: Callable[[int], list[int]], accept: Callable[[int], bool], most: int
) -> list[int]:
    """Greedily, in this order: each vertex that touches none taken before, and is accepted."""
    taken: list[int] = []
    touched: set[int] = set()
    for v in order:
        if len(taken) == most:
            break
        if v not in touched:
            around = neighbours(v)
            if accept(v):
                taken.append(v)
                touched.update(around)
    return taken


# --- one vertex --------------------------------------------------------------------------------------------------


@dataclass
class Star:
    """A vertex with its d neighbours, counter-clockwise; local indices are 0 .. d - 1 for them and d for itself.

    On a boundary the ring begins and ends with its neighbours along the boundary, and has d - 1 faces.
    """

    vertex: int
    ring: list[int]
    faces: list[int]  # versions: face t has the ring's edge t

    @property
    def is_open(self) -> bool:
        return len(self.faces) < len(self.ring)


def sides(face: tuple[int, int, int]) -> tuple[tuple[int, int], ...]:
    a, b, c = face
    return (a, b), (b, c), (c, a)


def star_of(work: Work, v: int, first: int) -> Star:
    """The star of v, from the neighbour `first` on; on a boundary it must be the one without a face on its right."""
    star = Star(v, [first], [])
    face = work.face_of.get((v, first))
    while face is not None:
        star.faces.append(face)
        corners = work.corners[face]
        neighbour = corners[corners.index(v) - 1]
        if neighbour == first:
            break
        star.ring.append(neighbour)
        face = work.face_of.get((v, neighbour))
    return star


def remove(work: Work, star: Star) -> int:
    """Remove the vertex if that is legal; the reason (LEGAL: it is gone)."""
    d = len(star.ring)
    if d > work.max_valence:
        return VALENCE
    if d < 3:
        return BOUNDARY  # the only face of a corner: it has no other to go to
    points, uv = work.positions[[*star.ring, star.vertex]], np.zeros((d + 1, 2))
    flatten_ring(points, star.is_open, uv)
    fan = np.array([(d, t, (t + 1) % d) for t in range(len(star.faces))])
    if not all_proper(uv, fan):
        return PLANE_BEFORE
    made = delaunay(work.shapely, uv[:d])
    if len(made) != d - 2 or not all_proper(uv, made):
        return PLANE_AFTER
    if exists(work, star, made):
        return LINK
    look_in = partners(uv, made, len(fan))
    reason = check_removal(points, uv, fan, made, *look_in, star.is_open, work.criteria)
    if reason == LEGAL:
        replace(work, star, uv, made, *look_in)
    return reason


@njit(**COMPILED)
def all_proper(uv, faces):
    """Whether all faces are counter-clockwise, and points can be located in them to nine digits."""
    for row in range(len(faces)):
        area, squared = plane_face(uv, faces[row, 0], faces[row, 1], faces[row, 2])
        if not quality(squared, area) > THINNEST:
            return False
    return True


def delaunay(shapely: Any, ring: Float64[ndarray, "d 2"]) -> Int64[ndarray, "n 3"]:
    """Constrained Delaunay triangulation of a simple counter-clockwise polygon: corners, counter-clockwise."""
    triangles = shapely.constrained_delaunay_triangles(shapely.polygons(ring))
    index = {(x, y): t for t, (x, y) in enumerate(ring.tolist())}
    flat = [index[x, y] for x, y in shapely.get_coordinates(triangles).tolist()]
    return np.sort(np.array(flat, dtype=np.int64).reshape(-1, 4)[:, :3], axis=1)  # ascending: as the polygon runs


def exists(work: Work, star: Star, made: Int64[ndarray, "n 3"]) -> bool:
    """Whether an edge would come twice; or a face, where the ring has no room for a new edge."""
    ring, d = star.ring, len(star.ring)
    for face in made.tolist():
        for p, q in sides(face):
            is_old = q == p + 1 or (p == d - 1 and q == 0 and not star.is_open)
            if not is_old and ((ring[p], ring[q]) in work.face_of or (ring[q], ring[p]) in work.face_of):
                return True
    beyond = work.face_of.get((ring[1], ring[0])) if d == 3 else None
    return beyond is not None and ring[2] in work.corners[beyond]


def partners(
    uv: Float64[ndarray, "d+1 2"], made: Int64[ndarray, "n 3"], n_fan: int
) -> tuple[Int64[ndarray, " n_fan"], Int64[ndarray, " n"]]:
    """For each face of the fan the triangle that has its ring edge, and for each triangle a face of the fan that has
    one of its ring edges; of triangles that have none, the face that lies under the centroid."""
    d = len(uv) - 1
    of_fan, of_made = np.zeros(n_fan, np.int64), np.full(len(made), -1)
    for u, face in enumerate(made.tolist()):
        for p, q in sides(face):
            if q == (p + 1) % d and p < n_fan:
                of_fan[p], of_made[u] = u, p
        if of_made[u] < 0:
            x, y = uv[face].mean(axis=0)
            left = uv[:d, 0] * y - uv[:d, 1] * x >= 0  # of the line from the vertex through a neighbour
            of_made[u] = np.argmax((left & ~np.roll(left, -1))[:n_fan])
    return of_fan, of_made


@njit(**COMPILED)
def check_removal(points, uv, fan, made, of_fan, of_made, is_open, criteria):
    """Normals and quality in space, quality in the plane, as `criteria.py` has them for a collapse."""
    turn = fold = 1.0
    for t in range(len(of_fan)):
        turn = min(turn, bend(points, fan, t, made, of_fan[t]))
        if t > 0 or not is_open:
            fold = min(fold, bend(points, fan, t - 1 if t > 0 else len(fan) - 1, fan, t))
    for u in range(len(of_made)):
        turn = min(turn, bend(points, fan, of_made[u], made, u))
    if turn <= criteria[0] and turn <= fold:
        return NORMAL
    space_before, plane_before = worst_quality(points, uv, fan)
    space_after, plane_after = worst_quality(points, uv, made)
    if space_after <= min(criteria[1], space_before):
        return QUALITY_SPACE
    return QUALITY_PLANE if plane_after <= min(criteria[1], plane_before) else LEGAL


@njit(**INNER)
def bend(points, faces, t, others, u):
    """Dot product of the unit normals of two faces."""
    ax, ay, az, _ = normal_of(points, faces[t, 0], faces[t, 1], faces[t, 2])
    bx, by, bz, _ = normal_of(points, others[u, 0], others[u, 1], others[u, 2])
    return dot_of_units(ax, ay, az, bx, by, bz)


@njit(**INNER)
def worst_quality(points, uv, faces):
    """Least quality in space, and in the plane."""
    in_space = in_plane = 2.0
    for row in range(len(faces)):
        a, b, c = faces[row, 0], faces[row, 1], faces[row, 2]
        x, y, z, squared = normal_of(points, a, b, c)
        in_space = min(in_space, quality(squared, np.sqrt(x * x + y * y + z * z)))
        area, squared = plane_face(uv, a, b, c)
        in_plane = min(in_plane, quality(squared, area))
    return in_space, in_plane


def replace(
    work: Work, star: Star, uv: ndarray, made: ndarray, of_fan: ndarray, of_made: ndarray
) -> None:
    """Put the triangles in the place of the star, and keep the chart."""
    local = {v: t for t, v in enumerate([*star.ring, star.vertex])}
    before = [[local[v] for v in work.corners[face]] for face in star.faces]
    for face in star.faces:
        work.is_alive[face] = False
        for edge in sides(work.corners[face]):
            del work.face_of[edge]
    for a, b, c in made.tolist():
        face = (star.ring[a], star.ring[b], star.ring[c])
        work.face_of.update(dict.fromkeys(sides(face), len(work.corners)))
        work.corners.append(face)
        work.is_alive.append(True)
    work.steps.append(Step(uv, star.faces, np.column_stack([before, of_fan]), np.column_stack([made, of_made])))
