"""The network of Neural Subdivision (Liu et al. 2020, section 5), whole: three MLPs over half-flaps.

    forward     I moves the input's vertices and gives each 29 features: level 0.  Then, per level, V moves the
                old vertices, E adds the midpoints of the moved edges: levels 1 .. L.
    a module    looks at a half-flap (figure in `topology.py`) in its own frame, gives a displacement in that frame
                and features; a vertex (I, V) takes the mean over its outgoing half-flaps, an edge (E) over its two.
    frame       x along v1 - v0, z the normalised sum of the two unit face normals, y = z cross x.

Shapes: n half-flaps, m vertices or edges that pool them.  Vectors of half-flaps are stored (3, n), one row a
coordinate: dot products then run over contiguous rows, several times faster than (n, 3).
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import linear

from neusub.bounds import bounded, heights_of
from neusub.flaps import FlapGroups, LevelFlaps, gather_corners, pool, sum_slots

__all__ = ["HalfFlapMLP", "NeuralSubdivision", "differential_coordinates"]


# --- geometry of a half-flap -------------------------------------------------------------------------------------


def unit(vector: Float[Tensor, "*b 3 n"], size: Tensor | float) -> tuple[Tensor, Bool[Tensor, "*b 1 n"]]:
    """The vector's direction, and whether it has one: its length exceeds rounding errors of `size`, squared."""
    squared = vector.square().sum(-2, keepdim=True)
    limit = torch.finfo(vector.dtype)
    defined = squared > (16 * limit.eps) ** 2 * size + limit.tiny
    return vector * torch.where(defined, squared, torch.inf).rsqrt(), defined


def edge_vectors(groups: FlapGroups, positions: Float[Tensor, "nV 3"]) -> Float[Tensor, "3 3 n"]:
    """v1 - v0, v2 - v0, v3 - v0.  A missing vertex is the other one's reflection through the edge's midpoint."""
    origin, others = gather_corners(groups, positions).split([1, 3])
    edges = others - origin
    if groups.missing is None:
        return edges
    reflected = edges[:1] - edges[[2, 1]]
    return torch.cat([edges[:1], torch.where(groups.missing[:, None], reflected, edges[1:])])


def local_frames(edges: Float[Tensor, "3 3 n"]) -> tuple[Float[Tensor, "3 3 n"], Bool[Tensor, " n"]]:
    """Axes x, y, z of each half-flap's frame, and whether it has one.

    Where the two normals cancel, z is the left face's, and the right one's where the left face has none.
    """
    e1, e2, e3 = edges.unbind()
    lengths = edges.detach().square().sum(1, keepdim=True)
    x, has_edge = unit(e1, 0.0)
    normals = torch.linalg.cross(torch.stack([e1, e3]), torch.stack([e2, e1]), dim=1)
    normals, has_normal = unit(normals, lengths[:1] * lengths[1:])
    z, has_both = unit(normals.sum(0), 1.0)
    if not has_both.all():
        z = torch.where(has_both, z, torch.where(has_normal[0], normals[0], normals[1]))
    return torch.stack([x, torch.linalg.cross(z, x, dim=0), z]), (has_edge & has_normal.any(0))[0]


def sizes(edges: Float[Tensor, "3 3 n"]) -> Float[Tensor, " n"]:
    """Mean length of the five edges of each half-flap, as a constant; 1 where all its vertices coincide."""
    e1, e2, e3 = edges.detach()
    size = torch.linalg.norm(torch.stack([e1, e2, e3, e2 - e1, e3 - e1]), dim=1).mean(0)
    return torch.where(size > 0, size, 1)


def in_frames(vectors: Float[Tensor, "k 3 n"], axes: Float[Tensor, "3 3 n"]) -> Float[Tensor, "3*k n"]:
    """Coordinates of k vectors of each half-flap in its frame."""
    return (vectors[:, None] * axes).sum(2).flatten(0, 1)


def differential_coordinates(
    groups: FlapGroups, positions: Float[Tensor, "nV 3"]
) -> Float[Tensor, "nV 3"]:
    """Each vertex minus the mean of its neighbours.

    A boundary vertex counts the reflected vertices of `edge_vectors` among its neighbours: on a straight border of a
    regular flat patch it then has none, like a vertex inside, and the border is not drawn inwards.
    """
    parts = []
    for part in groups.chunks():
        edges = edge_vectors(part, positions)
        use = torch.ones_like(edges[:, :1])
        if part.missing is not None:
            use[1:] = part.missing[:, None]
        else:
            edges, use = edges[:1], use[:1]
        total = pool(part, torch.cat([(edges * use).sum(0), use.sum(0)]).T.contiguous())
        parts.append(-total[:, :3] / total[:, 3:].clamp(min=1))
    return torch.cat(parts)


# --- the network -------------------------------------------------------------------------------------------------


class HalfFlapMLP(nn.Module):
    """One module (I, V or E): an MLP with two hidden layers on half-flaps, and the mean over each group.

    The first layer's columns go vertex by vertex: value(v0), e1, value(v1), e2, value(v2), e3, value(v3).
    """

    def __init__(self, channels: int, width: int, features: int, *, vectors: bool, relative: bool = False):
        super().__init__()
        self.channels, self.vectors = channels, vectors  # of each corner's value; whether it turns with the frame
        self.relative = relative
        self.bound: tuple[float, float] | None = None
        self.first = nn.Linear(9 + 4 * channels, width)
        self.hidden = nn.Linear(width, width)
        self.last = nn.Linear(width, 3 + features)
        for layer in (self.first, self.hidden, self.last):
            nn.init.xavier_normal_(layer.weight)
            nn.init.zeros_(layer.bias)

    def forward(
        self, groups: FlapGroups, positions: Float[Tensor, "nV 3"], values: Float[Tensor, "nV c"],
        heights: Float[Tensor, " nV"] | None = None, features: bool = True,
    ) -> tuple[Float[Tensor, "m 3"], Float[Tensor, "m f"] | None, Float[Tensor, " m"] | None]:
        """Mean displacement of each group, in the axes of `positions`, its mean features, and, where displacements are
        bounded, its height: of its vertex (`heights_of`), or from the `heights` of its two ends."""
        columns = self.first.weight.split([self.channels, 3] * 3 + [self.channels], dim=1)
        edge_columns = torch.cat(columns[1::2], dim=1)
        value_columns = columns[::2]
        if not self.vectors:  # gather and sum products of vertices: a vertex has six half-flaps, each with four corners
            bias = torch.cat([self.first.bias, self.first.bias.new_zeros(3 * len(self.first.bias))])
            values = linear(values, torch.cat(value_columns), bias).view(-1, len(self.first.bias))
        parts = groups.chunks() if not torch.is_grad_enabled() else [groups]
        shared = positions, values, heights, edge_columns, value_columns, features
        results = [self._part(part, *shared) for part in parts]
        if len(results) == 1:
            return results[0]
        return tuple(None if rows[0] is None else torch.cat(rows) for rows in zip(*results))  # type: ignore[return-value]

    def _part(self, groups, positions, values, heights, edge_columns, value_columns, features):
        edges = edge_vectors(groups, positions)
        axes, defined = local_frames(edges)
        size = sizes(edges) if self.relative else None
        unit_axes = axes if size is None else axes / size
        if self.vectors:
            inputs = in_frames(torch.cat([edges, gather_corners(groups, values)]), unit_axes)
            hidden = linear(inputs.T, torch.cat([edge_columns, *value_columns], dim=1), self.first.bias)
        else:
            hidden = torch.addmm(sum_slots(groups, values), in_frames(edges, unit_axes).T, edge_columns.T)
        hidden = self.hidden(hidden.relu_()).relu_()
        count = groups.offsets.diff().to(hidden.dtype)[:, None]
        if not defined.all():  # half-flaps without a frame are left out of the mean
            hidden = hidden * defined[:, None]
            axes = torch.where(defined, axes, 0)
            count = pool(groups, defined[:, None].to(hidden.dtype)).clamp(min=1)
        local = linear(hidden, self.last.weight[:3], self.last.bias[:3]).T.contiguous()
        move = ((local if size is None else local * size)[:, None] * axes).sum(0)
        move = pool(groups, move.T.contiguous()) / count
        # The last layer is linear: the mean of its features is its value at the mean.
        learned = linear(pool(groups, hidden) / count, self.last.weight[3:], self.last.bias[3:]) if features else None
        if self.bound is None:
            return move, learned, None
        if heights is None:
            heights = heights_of(groups, edges, axes)
        else:
            heights = torch.segment_reduce(heights[groups.corners[:, 0]], "max", offsets=groups.offsets)
        return bounded(move, groups, edges, heights, self.bound), learned, heights


class NeuralSubdivision(nn.Module):
    """The paper's network: modules I, V and E, shared over all half-flaps and levels.

    Not in the paper: relative, lengths of each half-flap are in units of its own mean edge, so that the network knows
    no scale; bound, for use and not for training, see `bounds.py` (None leaves the displacements as they are).
    """

    def __init__(self, width: int = 32, features: int = 29, bound: tuple[float, float] | None = None,
                 relative: bool = False):
        super().__init__()
        self.initial = HalfFlapMLP(3, width, features, vectors=True, relative=relative)
        self.vertex = HalfFlapMLP(features, width, features, vectors=False, relative=relative)
        self.edge = HalfFlapMLP(features, width, features, vectors=False, relative=relative)
        for module in (self.initial, self.vertex, self.edge):
            module.bound = bound

    def forward(
        self, positions: Float[Tensor, "nV 3"], levels: list[LevelFlaps]
    ) -> list[Float[Tensor, "nV_l 3"]]:
        """Vertex positions of levels 0 .. len(levels); at least one level."""
        first = levels[0].by_vertex
        move, values, _ = self.initial(first, positions, differential_coordinates(first, positions))
        positions = positions + move
        outputs = [positions]
        for k, level in enumerate(levels):
            move, values, heights = self.vertex(level.by_vertex, positions, values)
            positions = positions + move
            is_last = k + 1 == len(levels)
            move, added, _ = self.edge(level.by_edge, positions, values, heights, features=not is_last)
            midpoints = (positions[level.edges[:, 0]] + positions[level.edges[:, 1]]) / 2
            positions = torch.cat([positions, midpoints + move])
            outputs.append(positions)
            values = values if added is None else torch.cat([values, added])
        return outputs
