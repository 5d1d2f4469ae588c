"""What a mesh is and what is wrong with it (`info`), and the repairs that need no guess (`repair`)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from numpy import ndarray

from neusub.errors import MeshError, NonFiniteError
from neusub.flat_faces import double_areas, edge_lengths, is_flat, mend_flat_faces
from neusub.mesh import Mesh
from neusub.problems import duplicate_faces, face_edge_groups, find_problems, non_finite_problems, vertex_fans
from neusub.raw import RawMesh, count_coincident
from neusub.raw import weld as weld_borders
from neusub.topology import build_topology, connected_components

__all__ = ["MeshInfo", "info", "repair"]


@dataclass(frozen=True)
class MeshInfo:
    """Sizes, topology and quality of a mesh, with every problem.  Lengths are in the mesh's own unit.

    genus: handles of all components together; None where it is undefined (not manifold or not orientable).
    coincident_edges: the boundary edges that lie where just one other does, which `repair` joins if asked to weld.
    quality: 4 sqrt(3) area / (sum of the squared edge lengths), 1 for an equilateral triangle, 0 for a flat one.
    """

    n_vertices: int
    n_edges: int
    n_faces: int
    components: int
    genus: int | None
    boundary_loops: int | None
    boundary_edges: int
    coincident_edges: int
    box: tuple[float, float, float]
    edge_length: tuple[float, float, float]  # least, mean, greatest
    quality: tuple[float, float]  # least, mean
    zero_area_faces: int
    contents: tuple[str, ...]
    report: tuple[str, ...]
    problems: tuple[MeshError, ...]

    def __str__(self) -> str:
        apart = f"{self.coincident_edges} boundary edges lie on each other. Run 'neusub repair --weld' to join them."
        lines = [
            f"vertices {self.n_vertices:,}   edges {self.n_edges:,}   faces {self.n_faces:,}",
            f"components {self.components}   genus {_or_undefined(self.genus)}   "
            f"boundary loops {_or_undefined(self.boundary_loops)} ({self.boundary_edges} edges)",
            "box " + " x ".join(f"{x:.6g}" for x in self.box),
            "edge length least {:.4g}, mean {:.4g}, greatest {:.4g}".format(*self.edge_length),
            "triangle quality least {:.3f}, mean {:.3f}   ".format(*self.quality)
            + f"zero-area faces {self.zero_area_faces}",
            "with " + (", ".join(self.contents) or "positions and faces only"),
            *(f"read: {line}" for line in self.report),
            *([f"hint: {apart}"] if self.coincident_edges else []),
            *(f"problem: {type(problem).__name__}: {problem}" for problem in self.problems),
        ]
        return "\n".join(lines if self.problems else [*lines, "no problems"])


def info(raw: RawMesh | Mesh) -> MeshInfo:
    """Everything `MeshInfo` holds; never raises for a bad mesh."""
    problems = tuple(find_problems(raw.vertices, raw.faces))
    report = tuple(raw.load_report if isinstance(raw, Mesh) else raw.report)
    inside = (raw.faces >= 0) & (raw.faces < len(raw.vertices))
    faces = raw.faces[inside.all(axis=1)]
    corners = raw.vertices[faces]
    with np.errstate(all="ignore"):
        lengths, quality = edge_lengths(corners), _qualities(corners)
        extent = raw.vertices.max(axis=0) - raw.vertices.min(axis=0) if len(raw.vertices) else np.zeros(3)
    groups = face_edge_groups(faces, len(raw.vertices)) if len(faces) else None
    components = connected_components(faces, len(raw.vertices))[1] if len(faces) else np.zeros(0, dtype=np.int64)
    n_components = len(np.unique(components[faces])) if len(faces) else 0
    genus, loops = _genus_and_loops(faces, len(raw.vertices), n_components, problems)
    length = (float(lengths.min()), float(lengths.mean()), float(lengths.max())) if len(faces) else (0.0, 0.0, 0.0)
    return MeshInfo(
        n_vertices=len(raw.vertices),
        n_edges=0 if groups is None else len(groups.counts),
        n_faces=len(raw.faces),
        components=n_components,
        genus=genus,
        boundary_loops=loops,
        boundary_edges=0 if groups is None else int((groups.counts == 1).sum()),
        coincident_edges=0 if groups is None else count_coincident(raw.vertices, faces),
        box=(float(extent[0]), float(extent[1]), float(extent[2])),
        edge_length=length,
        quality=(float(quality.min()), float(quality.mean())) if len(faces) else (0.0, 0.0),
        zero_area_faces=int(is_flat(corners).sum()),
        contents=_contents(raw),
        report=report,
        problems=problems,
    )


def _genus_and_loops(
    faces: ndarray, n_vertices: int, components: int, problems: tuple[MeshError, ...]
) -> tuple[int | None, int | None]:
    """From Euler's number; unreferenced vertices and bad positions do not matter, anything else does."""
    if len(faces) == 0 or any(type(p).__name__ not in HARMLESS for p in problems):
        return None, None
    topology = build_topology(faces, n_vertices)
    border = topology.edges[topology.is_boundary_edge]
    loops = 0
    if len(border):
        _, label = connected_components(np.concatenate([border, border[:, :1]], axis=1), n_vertices)
        loops = len(np.unique(label[border]))
    euler = len(np.unique(faces)) - len(topology.edges) + len(faces)
    return (2 * components - loops - euler) // 2, loops


HARMLESS = ("UnreferencedVertexError", "NonFiniteError")


def _contents(raw: RawMesh | Mesh) -> tuple[str, ...]:
    found = []
    if raw.uv is not None:
        found.append(f"{len(raw.uv)} texture vertices")
    if raw.colors is not None:
        found.append("vertex colours")
    if raw.materials:
        found.append(f"{len(raw.materials)} materials")
    found += [f"face data '{name}'" for name in raw.face_data]
    return tuple(found)


def _or_undefined(value: int | None) -> str:
    return "undefined" if value is None else str(value)


def _qualities(corners: Float64[ndarray, "nF 3 3"]) -> Float64[ndarray, " nF"]:
    squares = (edge_lengths(corners) ** 2).sum(axis=1)
    areas = double_areas(corners)
    return np.divide(2 * np.sqrt(3) * areas, squares, out=np.zeros_like(areas), where=squares > 0)


def repair(
    raw: RawMesh, split_edges: bool = False, split_vertices: bool = False, weld: bool = False
) -> tuple[Mesh, list[str]]:
    """A valid mesh, and a line for each kind of change.  `raw` itself stays as it is.

    Without being asked it removes faces with a repeated vertex and copies of faces, turns faces to agree with the
    majority of their component, takes zero-area faces away where the surface stays a manifold (`flat_faces.py`; no
    vertex moves), and drops unreferenced vertices.  split_edges: gives the sheets that meet at an edge of three or more
    faces their own vertices.  split_vertices: the same for the fans that meet at a vertex.  weld: first joins boundary
    edges whose ends have bit-equal positions, where the surface stays a manifold.
    Raises: the `MeshError` that is left, for what only a guess could repair.
    """
    work = replace(raw, face_data=dict(raw.face_data), report=list(raw.report), origin=np.arange(len(raw.faces)))
    changes: list[str] = []
    inside = ((work.faces >= 0) & (work.faces < len(work.vertices))).all()
    if weld:
        known = len(work.report)
        weld_borders(work, None)
        changes += work.report[known:]
        del work.report[known:]
    if len(work.faces) and inside:
        _drop_bad_faces(work, changes)
    if len(work.faces) and inside:
        if split_edges:
            _split(work, changes, only_crowded_edges=True)
        if split_vertices:
            _split(work, changes, only_crowded_edges=False)
        _orient(work, changes)
        if _is_manifold(work):  # what is not yet would only get worse; `Mesh` names the problem
            mend_flat_faces(work, changes)
        dropped = work.drop_unreferenced()
        if len(dropped):
            changes.append(f"dropped {len(dropped)} unreferenced vertices, the first being vertex {dropped[0]}")
    work.report.extend(changes)
    return work.checked(), changes


def _drop_bad_faces(work: RawMesh, changes: list[str]) -> None:
    repeated = (work.faces == work.faces[:, [1, 2, 0]]).any(axis=1)
    if repeated.any():
        changes.append(
            f"removed {repeated.sum()} faces with a repeated vertex, the first being face {int(np.argmax(repeated))}"
        )
        work.take_faces(~repeated)
    order, is_copy = duplicate_faces(work.faces)
    if is_copy.any():  # the sort is stable: of equal faces the first comes first
        copies = np.sort(order[1:][is_copy])
        changes.append(f"removed {len(copies)} copies of faces, the first being face {work.number_of(copies[0])}")
        keep = np.ones(len(work.faces), dtype=bool)
        keep[copies] = False
        work.take_faces(keep)


def _split(work: RawMesh, changes: list[str], only_crowded_edges: bool) -> None:
    """Give each fan its own vertex; fans end at edges of three or more faces."""
    n = len(work.vertices)
    groups = face_edge_groups(work.faces, n)
    crowded = groups.counts > 2
    n_fans, fan = vertex_fans(groups, across=~crowded if only_crowded_edges else None)
    at_vertex = np.zeros(n_fans, dtype=np.int64)
    at_vertex[fan] = groups.tail
    first_fan = np.full(n, n_fans)
    np.minimum.at(first_fan, at_vertex, np.arange(n_fans))
    is_new = first_fan[at_vertex] != np.arange(n_fans)
    if only_crowded_edges:
        ends = groups.halfedges[groups.starts[crowded]]
        may_split = np.zeros(n, dtype=bool)
        may_split[groups.tail[ends]] = may_split[groups.head[ends]] = True
        is_new &= may_split[at_vertex]
    if not is_new.any():
        return
    vertex = np.where(is_new, n - 1 + np.cumsum(is_new), at_vertex)
    work.faces = vertex[fan].reshape(-1, 3)
    work.vertices = np.concatenate([work.vertices, work.vertices[at_vertex[is_new]]])
    if work.colors is not None:
        work.colors = np.concatenate([work.colors, work.colors[at_vertex[is_new]]])
    cause = f"{crowded.sum()} edges of three or more faces" if only_crowded_edges else "vertices of several fans"
    changes.append(f"split {cause}: {is_new.sum()} vertices were added as copies")


def _orient(work: RawMesh, changes: list[str]) -> None:
    """Turn the faces of each component that disagree with its majority.

    On the double cover (each face once as it is, once reversed) agreeing copies of neighbours are joined: the two
    copies of an orientable component fall apart, and the copy with more unturned faces is taken.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components as components

    n = len(work.faces)
    groups = face_edge_groups(work.faces, len(work.vertices))
    pairs = groups.starts[groups.counts == 2]
    h, g = groups.halfedges[pairs], groups.halfedges[pairs + 1]
    turned = np.where(groups.tail[h] == groups.tail[g], n, 0)
    rows, columns = np.concatenate([h // 3, h // 3 + n]), np.concatenate([g // 3 + turned, g // 3 + n - turned])
    graph = coo_array((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(2 * n, 2 * n))
    count, label = components(graph.tocsr(), directed=False)
    unturned = np.bincount(label[:n], minlength=count)
    here, there = label[:n], label[n:]
    # on a tie the copy that holds the lower face unturned, that is the lower label, wins
    turn = (here != there) & (
        (unturned[here] < unturned[there]) | ((unturned[here] == unturned[there]) & (here > there))
    )
    if turn.any():
        work.faces = np.where(turn[:, None], work.faces[:, ::-1], work.faces)
        work.uv_faces = (
            None if work.uv_faces is None else np.where(turn[:, None], work.uv_faces[:, ::-1], work.uv_faces)
        )
        changes.append(f"turned {turn.sum()} faces, the first being face {work.number_of(int(np.argmax(turn)))}")


def _is_manifold(work: RawMesh) -> bool:
    """Whether the mesh has no problem but vertices without faces."""
    used, faces = np.unique(work.faces, return_inverse=True)
    problems = find_problems(work.vertices[used], faces.reshape(-1, 3))
    return not any(not isinstance(p, NonFiniteError) for p in problems) and not any(non_finite_problems(work.vertices))
