"""Fitting a map: coarse vertices slide along the surface where that brings the refinement closer.  Not in the paper.

A decimation chooses collapses by planes, and conformal maps say where on the surface a coarse vertex comes to lie;
neither looks at the refinement.  The image of a vertex on a fingertip may be halfway down the finger, and the
refinement then cuts the tip off.

    fitted      some passes over all vertices that may move
    fit_vertex  four places around a vertex in the plane of its ring; it goes to the best, if that is better
    error_at    for one place: the refinement of the ring, and how far the samples in the ring are from it
    slide       keep the chart

A slide is a chart as a collapse is (`mapping.py`).  The vertex's d neighbours go into the plane by z^a; there it goes
from the centre (local index d) to another place (d + 1), and each face keeps its outer edge (t, t + 1).  Samples are
the fine mesh's vertices, each as much as its area; of very fine meshes a random part of them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy import ndarray

from neusub.compilation import COMPILED, INNER, announce
from neusub.errors import ParameterizationError
from neusub.selfparam.criteria import plane_face, quality
from neusub.selfparam.distances import squared_distance
from neusub.selfparam.flatten import THINNEST, flatten_ring
from neusub.selfparam.mapping import CAPACITY, MADE, Charts, finished, go_up, grown, locate, set_corners
from neusub.selfparam.parameterization import SelfParameterization, corner_points
from neusub.selfparam.placement import scatter, unit_normals
from neusub.selfparam.surface import ONE, ZERO, after, before, copy_row, frame_of

__all__ = ["fitted"]

STEP = 0.25  # of the distance to the closest neighbour in the plane
GAIN = 0.02  # a slide must take so much off the error: the map gets no longer for nothing
MIN_QUALITY = 0.2  # of the faces in the plane, as `Criteria` has it
CALM = 0.5  # a ring whose mean squared distance is less than so much of the mean over all stays: even faces stay even
NEGLIGIBLE = 1e-9  # distance, of the box's diagonal: rounding
MOST_PASSES = 20  # after some eight the remeshes hardly change
DENSE = 16  # samples for each refined triangle are enough
FOLD = 0.05  # what a refined triangle that faces away costs a sample: of its squared edge


class Fit(NamedTuple):
    """Everything that the kernels work on."""

    faces: ndarray  # (nF0, 3) int32: the coarse mesh
    twins: ndarray  # (3 nF0,) int32
    starts: ndarray  # (nV0,) int32: a half-edge that leaves each vertex; -1 where it stays
    images: ndarray  # (nV0, 3): of the coarse vertices
    versions: ndarray  # (nF0,) int32
    charts: Charts
    fine_positions: ndarray  # (nV, 3)
    fine_faces: ndarray  # (nF, 3)
    samples: ndarray  # (n, 3)
    normals: ndarray  # (n, 3): of the samples, not normalised
    weights: ndarray  # (n,): the area around each sample, up to a factor
    at: ndarray  # (n,) int32: the coarse face that each sample lies in
    barycentric: ndarray  # (n, 3): and where
    first: ndarray  # (nF0,) int32: a sample of each coarse face; -1: none
    following: ndarray  # (n,) int32: the next one of the same face
    halfedges: ndarray  # (capacity,) int32, scratch: the half-edges that leave the vertex, counter-clockwise
    points: ndarray  # (capacity + 1, 3), scratch: the neighbours, the vertex
    uv: ndarray  # (capacity + 2, 2), scratch
    fans: ndarray  # (2, capacity, 4) uint16, scratch: local corners of the faces before and after
    patch: ndarray  # (capacity, side + 1, side + 1, 3), scratch: points of the refinement, [t, a, b] a / side of the
    # way from the vertex to neighbour t and b / side of that to the next one
    members: ndarray  # (n,) int32, scratch: the samples in the ring
    places: ndarray  # (n, 2), scratch: theirs in the plane
    version: ndarray  # (1,) int32, scratch: of one point on its way up
    point: ndarray  # (1, 3), scratch


def fitted(result: SelfParameterization, levels: int = 2, passes: int = 5) -> SelfParameterization:
    """See `SelfParameterization.fitted`."""
    if not 0 <= levels <= 6:
        raise ParameterizationError(f"levels = {levels}: take a number from 0 to 6.")
    if not 0 <= passes <= MOST_PASSES:
        raise ParameterizationError(f"passes = {passes}: take a number from 0 to {MOST_PASSES}.")
    announce(fit_pass, "the fitting kernels")
    centre, scale = frame_of(result.fine.vertices)
    fit = with_room(prepare(result, 2**levels, centre, scale), passes)
    least = (NEGLIGIBLE * np.linalg.norm(np.ptp(fit.fine_positions, axis=0))) ** 2
    _, mean = fit_pass(fit, np.inf)  # nothing slides
    for _ in range(passes):
        slid, mean = fit_pass(fit, max(CALM * mean, least))
        if slid == 0:
            break
    return replace(result, decimated=fit.images * scale + centre, versions=fit.versions, charts=finished(fit.charts))


def prepare(result: SelfParameterization, side: int, centre: ndarray, scale: float) -> Fit:
    """The kernels' arrays; side: parts of a coarse edge in the refinement."""
    fine, topology = result.fine, result.coarse.topology
    positions = np.ascontiguousarray((fine.vertices - centre) / scale)
    n_coarse, chosen = len(result.faces), some_vertices(len(positions), DENSE * len(result.faces) * side**2)
    unit, size = unit_normals(positions[fine.faces])
    sums = np.zeros((len(positions), 4))  # of each vertex's faces: normals, sizes
    scatter(sums, fine.faces, np.column_stack([size[:, None] * unit, size]))
    at, barycentric = result.to_coarse(*(rows[chosen] for rows in corner_points(fine.faces, len(positions))))
    starts = np.empty(topology.n_vertices, np.int32)
    starts[result.faces.reshape(-1)] = np.arange(3 * n_coarse)
    starts[topology.is_boundary_vertex | (topology.valence > CAPACITY)] = -1
    capacity = int(topology.valence[starts >= 0].max(initial=0))
    fit = Fit(
        faces=result.faces.astype(np.int32),
        twins=topology.twins.astype(np.int32),
        starts=starts,
        images=(result.on_surface.vertices - centre) / scale,
        versions=result.versions.copy(),
        charts=result.charts,
        fine_positions=positions,
        fine_faces=fine.faces,
        samples=positions[chosen],
        normals=sums[chosen, :3],
        weights=sums[chosen, 3],
        at=at.astype(np.int32),
        barycentric=barycentric,
        first=np.full(n_coarse, -1, np.int32),
        following=np.full(len(chosen), -1, np.int32),
        **scratch(len(chosen), capacity, side),
    )
    link(fit)
    return fit


def some_vertices(n: int, most: int) -> ndarray:
    """All of n, or so many random ones."""
    return np.arange(n) if n <= most else np.sort(np.random.default_rng(0).choice(n, most, replace=False))


def scratch(n: int, capacity: int, side: int) -> dict[str, ndarray]:
    """For n samples and rings of so many neighbours."""
    return {
        "halfedges": np.zeros(capacity, np.int32),
        "points": np.zeros((capacity + 1, 3)),
        "uv": np.zeros((capacity + 2, 2)),
        "fans": np.zeros((2, capacity, 4), np.uint16),
        "patch": np.zeros((capacity, side + 1, side + 1, 3)),
        "members": np.zeros(n, np.int32),
        "places": np.zeros((n, 2)),
        "version": np.zeros(1, np.int32),
        "point": np.zeros((1, 3)),
    }


def with_room(fit: Fit, passes: int) -> Fit:
    """In each pass a vertex slides at most once, over all of its faces; a slide has two places more."""
    charts = fit.charts
    slots = len(charts.uv) + passes * (3 * len(fit.faces) + len(fit.starts))
    n_charts = len(charts.starts) - 1 + passes * len(fit.starts)
    return fit._replace(charts=grown(charts, len(fit.fine_faces), n_charts, slots))


# --- kernels -----------------------------------------------------------------------------------------------------


@njit(**COMPILED)
def link(fit):
    """List the samples of each coarse face."""
    for k in range(len(fit.at)):
        fit.following[k] = fit.first[fit.at[k]]
        fit.first[fit.at[k]] = k


@njit(**COMPILED)
def fit_pass(fit, calm):
    """One pass over all vertices: how many of them slid, and the mean squared distance in all rings, before they did.

    calm: mean squared distance in a ring that stays.
    """
    slid, error, weight = 0, 0.0, 0.0
    for v in range(len(fit.starts)):
        d, count, worst = open_ring(fit, v)
        if d > 0:
            before = error_at(fit, d, count, 0.0, 0.0)
            around = weight_of(fit, count)
            error += before
            weight += around
            if before > calm * around:
                slid += fit_vertex(fit, v, d, count, worst, before)
    return slid, error / weight if weight > 0.0 else 0.0


@njit(**INNER)
def fit_vertex(fit, v, d, count, worst, error):
    """Whether the vertex slid; d, count, worst: of its open ring, with this error."""
    least = error * (1 - GAIN)
    uv, closest = fit.uv, np.inf
    for t in range(d):
        closest = min(closest, np.sqrt(uv[t, 0] * uv[t, 0] + uv[t, 1] * uv[t, 1]))
    best_x = best_y = 0.0
    for direction in range(4):
        x = STEP * closest * ((direction == 0) - (direction == 2))
        y = STEP * closest * ((direction == 1) - (direction == 3))
        uv[d + 1, 0], uv[d + 1, 1] = x, y
        if worst_of(fit, ONE, d) > min(MIN_QUALITY, worst):
            there = error_at(fit, d, count, x, y)
            if there < least:
                least, best_x, best_y = there, x, y
    if best_x == 0.0 and best_y == 0.0:
        return False
    slide(fit, v, d, count, best_x, best_y)
    return True


@njit(**INNER)
def open_ring(fit, v):
    """Bring the ring of a vertex into the plane, and its samples.

    Its number of neighbours (0: it must stay, or its ring cannot be flattened), samples, and least quality there.
    """
    if fit.starts[v] < 0:
        return 0, 0, 0.0
    d = gather(fit, v)
    flatten_ring(fit.points[: d + 1], False, fit.uv)
    worst = worst_of(fit, ZERO, d)
    if not worst > THINNEST:
        return 0, 0, 0.0
    count = gather_samples(fit, d)
    fill_outline(fit, d)
    return d, count, worst


@njit(**INNER)
def weight_of(fit, count):
    weight = 0.0
    for n in range(count):
        weight += fit.weights[fit.members[n]]
    return weight


@njit(**INNER)
def gather(fit, v):
    """Fill the ring of a vertex, and the two fans in the plane; its number of neighbours."""
    start = np.int64(fit.starts[v])
    h, d = start, 0
    while True:
        fit.halfedges[d] = h
        copy_row(fit.points, d, fit.images, np.int64(fit.faces[h // 3, after(h) % 3]))
        d += 1
        h = np.int64(fit.twins[before(h)])
        if h == start:
            break
    copy_row(fit.points, d, fit.images, v)
    for t in range(d):
        corner = fit.halfedges[t] % 3
        for k in range(2):
            set_corners(fit.fans[k], t, corner, d + k, t, (t + 1) % d, t)
    return d


@njit(**INNER)
def worst_of(fit, which, d):
    """Least quality in the plane of a fan's faces; not positive where one is turned over."""
    worst = 2.0
    for t in range(d):
        area, squared = plane_face(fit.uv, d + which, t, (t + 1) % d)
        worst = min(worst, quality(squared, area))
    return worst


@njit(**INNER)
def gather_samples(fit, d):
    """Fill members and their places in the plane; how many there are."""
    count = 0
    for t in range(d):
        k = fit.first[fit.halfedges[t] // 3]
        while k >= 0:
            fit.members[count] = k
            for axis in range(2):
                place = 0.0
                for i in range(3):
                    place += fit.barycentric[k, i] * fit.uv[fit.fans[0, t, i], axis]
                fit.places[count, axis] = place
            count += 1
            k = fit.following[k]
    return count


@njit(**COMPILED)
def fill(fit, d, t, a, b, x, y):
    """The point of the refinement that is a and b steps from the vertex, on the surface, where that lies at (x, y)."""
    uv, side, point = fit.uv, fit.patch.shape[1] - 1, fit.point
    u, v, s = a / side, b / side, (t + 1) % d
    px = (1 - u - v) * x + u * uv[t, 0] + v * uv[s, 0]
    py = (1 - u - v) * y + u * uv[t, 1] + v * uv[s, 1]
    row = locate(uv, ZERO, fit.fans[0], ZERO, d, t, px, py, point[0])
    fit.version[0] = fit.versions[fit.halfedges[row] // 3]
    go_up(fit.charts, fit.version, point, ZERO, ONE)
    face = fit.fine_faces[fit.version[0]]
    for axis in range(3):
        fit.patch[t, a, b, axis] = (
            point[0, 0] * fit.fine_positions[face[0], axis] + point[0, 1] * fit.fine_positions[face[1], axis]
            + point[0, 2] * fit.fine_positions[face[2], axis])


@njit(**INNER)
def fill_outline(fit, d):
    """The points on the outer edges, which stay."""
    side = fit.patch.shape[1] - 1
    for t in range(d):
        for a in range(side + 1):
            fill(fit, d, t, a, side - a, 0.0, 0.0)


@njit(**INNER)
def error_at(fit, d, count, x, y):
    """Sum over the samples of their area times their squared distance to the refinement, the vertex being at (x, y)."""
    side, uv = fit.patch.shape[1] - 1, fit.uv
    uv[d + 1, 0], uv[d + 1, 1] = x, y
    fill(fit, d, ZERO, ZERO, ZERO, x, y)
    for t in range(d):
        for a in range(side):
            for b in range(side - a):
                if a > 0:  # the points with a = 0 are those with b = 0 of the next face
                    fill(fit, d, t, a, b, x, y)
    for t in range(d):
        for b in range(side):
            for axis in range(3):
                source = fit.patch[0, 0, 0, axis] if b == 0 else fit.patch[(t + 1) % d, b, 0, axis]
                fit.patch[t, 0, b, axis] = source
    total = 0.0
    row = ZERO
    for n in range(count):
        row = locate(uv, ZERO, fit.fans[1], ZERO, d, row, fit.places[n, 0], fit.places[n, 1], fit.point[0])
        corner, k = fit.halfedges[row] % 3, fit.members[n]
        a, b = fit.point[0, (corner + 1) % 3] * side, fit.point[0, (corner + 2) % 3] * side
        total += fit.weights[k] * distance(fit, k, row, a, b)
    return total


@njit(**COMPILED)
def distance(fit, k, t, a, b):
    """Squared distance of sample k to the triangle of the patch with the point (a, b); more where that faces away."""
    side = fit.patch.shape[1] - 1
    i = min(int(a), side - 1)
    j = min(int(b), side - 1 - i)
    if a - i + b - j <= 1 or i + j + 1 == side:
        p, q, r = fit.patch[t, i, j], fit.patch[t, i + 1, j], fit.patch[t, i, j + 1]
    else:
        p, q, r = fit.patch[t, i + 1, j + 1], fit.patch[t, i, j + 1], fit.patch[t, i + 1, j]
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    at, normal = fit.samples[k], fit.normals[k]
    x, y, z = at[0] - p[0], at[1] - p[1], at[2] - p[2]
    facing = ((uy * vz - uz * vy) * normal[0] + (uz * vx - ux * vz) * normal[1] + (ux * vy - uy * vx) * normal[2])
    fold = FOLD * (ux * ux + uy * uy + uz * uz) if facing < 0.0 else 0.0
    return fold + squared_distance(ux, uy, uz, vx, vy, vz, x, y, z)


@njit(**INNER)
def slide(fit, v, d, count, x, y):
    """Keep the chart of a slide to (x, y), and take versions, image and samples along."""
    charts, uv = fit.charts, fit.uv
    fill(fit, d, ZERO, ZERO, ZERO, x, y)
    for axis in range(3):
        fit.images[v, axis] = fit.patch[0, 0, 0, axis]
    uv[d + 1, 0], uv[d + 1, 1] = x, y
    c, version = charts.used
    first_uv, row, _ = charts.starts[c]
    made = version - charts.starts[0, MADE]
    for i in range(d + 2):
        copy_row(charts.uv, first_uv + i, uv, i)
    for t in range(d):
        face = fit.halfedges[t] // 3
        copy_row(charts.before, row + t, fit.fans[0], t)
        copy_row(charts.after, made + t, fit.fans[1], t)
        charts.old[row + t], charts.made_by[version + t] = fit.versions[face], c
        fit.versions[face] = version + t
        fit.first[face] = -1
    charts.starts[c + 1, 0], charts.starts[c + 1, 1] = first_uv + d + 2, row + d
    charts.starts[c + 1, MADE] = charts.used[1] = version + d
    charts.used[0] = c + 1
    row = ZERO
    for n in range(count):
        k = fit.members[n]
        row = locate(uv, ZERO, fit.fans[1], ZERO, d, row, fit.places[n, 0], fit.places[n, 1], fit.point[0])
        face = fit.halfedges[row] // 3
        copy_row(fit.barycentric, k, fit.point, ZERO)
        fit.at[k], fit.following[k], fit.first[face] = face, fit.first[face], k
