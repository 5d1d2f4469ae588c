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
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import linear, relu, silu

from neusub import compiled
from neusub.bounds import (
    area_normals,
    around_edges,
    around_vertices,
    bounded,
    flattened,
    measured,
    settled,
    unturned,
)
from neusub.compiled import Layers, Measuring, Said
from neusub.configuration import Architecture
from neusub.flaps import FlapGroups, LevelFlaps, by_columns, gather_corners, pool, sum_slots
from neusub.frames import (
    TURNS,
    differential_coordinates,
    edge_vectors,
    in_frames,
    local_frames,
    sizes,
    squared_lengths,
    vertex_normals,
    vertex_turns,
)

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

    The first layer's columns go vertex by vertex: value(v0), e1, value(v1), e2, value(v2), e3, value(v3), a value being
    the features and then the vectors of a vertex.
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
        corner, given = self.features + 3 * self.vectors, 3 + 3 * self.plan.vectors if learns else 3
        columns = self.first.weight.split([corner, 3] * 3 + [corner], dim=1)
        layers = Layers(torch.cat([*columns[1::2], *(c[:, self.features :] for c in columns[::2])], dim=1),
                        self.first.bias, self.hidden.weight, self.hidden.bias, self.last.weight[:given],
                        self.last.bias[:given])
        table, vectors = values
        if table is not None:  # gather and sum products: a vertex has six half-flaps, each with four corners
            fixed = torch.cat([column[:, : self.features] for column in columns[::2]])
            table = linear(table, fixed).view(-1, self.plan.width)
        measures = None if self.bound is None and not self.plan.flat and not self.plan.sharp else \
            "all" if around is None else "no turning"
        if compiled.serves(groups, positions, self.first.weight):
            said, parts = compiled.said, [groups]
        else:
            said, parts = said_by_tensors, groups.chunks(self.plan.width) if not torch.is_grad_enabled() else [groups]
            positions, vectors = by_columns(positions), None if vectors is None else by_columns(vectors)
        around = None if around is None else by_columns(around)
        results = [self._means(part, said(part, positions, vectors, table, layers, self.plan, learns, measures), around)
                   for part in parts]
        moves, features, vectors, around = (rows[0] if rows[0] is None or len(rows) == 1 else torch.cat(rows)
                                            for rows in zip(*results))
        return moves, Values(features, vectors), around  # type: ignore[return-value]

    def _means(self, groups: FlapGroups, said: Said, around: Tensor | None):
        """Of groups, from what their half-flaps said: displacement, features, vectors, and what is around."""
        move, vectors = (said.vectors / said.count).tensor_split([3], dim=1)
        features = None
        if said.hidden is not None:  # the last layer is linear: the mean of its features is its value at the mean
            given = said.vectors.shape[1]
            features = linear(said.hidden / said.count, self.last.weight[given:], self.last.bias[given:])
        if (measures := said.measures) is not None:
            around = around_edges(groups, around) if around is not None else \
                around_vertices(groups, measures, self.plan.sharp)
            heights = around[:, 0].contiguous()
            if self.plan.sharp:
                move = move * around[:, -1:]
            if self.plan.flat:
                move = move * flattened(heights, measures.size, self.plan.flat)[:, None]
            if self.bound is not None:
                move = bounded(move, measures, heights, self.bound)
        return move, features, vectors if vectors.shape[1] else None, around


def said_by_tensors(
    groups: FlapGroups, positions: Float[Tensor, "nV 3"], vectors: Float[Tensor, "nV 3*k"] | None,
    table: Float[Tensor, "4*nV c"] | None, layers: Layers, plan: Architecture, learns: bool, measures: Measuring,
) -> Said:
    """The MLP on each half-flap in its frame; on any device.  `compiled.said` does the same on a CPU, faster."""
    activate = {"relu": relu, "silu": silu}[plan.activation]
    edges = edge_vectors(groups, positions)
    axes, defined = local_frames(edges)
    size = sizes(squared_lengths(edges)) if plan.relative else None
    seen, spare = in_frames(edges if size is None else edges / size, axes).T, not torch.is_grad_enabled()
    hidden = linear(seen, layers.first[:, :9], layers.first_bias)
    if table is not None:
        hidden += sum_slots(groups, table)
    if vectors is not None:
        seen = gather_corners(groups, vectors).unflatten(1, (-1, 3)).flatten(0, 1)
        seen, columns = in_frames(seen, axes).T, layers.first[:, 9:].T
        hidden.addmm_(seen.to(hidden.dtype), columns.to(hidden.dtype))  # in mixed precision
    hidden = linear(activate(hidden, inplace=spare), layers.hidden, layers.hidden_bias)
    hidden = activate(hidden, inplace=spare)
    count = groups.offsets.diff().to(hidden.dtype)[:, None]
    if not defined.all():  # half-flaps without a frame are left out of the mean
        hidden = hidden * defined[:, None]
        axes = torch.where(defined, axes, 0)
        count = pool(groups, defined[:, None].to(hidden.dtype)).clamp(min=1)
    local = torch.addmm(layers.last_bias[:, None], layers.last, hidden.T).unflatten(0, (-1, 3))
    if size is not None:
        local[0].mul_(size)
    spoken = pool(groups, in_frames(local, axes.transpose(0, 1)).T.contiguous())
    return Said(spoken, pool(groups, hidden) if learns else None, count,
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
        vectors = differential_coordinates(first, positions, self.plan.relative)
        if self.plan.vectors:
            vectors = torch.cat([vectors, vertex_normals(first, positions)], dim=1)
        seen = vertex_turns(first, positions.detach()) if self.plan.turns else None
        move, values, _ = self.initial(first, positions, Values(seen, vectors))
        start, positions = put(positions, given[0]), put(positions + move, given[0])
        if self.plan.unturned:
            faces = torch.tensor(levels[0].topology.faces, device=positions.device)
            normals = area_normals(faces, start)
            positions = unturned(faces, normals, start, positions)
        outputs = [positions]
        for k, level in enumerate(levels):
            before = positions
            move, learned, around = self.vertex(level.by_vertex, positions, values)
            values = self._added(values, learned)
            positions = put(positions + move, given[k])
            is_last = k + 1 == len(levels)
            move, learned, _ = self.edge(level.by_edge, positions, values, around, learns=not is_last)
            positions = torch.cat([positions, means(level, positions) + move])
            if self.plan.settle and k >= self.plan.trained:
                positions = settled(level, before, positions, self.plan.settle, self.plan.sharp)
            positions = put(positions, given[k + 1])
            if self.plan.unturned:
                safe = put(torch.cat([before, means(level, before)]), given[k + 1])
                positions = unturned(level.refined_faces(), normals, safe, positions)
            outputs.append(positions)
            if not is_last:
                between = Values(*(None if v is None else means(level, v) for v in values))
                values = values.merged(self._added(between, learned), lambda v, new: torch.cat([v, new]))
        return outputs

    def _added(self, values: Values, learned: Values) -> Values:
        """What a module learned, added to what there was where the network is residual."""
        return values.merged(learned, torch.add) if self.plan.residual else learned


def put(positions: Float[Tensor, "nV 3"], given: Given) -> Float[Tensor, "nV 3"]:
    """With the given vertices in their places."""
    return positions if given is None else positions.index_copy(0, *given)


def means(level: LevelFlaps, values: Float[Tensor, "nV c"]) -> Float[Tensor, "nE c"]:
    """Of the two ends of each edge."""
    return (values.index_select(0, level.edges[:, 0]) + values.index_select(0, level.edges[:, 1])) / 2
