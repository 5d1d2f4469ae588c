"""`decimate`: the door to the collapse kernels.  Checks, normalises, prepares, and lets the charts grow."""

from __future__ import annotations

from collections.abc import Callable
from numbers import Integral
from typing import Any, Literal

import numpy as np
from numpy import ndarray

from neusub.compilation import announce
from neusub.errors import DecimationError
from neusub.mesh import Mesh, check_is_mesh
from neusub.selfparam.appearance import attribute_quadrics, seam_holds
from neusub.selfparam.collapse import DONE, FULL, PAUSED, Work, collapse_null_edges, first_null_edge, offer_all, run
from neusub.selfparam.criteria import REASONS, Criteria
from neusub.selfparam.flatten import LARGEST_RING, make_solver
from neusub.selfparam.locality import LARGE, Order, file_order, local_order, reordered
from neusub.selfparam.mapping import finished, grown, make_charts
from neusub.selfparam.parameterization import SelfParameterization
from neusub.selfparam.placement import (
    PLACE,
    STRATEGIES,
    TIES,
    USER,
    Strategy,
    no_user,
    vertex_quadrics,
)
from neusub.selfparam.queue import make_queue
from neusub.selfparam.surface import BORDER, FIXED, FREE, SEAMS, TWIN, VERSION, WIDTH, Surface, frame_of, make_ring
from neusub.topology import Topology

__all__ = ["decimate"]

PAUSE = 20_000  # edges tried between two reports of progress
CHART_SLOTS = 13  # room for each collapse to begin with: ten or eleven are usual


def decimate(
    mesh: Mesh,
    *,
    n_vertices: int | None = None,
    n_faces: int | None = None,
    strategy: str | Any = "quadric",
    seed: int = 0,
    criteria: Criteria | None = None,
    flattening: Literal["conformal", "uniform"] = "conformal",
    sharp_boundary_angle: float | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> SelfParameterization:
    """Collapse edges down to a number of vertices or faces, and keep a bijective map between both meshes.

    strategy: one of `STRATEGIES`, or a function compiled by `numba.cfunc(neusub.selfparam.PLACE)` (`placement.py`).
    seed: of the strategies that draw edges.  criteria: which collapses are legal; the paper's by default.
    flattening: of each ring, conformal as the paper's; uniform (Tutte) for comparison, but where one end of the edge is
    on a boundary, which is conformal always.
    sharp_boundary_angle: degrees; boundary vertices that turn by more never move.
    on_progress: called now and then with the vertices (or faces) that are left, and the target.
    A target that cannot be reached gives a result with `reached=False` and the refused collapses counted by reason.
    Raises: DecimationError unless there is exactly one target, from 1 to what the mesh has; for an unknown strategy, or
    a seed below 0; TypeError for what is no mesh.
    Source: Liu et al. 2020, section 4.1 and appendix B; DESIGN.md 4 for boundaries.
    """
    check_is_mesh(mesh)
    targets = checked_targets(mesh, n_vertices, n_faces)
    plan, user = checked_strategy(strategy)
    if not isinstance(seed, Integral) or seed < 0:
        raise DecimationError(f"seed = {seed!r}: take a whole number, at least 0.")
    if sharp_boundary_angle is not None and not sharp_boundary_angle >= 0:
        raise DecimationError(f"sharp_boundary_angle = {sharp_boundary_angle}: take degrees, at least 0.")
    work, order, frame = prepare(mesh, plan, targets, seed, criteria or Criteria(), flattening, sharp_boundary_angle)
    announce(run, "the decimation kernels")
    work, status = collapse_all(work, user, targets, on_progress)
    centre, scale = frame
    work.surface.positions[:] = work.surface.positions * scale + centre
    return finish(mesh, work, order, status == DONE, strategy if isinstance(strategy, str) else "user", seed)


# --- checks ------------------------------------------------------------------------------------------------------


def checked_targets(mesh: Mesh, n_vertices: int | None, n_faces: int | None) -> tuple[int, int]:
    """Both bounds for the kernel; 0 is none."""
    if (n_vertices is None) == (n_faces is None):
        raise DecimationError(f"n_vertices = {n_vertices}, n_faces = {n_faces}: give exactly one target.")
    for name, value, most in (("n_vertices", n_vertices, len(mesh.vertices)), ("n_faces", n_faces, len(mesh.faces))):
        if value is not None and (isinstance(value, bool) or not isinstance(value, Integral)):
            raise DecimationError(f"{name} = {value!r}: take a whole number.")
        if value is not None and not 1 <= value <= most:
            raise DecimationError(f"{name} = {value}: the mesh has {most}. Take a target from 1 to {most}.")
    return n_vertices or 0, n_faces or 0


def checked_strategy(strategy: str | Any) -> tuple[Strategy, Any]:
    """What the kernel is told of a strategy, and a user's compiled function."""
    if isinstance(strategy, str):
        if strategy not in STRATEGIES:
            raise DecimationError(f"strategy {strategy!r} is not one of {', '.join(STRATEGIES)}, nor a function "
                                  "compiled by numba.cfunc(neusub.selfparam.PLACE).")
        return STRATEGIES[strategy], no_user
    if not hasattr(strategy, "_wrapper_name"):  # what numba.cfunc makes
        raise DecimationError(f"strategy {strategy!r} is no compiled function. Decorate it with "
                              "@numba.cfunc(neusub.selfparam.PLACE).")
    if strategy._sig != PLACE:
        raise DecimationError(f"strategy {strategy.__name__} is compiled for {strategy._sig}, not for {PLACE}. "
                              "Decorate it with @numba.cfunc(neusub.selfparam.PLACE).")
    return Strategy(USER), strategy


# --- before and after the kernel ---------------------------------------------------------------------------------


def prepare(mesh: Mesh, plan: Strategy, targets: tuple[int, int], seed: int, criteria: Criteria, flattening: str,
            sharp_boundary_angle: float | None) -> tuple[Work, Order, tuple[ndarray, float]]:
    """The kernel's arrays, the order of their vertices and faces, and what brings positions back: centre and scale."""
    if flattening not in ("conformal", "uniform"):
        raise DecimationError(f"flattening {flattening!r} is not one of conformal, uniform.")
    centre, scale = frame_of(mesh.vertices)
    positions = np.ascontiguousarray((mesh.vertices - centre) / scale)
    topology, n_faces = mesh.topology, len(mesh.faces)
    starts = outgoing(topology)
    holds, is_seam = np.full(len(positions), FREE, dtype=np.uint8), np.zeros(3 * n_faces, dtype=np.bool_)
    if plan.keeps_appearance:
        holds, is_seam = seam_holds(mesh)
    if sharp_boundary_angle is not None:
        holds[sharp_boundary_vertices(positions, topology, sharp_boundary_angle)] = FIXED
    holds[topology.is_boundary_vertex] += BORDER
    surface = Surface(positions, face_rows(topology, is_seam), starts, holds, np.zeros(len(positions), np.int32))
    is_open = bool(topology.is_boundary_edge.any())
    spread = TIES if plan.breaks_ties and not is_open else plan.spread
    quadrics, areas = vertex_quadrics(positions, topology, spread)
    gradients = np.zeros((len(positions), 0, 5))
    if plan.keeps_appearance:
        more, gradients = attribute_quadrics(mesh, positions)
        quadrics += more
    order = file_order(len(positions), n_faces)
    if n_faces > LARGE:
        order = local_order(positions, surface.faces[:, :3])
        surface = reordered(surface, order)
        quadrics, gradients = quadrics[order.vertices], gradients[order.vertices]
    capacity = min(2 * int(topology.valence.max()) + 64, LARGEST_RING)
    collapses = expected_collapses(mesh, targets)
    work = Work(
        surface=surface,
        charts=make_charts(n_faces, collapses, CHART_SLOTS * collapses + capacity),
        queue=make_queue(3 * n_faces, len(topology.edges), plan.choices == 0),
        ring=make_ring(capacity),
        solver=make_solver(capacity),
        quadrics=quadrics,
        refused=np.ones(len(positions), np.bool_),  # the queue is empty
        gradients=gradients,
        quadric=np.zeros(10),
        position=np.zeros(3),
        criteria=criteria.packed(),
        area=np.array([areas.sum()]),
        counts=np.zeros(len(REASONS), np.int64),
        sizes=np.array([len(positions), n_faces, 0]),
        random=np.random.SeedSequence(seed).generate_state(1, np.uint64),
        options=np.array([plan.code, plan.choices, flattening == "conformal"], dtype=np.int64),
    )
    return work, order, (centre, scale)


def expected_collapses(mesh: Mesh, targets: tuple[int, int]) -> int:
    """At most so many collapses are needed; each removes a vertex, and one or two faces."""
    if targets[0]:
        return len(mesh.vertices) - targets[0] + 1
    return min(len(mesh.faces) - targets[1], len(mesh.vertices)) + 1


def collapse_all(work: Work, user: Any, targets: tuple[int, int], on_progress: Any) -> tuple[Work, int]:
    """Run the kernels to the end, with more room for the charts whenever they ask for it."""
    n_faces = len(work.surface.faces)
    at = first_null_edge(work.surface)
    while at < 3 * n_faces:
        at = collapse_null_edges(work, user, at, *targets)
        if at < 3 * n_faces:
            work = with_room(work, n_faces)
    offer_all(work, user)
    while True:
        status = run(work, user, *targets, PAUSE)
        if on_progress:
            on_progress(int(work.sizes[0 if targets[0] else 1]), max(targets))
        if status == FULL:
            work = with_room(work, n_faces)
        elif status != PAUSED:
            return work, status


def with_room(work: Work, n_faces: int) -> Work:
    slots = len(work.charts.before)
    return work._replace(charts=grown(work.charts, n_faces, len(work.charts.starts) - 1, slots + slots // 2 + 1024))


def finish(mesh: Mesh, work: Work, order: Order, reached: bool, strategy: str, seed: int) -> SelfParameterization:
    """Number the vertices and faces that are left, in the mesh's order, and cut the charts to size."""
    surface = work.surface
    alive = np.flatnonzero(surface.faces[:, 0] >= 0)
    alive = alive[np.argsort(order.faces[alive])]
    kept, faces = np.unique(order.vertices[surface.faces[alive, :3]], return_inverse=True)
    place = np.empty(len(mesh.vertices), np.int32)
    place[order.vertices] = np.arange(len(place), dtype=np.int32)
    return SelfParameterization(
        fine=mesh,
        faces=faces.reshape(-1, 3).astype(np.int64),
        decimated=surface.positions[place[kept]],
        versions=surface.faces[alive, VERSION],
        charts=finished(work.charts),
        reached=reached,
        counts={name: int(n) for name, n in zip(REASONS, work.counts)},
        strategy=strategy,
        seed=seed,
    )


def face_rows(topology: Topology, is_seam: ndarray) -> ndarray:
    """`Surface.faces`."""
    rows = np.empty((len(topology.faces), WIDTH), np.int32)
    rows[:, :VERSION], rows[:, VERSION] = topology.faces, np.arange(len(rows))
    rows[:, TWIN:SEAMS], rows[:, SEAMS] = topology.twins.reshape(-1, 3), is_seam.reshape(-1, 3) @ [1, 2, 4]
    return rows


def outgoing(topology: Topology) -> ndarray:
    """A half-edge that leaves each vertex; on the boundary the one without twin."""
    tails = topology.faces.reshape(-1)
    starts = np.zeros(topology.n_vertices, dtype=np.int32)
    starts[tails] = np.arange(len(tails))
    border = np.flatnonzero(topology.twins < 0)
    starts[tails[border]] = border
    return starts


def sharp_boundary_vertices(positions: ndarray, topology: Topology, angle: float) -> ndarray:
    """Whether the boundary turns by more than so many degrees at a vertex."""
    border = topology.edge_halfedges[topology.is_boundary_edge].max(axis=1)
    a = topology.faces[border // 3, border % 3]
    b = topology.faces[border // 3, (border % 3 + 1) % 3]
    direction = positions[b] - positions[a]
    leaves, arrives = np.zeros((2, len(positions), 3))
    leaves[a], arrives[b] = direction, direction
    turn = np.arctan2(np.linalg.norm(np.cross(arrives, leaves), axis=1), (arrives * leaves).sum(axis=1))
    return topology.is_boundary_vertex & (turn > np.radians(angle))
