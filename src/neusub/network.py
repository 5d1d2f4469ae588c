"""The network of Neural Subdivision (Liu et al. 2020, section 5), whole: three MLPs over half-flaps.

    forward     I moves the input's vertices and gives each 29 features: level 0.  Then, per level, V moves the
                old vertices, E adds the midpoints of the moved edges: levels 1 .. L.
    a module    looks at a half-flap (figure in `topology.py`) in its own frame, gives a displacement in that frame
                and features; a vertex (I, V) takes the mean over its outgoing half-flaps, an edge (E) over its two.
    frame       x along v1 - v0, z the normalised sum of the two unit face normals, y = z cross x (`frames.py`).

What is not in the paper is an option of `Architecture`.

Shapes: n half-flaps, m vertices or edges that pool them, c learned features and k learned vectors of each vertex.
Vectors of half-flaps are stored (3, n), one row a coordinate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import linear, relu, silu

from neusub import compiled
from neusub.bounds import (
    Measures,
    area_normals,
    around_edges,
    around_vertices,
    measured,
    restrained,
    settled,
    unturned,
)
from neusub.compiled import Measuring, Said
from neusub.configuration import Architecture
from neusub.crisp import crisp_faces, in_planes, planes_of
from neusub.flaps import FlapGroups, LevelFlaps, by_columns, gather_corners, means_of_ends, pool, sum_slots
from neusub.frames import (
    TURNS,
    differential_coordinates,
    edge_vectors,
    in_frames,
    known_true,
    local_frames,
    sizes,
    squared_lengths,
    star_sums,
    vertex_normals,
    vertex_turns,
)
from neusub.layers import Weights, columns, for_table

__all__ = ["HalfFlapMLP", "NeuralSubdivision", "Values"]

Given = tuple[Tensor, Tensor] | None  # vertices (k,), and their positions (k, 3)


class Values(NamedTuple):
    """What modules hand on of vertices or edges."""

    features: Float[Tensor, "nV c"] | None
    vectors: Float[Tensor, "nV 3*k"] | None

    def merged(self, other: Values, join: Callable[[Tensor, Tensor], Tensor]) -> Values:
        """Both, part by part; a part that neither has is None."""
        return Values(*(None if a is None or b is None else join(a, b) for a, b in zip(self, other)))


class HalfFlapMLP(nn.Module):
    """One module (I, V or E): an MLP with two hidden layers on half-flaps, and the mean over each group.

    The order of the layers' rows and columns: `layers.Weights`.
    """

    def __init__(self, plan: Architecture, features: int, vectors: int):
        super().__init__()
        self.plan, self.features, self.vectors = plan, features, vectors  # that each corner brings
        self.bound = plan.bound
        self.first = nn.Linear(9 + 4 * (features + 3 * vectors), plan.width)
        self.hidden = nn.Linear(plan.width, plan.width)
        self.last = nn.Linear(plan.width, 3 + 3 * plan.vectors + plan.features)
        for layer in (self.first, self.hidden, self.last):
            nn.init.xavier_normal_(layer.weight)
            nn.init.zeros_(layer.bias)

    def forward(
        self, groups: FlapGroups, positions: Float[Tensor, "nV 3"], values: Values,
        around: Float[Tensor, "nV k"] | None = None, learns: bool = True,
    ) -> tuple[Float[Tensor, "m 3"], Values, Float[Tensor, "m k"] | None]:
        """Mean displacement of each group, in the axes of `positions`, its mean features and vectors (`learns`), and,
        where displacements depend on it, what is `around` it (`bounds.py`): its vertex, or the two ends of its edge."""
        measures = None if self.bound is None and not self.plan.flat and not self.plan.sharp else \
            "all" if around is None else "no turning"
        weights = Weights(self.first.weight, self.first.bias, self.hidden.weight, self.hidden.bias, self.last.weight,
                          self.last.bias)
        say = compiled.said if compiled.serves(groups, positions, self.first.weight) else said_by_tensors
        said = say(groups, positions, values.vectors, values.features, weights, self.plan, learns, measures)
        move, told = said.move, Values(said.features, said.vectors)
        if said.measures is None:
            return move, told, None
        around = around_vertices(groups, said.measures, self.plan.sharp) if around is None else \
            around_edges(groups, by_columns(around))
        return restrained(move, said.measures, around, self.plan, self.bound), told, around


def said_by_tensors(
    groups: FlapGroups, positions: Float[Tensor, "nV 3"], vectors: Float[Tensor, "nV 3*k"] | None,
    features: Float[Tensor, "nV c"] | None, weights: Weights, plan: Architecture, learns: bool, measures: Measuring,
) -> Said:
    """The MLP on each half-flap in its frame, and the means over groups; on any device.

    `compiled.said` does the same on a CPU, faster."""
    table, brought = None, [0 if x is None else x.shape[1] for x in (features, vectors)]
    if features is not None:  # gather and sum products: a vertex has six half-flaps, each with four corners
        table = linear(features, for_table(weights.first, *brought)).view(-1, plan.width)
    local = weights.first.index_select(1, columns(*brought, positions.device)[0])
    parts = [groups] if torch.is_grad_enabled() else groups.chunks(plan.width)
    positions, vectors = by_columns(positions), None if vectors is None else by_columns(vectors)
    return joined([said_of_part(part, positions, vectors, table, local, weights, plan, learns, measures)
                   for part in parts])


def joined(parts: list[Said]) -> Said:
    """What one run of groups after the other said."""
    if len(parts) == 1:
        return parts[0]

    def whole(rows: Sequence[Tensor | None], dim: int) -> Any:
        return None if rows[0] is None else torch.cat(rows, dim)  # type: ignore[arg-type]

    move, vectors, features, measures = zip(*parts)
    found = None if measures[0] is None else Measures(*(whole(rows, -1) for rows in zip(*measures)))
    return Said(whole(move, 0), whole(vectors, 0), whole(features, 0), found)


def said_of_part(
    groups: FlapGroups, positions: Tensor, vectors: Tensor | None, table: Float[Tensor, "4*nV width"] | None,
    local: Float[Tensor, "width 9+12*k"], weights: Weights, plan: Architecture, learns: bool, measures: Measuring,
) -> Said:
    """A run of groups; `table` and `local` are what `for_table` and `columns` make of the first layer."""
    activate = {"relu": relu, "silu": silu}[plan.activation]
    edges = edge_vectors(groups, positions)
    axes, defined = local_frames(edges)
    size = sizes(squared_lengths(edges)) if plan.relative else None
    seen, spare = in_frames(edges if size is None else edges / size, axes).T, not torch.is_grad_enabled()
    hidden = linear(seen, local[:, :9], weights.first_bias)  # of half the bits in mixed precision
    if table is not None:
        hidden += sum_slots(groups, table)
    if vectors is not None:
        seen, turned = gather_corners(groups, vectors).unflatten(1, (-1, 3)).flatten(0, 1), local[:, 9:].T
        hidden.addmm_(in_frames(seen, axes).T.to(hidden.dtype), turned.to(hidden.dtype))
    hidden = linear(activate(hidden, inplace=spare), weights.hidden, weights.hidden_bias)
    hidden = activate(hidden, inplace=spare)
    count = groups.offsets.diff().to(hidden.dtype)[:, None]
    if not known_true(defined):  # half-flaps without a frame are left out of the mean
        hidden = hidden * defined[:, None]
        axes = torch.where(defined, axes, 0)
        count = pool(groups, defined[:, None].to(hidden.dtype)).clamp(min=1)
    asked = 3 + 3 * plan.vectors * learns
    told = torch.addmm(weights.last_bias[:asked, None], weights.last[:asked], hidden.T).unflatten(0, (-1, 3))
    if size is not None:
        told[0].mul_(size)
    told = pool(groups, in_frames(told, axes.transpose(0, 1)).T.contiguous()) / count
    features = None
    if learns:  # the last layer is linear: the mean of its features is its value at the mean
        features = linear(pool(groups, hidden) / count, weights.last[asked:], weights.last_bias[asked:])
    return Said(told[:, :3], told[:, 3:] if asked > 3 else None, features,
                None if measures is None else measured(groups, edges, axes, measures == "all" and plan.sharp > 0))


class NeuralSubdivision(nn.Module):
    """The paper's network, by default: modules I, V and E, shared over all half-flaps and levels."""

    def __init__(self, plan: Architecture | None = None):
        super().__init__()
        self.plan = plan = plan or Architecture()
        self.initial = HalfFlapMLP(plan, TURNS if plan.turns else 0, 2 if plan.vectors else 1)
        self.vertex = HalfFlapMLP(plan, plan.features, plan.vectors)
        self.edge = HalfFlapMLP(plan, plan.features, plan.vectors)

    def forward(
        self, positions: Float[Tensor, "nV 3"], levels: list[LevelFlaps], given: Sequence[Given] | None = None
    ) -> list[Float[Tensor, "nV_l 3"]]:
        """Vertex positions of levels 0 .. len(levels); at least one level.

        given: of each level, vertices that go to given places instead (creases).
        """
        given = given or [None] * (len(levels) + 1)
        first = levels[0].by_vertex
        crisp = crisp_faces(levels[0], positions) if self.plan.crisp else None
        planes = crisp and planes_of(levels[0], crisp)
        move, values, _ = self.initial(first, positions, self._first_values(first, positions))
        move = in_planes(move, planes and planes.vertices)
        start, positions = put(positions, given[0]), put(positions + move, given[0])
        if self.plan.unturned:
            faces = levels[0].on_device(levels[0].topology.faces)
            normals = area_normals(faces, start)
            positions = unturned(faces, normals, start, positions)
        outputs = [positions]
        for k, level in enumerate(levels):
            before = positions
            if crisp and k:
                planes = planes_of(level, crisp)
            move, learned, around = self.vertex(level.by_vertex, positions, values)
            values = self._added(values, learned)
            positions = put(positions + in_planes(move, planes and planes.vertices), given[k])
            is_last = k + 1 == len(levels)
            move, learned, _ = self.edge(level.by_edge, positions, values, around, learns=not is_last)
            middles = means_of_ends(level, positions) + in_planes(move, planes and planes.edges)
            positions = torch.cat([positions, middles])
            if self.plan.settle and k >= self.plan.trained:
                positions = settled(level, before, positions, self.plan.settle, self.plan.sharp, planes)
            positions = put(positions, given[k + 1])
            if self.plan.unturned:
                safe = put(torch.cat([before, means_of_ends(level, before)]), given[k + 1])
                positions = unturned(level.on_device(level.topology.refined_faces), normals, safe, positions)
            outputs.append(positions)
            if not is_last:
                between = Values(*(None if v is None else means_of_ends(level, v) for v in values))
                values = values.merged(self._added(between, learned), lambda v, new: torch.cat([v, new]))
        return outputs

    def _first_values(self, groups: FlapGroups, positions: Float[Tensor, "nV 3"]) -> Values:
        """What the input's vertices are known by."""
        by_kernel = compiled.serves(groups, positions, self.initial.first.weight) and not positions.requires_grad
        sums = (compiled.star_sums if by_kernel else star_sums)(
            groups, positions, self.plan.relative, self.plan.vectors > 0 or self.plan.turns)
        vectors = differential_coordinates(sums)
        if self.plan.vectors:
            vectors = torch.cat([vectors, vertex_normals(sums)], dim=1)
        return Values(vertex_turns(sums, groups.offsets.diff()) if self.plan.turns else None, vectors)

    def _added(self, values: Values, learned: Values) -> Values:
        """What a module learned, added to what there was where the network is residual."""
        return values.merged(learned, torch.add) if self.plan.residual else learned


def put(positions: Float[Tensor, "nV 3"], given: Given) -> Float[Tensor, "nV 3"]:
    """With the given vertices in their places."""
    return positions if given is None else positions.index_copy(0, *given)
