"""Signals on corners, through the map: what is torn along seams stays torn there, and nowhere else.

A signal on corners is a table `uv` (nT, k) and each corner's row in it, `uv_faces` (nF, 3).  Where the two faces of an
edge have the same values at its ends, it goes on across the edge; the other edges are seams, and the components that
they leave are charts.  A texture that is mirrored at an edge folds there: for k = 2 such an edge counts as a seam, too.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy import ndarray

from neusub.errors import ParameterizationError
from neusub.mesh import Mesh
from neusub.selfparam.parameterization import Refinement, SelfParameterization, refinement, weighted
from neusub.topology import build_topology

__all__ = ["inside", "locate_refined", "transfer_corners"]

INSET = 1e-8  # how far "just inside" a face is: of the way to its centroid
CLOSE = 1e-6  # of a column's range: values that differ by less are one
DEPTH = 1e-8  # barycentric depth in a refined face from which a seam counts as in it, not along it
PIECES, ROUNDS = 8, 12  # a seam edge is followed in so many pieces, which are halved so often where they cross an edge


def transfer_corners(
    parameterization: SelfParameterization,
    uv: Float64[ndarray, "nT k"],
    uv_faces: Int64[ndarray, "nF 3"],
    levels: int = 0,
) -> tuple[Float64[ndarray, "nT_L k"], Int64[ndarray, "nF_L 3"], Bool[ndarray, " nF_L"]]:
    """A signal on the corners of the fine mesh -> on those of the coarse mesh's `levels`-th refinement.

    Returns the signal's rows, each refined corner's row, and which refined faces' images a seam crosses.  The faces are
    numbered as in `topology.py`.  A corner has the value of its image, taken from the side on which the face lies; in
    faces that no seam crosses the rest follows linearly, in the others it is meaningless (`baking.bake` helps).
    Neighbouring corners share a row where their values agree up to 1e-6 of the column's range.
    Raises: ParameterizationError for arrays that do not fit the fine mesh, and for a negative level.
    """
    signal = checked_signal(uv, uv_faces, len(parameterization.fine.faces))
    refined = refinement(parameterization.faces, len(parameterization.decimated), levels)
    seams, chart = find_seams(parameterization.fine, signal)
    values, chart_at = corner_values(parameterization, refined, signal, chart)
    centre, _ = parameterization.to_fine(refined.owner, refined.corners.mean(axis=1))
    crosses = (chart_at != chart[centre][:, None]).any(axis=1)
    crosses |= crossed_by(parameterization, seams, levels, len(refined.faces))
    rows, row_of = shared_rows(refined, values, signal)
    return rows, row_of, crosses


class Signal(NamedTuple):
    """A checked signal on corners."""

    rows: ndarray  # (nT, k) float64
    row_of: ndarray  # (nF, 3) int64
    close: ndarray  # (k,): differences that do not count

    def at(self, faces: ndarray, barycentric: ndarray) -> ndarray:
        return weighted(self.rows, self.row_of[faces], barycentric)


def checked_signal(uv: Any, uv_faces: Any, n_faces: int) -> Signal:
    rows, row_of = np.asarray(uv, dtype=np.float64), np.asarray(uv_faces)
    if rows.ndim != 2 or 0 in rows.shape or row_of.dtype.kind not in "iu" or row_of.shape != (n_faces, 3):
        raise ParameterizationError(f"uv {rows.shape} and uv_faces {row_of.shape} of type {row_of.dtype}: give a "
                                    f"table (nT, k) and an integer row of it for each corner, ({n_faces}, 3).")
    bad = ((row_of < 0) | (row_of >= len(rows))).any(axis=1)
    if bad.any():
        at = int(np.argmax(bad))
        raise ParameterizationError(f"uv_faces {at} is {row_of[at].tolist()}, but uv has {len(rows)} rows.")
    bad = ~np.isfinite(rows).all(axis=1)
    if bad.any():
        at = int(np.argmax(bad))
        raise ParameterizationError(f"uv {at} is {rows[at].tolist()}: give finite values.")
    return Signal(rows, row_of.astype(np.int64), CLOSE * np.ptp(rows, axis=0) + 1e-12 * np.abs(rows).max(axis=0))


# --- seams -------------------------------------------------------------------------------------------------------


def find_seams(fine: Mesh, signal: Signal) -> tuple[Int64[ndarray, " nSeams"], Int64[ndarray, " nF"]]:
    """A half-edge of each seam, and each fine face's chart."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    rows, row_of, close = signal
    there, back = fine.topology.edge_halfedges[~fine.topology.is_boundary_edge].T
    tail, head = row_of.reshape(-1), row_of[:, [1, 2, 0]].reshape(-1)
    joined = np.ones(len(there), dtype=bool)
    for one, other in ((tail[there], head[back]), (head[there], tail[back])):
        joined &= (np.abs(rows[one] - rows[other]) <= close).all(axis=1)
    if rows.shape[1] == 2:
        side = np.sign(signed_areas(rows[row_of]))
        joined &= side[there // 3] * side[back // 3] >= 0
    pairs = there[joined] // 3, back[joined] // 3
    graph = coo_array((np.ones(len(pairs[0]), dtype=bool), pairs), shape=(len(row_of),) * 2)
    return there[~joined], connected_components(graph.tocsr(), directed=False)[1].astype(np.int64)


def signed_areas(corners: Float64[ndarray, "n 3 2"]) -> Float64[ndarray, " n"]:
    """Twice the area of plane triangles, negative for clockwise ones."""
    (x1, y1), (x2, y2) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    return x1 * y2 - y1 * x2


def crossed_by(
    parameterization: SelfParameterization, seams: Int64[ndarray, " nSeams"], levels: int, n_refined: int
) -> Bool[ndarray, " nF_L"]:
    """The refined faces that a seam enters: its edges are taken down, and followed where they leave a face.

    Pieces whose ends lie in different faces are halved again and again, so that faces of which a seam only cuts off a
    tip are found.  Not so where both ends lie on edges: a seam along an edge would be halved everywhere.
    """
    crossed = np.zeros(n_refined, dtype=bool)
    n_coarse = len(parameterization.faces)

    def sample(halfedge: ndarray, t: ndarray) -> tuple[ndarray, ndarray]:
        barycentric = np.zeros((len(t), 3))
        row = np.arange(len(t))
        barycentric[row, halfedge % 3], barycentric[row, (halfedge + 1) % 3] = 1 - t, t
        down = parameterization.to_coarse(halfedge // 3, barycentric)
        face, barycentric = locate_refined(*down, levels, n_coarse)
        depth = barycentric.min(axis=1)
        crossed[face[depth > DEPTH]] = True
        return face, depth

    t = np.linspace(0, 1, PIECES + 1)
    face, depth = (x.reshape(-1, PIECES + 1) for x in sample(np.repeat(seams, PIECES + 1), np.tile(t, len(seams))))
    halfedge, first, last = np.repeat(seams, PIECES), np.tile(t[:-1], len(seams)), np.tile(t[1:], len(seams))
    ends = [(face[:, :-1].ravel(), depth[:, :-1].ravel()), (face[:, 1:].ravel(), depth[:, 1:].ravel())]
    for _ in range(ROUNDS):
        (face_a, depth_a), (face_b, depth_b) = ends
        go_on = (face_a != face_b) & (np.maximum(depth_a, depth_b) > DEPTH)
        halfedge, first, last, face_a, depth_a, face_b, depth_b = (
            x[go_on] for x in (halfedge, first, last, face_a, depth_a, face_b, depth_b))
        middle = (first + last) / 2
        face_m, depth_m = sample(halfedge, middle)
        halfedge, first, last = np.tile(halfedge, 2), np.append(first, middle), np.append(middle, last)
        ends = [(np.append(face_a, face_m), np.append(depth_a, depth_m)),
                (np.append(face_m, face_b), np.append(depth_m, depth_b))]
    return crossed


def locate_refined(
    faces: Int64[ndarray, " n"], barycentric: Float64[ndarray, "n 3"], levels: int, n_faces: int
) -> tuple[Int64[ndarray, " n"], Float64[ndarray, "n 3"]]:
    """Points of a mesh of `n_faces` faces -> points of its `levels`-th refinement (figure in `topology.py`)."""
    faces, barycentric = faces.copy(), barycentric.copy()
    for _ in range(levels):
        block = np.where(barycentric.max(axis=1) >= 0.5, barycentric.argmax(axis=1), 3)
        for k in range(3):  # the child at corner k begins with it; the other two coordinates count from midpoints
            rows = np.flatnonzero(block == k)
            own = 2 * np.roll(barycentric[rows], -k, axis=1)
            own[:, 0] -= 1
            barycentric[rows] = own
        rows = np.flatnonzero(block == 3)  # [bc, ca, ab]
        barycentric[rows] = 1 - 2 * barycentric[rows]
        faces += block * n_faces
        n_faces *= 4
    return faces, barycentric


# --- corners -----------------------------------------------------------------------------------------------------


def inside(corners: Float64[ndarray, "n 3 3"], inset: float = INSET) -> Float64[ndarray, "n 3 3"]:
    """The corners of faces, moved a little towards their centroids."""
    return (1 - inset) * corners + inset * corners.mean(axis=1, keepdims=True)


def corner_values(
    parameterization: SelfParameterization, refined: Refinement, signal: Signal, chart: Int64[ndarray, " nF"]
) -> tuple[Float64[ndarray, "nF_L 3 k"], Int64[ndarray, "nF_L 3"]]:
    """The signal at each corner of the refined faces, and the chart it comes from.

    Most corners have the value of their vertex, which is exact.  The others lie beyond a seam: theirs is extrapolated
    from two points just inside, which is exact as well where both have the same fine face.
    """
    of_vertex = signal.at(*parameterization.to_fine(refined.at, refined.barycentric))[refined.faces].reshape(
        -1, signal.rows.shape[1])
    owner = np.repeat(refined.owner, 3)
    face, barycentric = parameterization.to_fine(owner, inside(refined.corners).reshape(-1, 3))
    values = signal.at(face, barycentric)
    beyond = np.flatnonzero((np.abs(values - of_vertex) > signal.close).any(axis=1))
    farther = inside(refined.corners, 2 * INSET).reshape(-1, 3)[beyond]
    same, barycentric = parameterization.to_fine(owner[beyond], farther)
    second = np.where((same == face[beyond])[:, None], signal.at(same, barycentric), values[beyond])
    of_vertex[beyond] = 2 * values[beyond] - second
    return of_vertex.reshape(len(refined.faces), 3, -1), chart[face].reshape(-1, 3)


def shared_rows(
    refined: Refinement, values: Float64[ndarray, "nF_L 3 k"], signal: Signal
) -> tuple[Float64[ndarray, "nT_L k"], Int64[ndarray, "nF_L 3"]]:
    """One row for corners at one vertex whose faces meet in an edge and whose values agree."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    topology = build_topology(refined.faces, refined.sizes[-1])
    there, back = topology.edge_halfedges[~topology.is_boundary_edge].T
    after = np.arange(refined.faces.size).reshape(-1, 3)[:, [1, 2, 0]].reshape(-1)
    flat = values.reshape(refined.faces.size, -1)
    one, other = np.append(there, after[there]), np.append(after[back], back)
    agree = (np.abs(flat[one] - flat[other]) <= 2 * signal.close).all(axis=1)
    graph = coo_array((np.ones(agree.sum(), dtype=bool), (one[agree], other[agree])), shape=(refined.faces.size,) * 2)
    count, row_of = connected_components(graph.tocsr(), directed=False)
    rows = np.empty((count, flat.shape[1]))
    rows[row_of[::-1]] = flat[::-1]  # of equals the first counts
    return rows, row_of.reshape(-1, 3).astype(np.int64)
