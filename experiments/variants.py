"""Networks that the package does not have, and a training for them: what the experiments compare the paper's with.

A variant is the paper's network with some of its modules replaced; a loss of its own is a `Batch` with another `loss`.
`fit` is the loop of `neusub.train` without its files: for the paper's network both give the same numbers, bit for bit.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy import ndarray
from torch import Tensor, nn
from torch.nn.functional import linear

from neusub import Mesh, TrainingConfig
from neusub.configuration import Architecture
from neusub.files import replacing
from neusub.flaps import FlapGroups, gather_corners, pool, sum_slots
from neusub.frames import cross, edge_vectors, in_frames, local_frames, root, sizes, squared_lengths
from neusub.generation import Batch, Pair
from neusub.network import HalfFlapMLP, NeuralSubdivision, Values
from neusub.recording import Recorder, copy_to
from neusub.training import epoch_order, make_recordable, set_rate

KEPT_EVERY = 10  # epochs

# --- modules -----------------------------------------------------------------------------------------------------


class EdgesOnly(HalfFlapMLP):
    """Module I without differential coordinates."""

    def __init__(self, plan: Architecture, features: int, vectors: int):
        super().__init__(plan, features, 0)

    def forward(self, groups, positions, values, around=None, learns=True):
        return super().forward(groups, positions, Values(None, None), around, learns)


class Repeated(HalfFlapMLP):
    """A module that is applied several times, each time to the positions and features that it gave before."""

    def __init__(self, plan: Architecture, features: int, vectors: int, steps: int = 2):
        super().__init__(plan, features, vectors)
        self.steps = steps

    def forward(self, groups, positions, values, around=None, learns=True):
        moved = positions
        for _ in range(self.steps):
            move, values, found = super().forward(groups, moved, values, around, learns)
            moved = moved + move
        return moved - positions if self.steps > 1 else move, values, found


class VerticesFromLoop(HalfFlapMLP):
    """Displacements of old vertices from where Loop's rule takes them; for closed meshes."""

    def forward(self, groups, positions, values, around=None, learns=True):
        move, values, around = super().forward(groups, positions, values, around, learns)
        valence = groups.offsets.diff()[:, None].to(positions.dtype)
        to_mean = pool(groups, edge_vectors(groups, positions)[0].T.contiguous()) / valence
        share = 5 / 8 - (3 / 8 + torch.cos(2 * torch.pi / valence) / 4).square()
        return move + share * to_mean, values, around


class EdgesFromLoop(HalfFlapMLP):
    """Displacements of new vertices from where Loop's rule puts them (3/8, 3/8, 1/8, 1/8) instead of the midpoint."""

    def forward(self, groups, positions, values, around=None, learns=True):
        move, values, around = super().forward(groups, positions, values, around, learns)
        along, left, right = edge_vectors(groups, positions)
        return move + pool(groups, ((left + right - along) / 8).T.contiguous()) / 2, values, around


class Plain(HalfFlapMLP):
    """A module that sees `seen` of each half-flap beside its corners' features.

    As it stands it has the paper's inputs: vectors in the half-flap's frame.
    """

    turns = True  # displacements are in the half-flap's frame
    scales = False  # and in units of its mean edge
    columns = 9  # of `seen`, without the vectors of the corners

    def __init__(self, plan: Architecture, features: int, vectors: int):
        super().__init__(plan, features, vectors)
        self.first = nn.Linear(self.columns + 4 * features + 12 * self.vectors, plan.width)
        nn.init.xavier_normal_(self.first.weight)
        nn.init.zeros_(self.first.bias)

    def seen(self, groups: FlapGroups, edges: Tensor, axes: Tensor, positions: Tensor,
             vectors: Tensor | None) -> Tensor:
        """Rows of half-flaps: edge vectors, then the vectors of the four corners."""
        if vectors is not None:
            edges = torch.cat([edges, gather_corners(groups, vectors)])
        return in_frames(edges, axes).T

    def forward(self, groups, positions, values, around=None, learns=True):
        edges = edge_vectors(groups, positions)
        axes = local_frames(edges)[0]
        seen = self.seen(groups, edges, axes, positions, values.vectors)
        into, rest = self.first.weight.tensor_split([seen.shape[1]], dim=1)
        hidden = linear(seen, into, self.first.bias)
        if values.features is not None:  # once a vertex and corner, not once a half-flap
            table = linear(values.features, rest.unflatten(1, (4, -1)).transpose(0, 1).flatten(0, 1))
            hidden = hidden + sum_slots(groups, table.view(-1, len(into)))
        hidden = torch.relu(self.hidden(torch.relu(hidden)))
        move = linear(hidden, self.last.weight[:3], self.last.bias[:3])
        if self.scales:
            move = move * sizes(squared_lengths(edges))[:, None]
        if self.turns:
            move = in_frames(move.T[None].contiguous(), axes.transpose(0, 1)).T
        count = groups.offsets.diff().to(move.dtype)[:, None]
        features = None
        if learns:  # the mean goes through the last layer as well as each half-flap does
            features = linear(pool(groups, hidden) / count, self.last.weight[3:], self.last.bias[3:])
        return pool(groups, move.contiguous()) / count, Values(features, None), None


class WorldAxes(Plain):
    """Inputs and displacements along the world's axes."""

    turns = False

    def seen(self, groups, edges, axes, positions, vectors):
        if vectors is not None:
            edges = torch.cat([edges, gather_corners(groups, vectors)])
        return edges.flatten(0, 1).T


class WorldPositions(WorldAxes):
    """Along the world's axes, and with the position of the half-flap's origin."""

    columns = 12

    def seen(self, groups, edges, axes, positions, vectors):
        origin = gather_corners(groups, positions)[0].T
        return torch.cat([origin, super().seen(groups, edges, axes, positions, vectors)], dim=1)


class MeshCNN(Plain):
    """The inputs of Hanocka et al. 2019: dihedral angle, two inner angles, two ratios of height to edge.

    Theirs are of an edge without direction and sorted; a half-flap knows its left from its right, and the dihedral
    angle has a sign here, so these say a little more.
    """

    columns = 5

    def __init__(self, plan: Architecture, features: int, vectors: int):
        super().__init__(plan, features, 0)

    def seen(self, groups, edges, axes, positions, vectors):
        along, left, right = edges
        normals = cross(torch.stack([along, right]), torch.stack([left, along]))
        areas = root(normals.square().sum(1))  # twice the triangles'
        sine = (cross(*normals) * axes[0]).sum(0)
        dihedral = torch.atan2(sine, (normals[0] * normals[1]).sum(0))
        apexes = torch.stack([left, right])
        inner = torch.atan2(areas, (apexes * (apexes - along)).sum(1))
        ratios = areas / along.square().sum(0).clamp(min=1e-12)
        return torch.cat([dihedral[None], inner, ratios]).T


class ScaledMeshCNN(MeshCNN):
    """The same with displacements in units of the half-flap's mean edge: those inputs say nothing about lengths."""

    scales = True


# --- networks ----------------------------------------------------------------------------------------------------


def network(**modules: Callable[..., HalfFlapMLP]) -> NeuralSubdivision:
    """The paper's network with some modules replaced; a module of the same sizes starts from the same weights."""
    made = NeuralSubdivision()
    for name, make in modules.items():
        old = getattr(made, name)
        new = make(old.plan, old.features, old.vectors)
        if new.first.weight.shape == old.first.weight.shape:
            new.load_state_dict(old.state_dict())
        setattr(made, name, new)
    return made


def everywhere(kind: Callable[..., HalfFlapMLP]) -> NeuralSubdivision:
    return network(initial=kind, vertex=kind, edge=kind)


NETWORKS: dict[str, Callable[[], NeuralSubdivision]] = {
    "paper": network,
    "no differential coordinates": partial(network, initial=EdgesOnly),
    "from Loop": partial(network, vertex=VerticesFromLoop, edge=EdgesFromLoop),
    "2 vertex steps": partial(network, vertex=partial(Repeated, steps=2)),
    "3 vertex steps": partial(network, vertex=partial(Repeated, steps=3)),
    "MeshCNN features": partial(everywhere, MeshCNN),
    "MeshCNN features, relative": partial(everywhere, ScaledMeshCNN),
    "relative lengths": partial(NeuralSubdivision, Architecture(relative=True)),
    "world axes": partial(everywhere, WorldAxes),
    "world positions": partial(everywhere, WorldPositions),
}


# --- training ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Fit:
    """A training: the network of the best epoch, and what each epoch ended with."""

    network: NeuralSubdivision
    losses: ndarray  # (epochs,) validation loss, the one that is trained
    errors: ndarray  # (epochs, levels + 1) mean squared coordinate error of each level to the targets
    seconds: float  # of the processor

    @property
    def best_epoch(self) -> int:
        return int(self.losses.argmin()) + 1


def level_errors(batch: Batch, outputs: Sequence[Tensor]) -> list[Tensor]:
    """Of each level, the mean squared coordinate error to the targets: the terms of the paper's loss."""
    return [((out - batch.targets[: len(out)]).square() * weight).sum() for out, weight in zip(outputs, batch.weights)]


class LastLevel(Batch):
    """A batch whose loss is the last level's error."""

    def loss(self, outputs: list[Tensor], kind: str = "squared") -> Tensor:
        return level_errors(self, outputs)[-1]


def fit(build: Callable[[], NeuralSubdivision], train: Sequence[Batch], validation: Sequence[Batch],
        config: TrainingConfig, checkpoint: Path | None = None) -> Fit:
    """Train on one batch a step, in the order of `neusub.train`, on the batches' device.

    checkpoint: a file to go on from where it is there, written every KEPT_EVERY epochs and removed at the end.
    """
    torch.set_num_threads(config.threads or torch.get_num_threads())
    torch.manual_seed(config.seed)
    device = train[0].positions.device
    model = build().to(device)
    weights = list(model.parameters())
    adam = torch.optim.Adam(weights, lr=config.learning_rate, fused=True)
    run = working(device)
    make_recordable([*train, *validation])
    for weight in weights:
        weight.grad = torch.zeros_like(weight)
    found = torch.zeros(1 + len(validation[0].weights), device=device)  # a loss, and the errors of the levels

    def gradients(batch: Batch) -> tuple[Tensor, ...]:
        return torch.autograd.grad(batch.loss(model(batch.positions, batch.levels)), weights)

    def validated(batch: Batch) -> list[Tensor]:
        outputs = model(batch.positions, batch.levels)
        return [torch.stack([batch.loss(outputs), *level_errors(batch, outputs)])]

    losses, errors, best, spent = [], [], copy.deepcopy(model.state_dict()), 0.0
    if checkpoint and checkpoint.exists():
        was = torch.load(checkpoint, map_location=device)
        losses, errors, best, spent = was["losses"], was["errors"], was["best"], was["seconds"]
        model.load_state_dict(was["model"])
        adam.load_state_dict(was["adam"])
    began = time.process_time() - spent
    for epoch in range(len(losses), config.epochs):
        set_rate(adam, config, epoch)
        for k in epoch_order(len(train), config.seed, epoch):
            run(("step", k), partial(gradients, train[k]), [weight.grad for weight in weights])
            adam.step()
        with torch.no_grad():
            rows = [run(("validation", k), partial(validated, batch), [found]).tolist()
                    for k, batch in enumerate(validation)]
        loss, *levels = np.mean(rows, axis=0).tolist()
        if loss < min(losses, default=np.inf):
            best = copy.deepcopy(model.state_dict())
        losses.append(loss)
        errors.append(levels)
        if checkpoint and len(losses) % KEPT_EVERY == 0:
            with replacing(checkpoint) as new:
                torch.save({"losses": losses, "errors": errors, "best": best, "seconds": time.process_time() - began,
                            "model": model.state_dict(), "adam": adam.state_dict()}, new)
    if checkpoint:
        checkpoint.unlink(missing_ok=True)
    model.load_state_dict(best)
    return Fit(model.cpu().eval().requires_grad_(False), np.array(losses), np.array(errors),
               time.process_time() - began)


def working(device: torch.device) -> Callable[..., Tensor]:
    """Brings what a piece of work gives into tensors, as `Recorder.run`: recorded on a GPU, as it is on a CPU."""
    if device.type == "cuda":
        return Recorder(device).run

    def run(key: Hashable, work: Callable[[], Iterable[Tensor]], results: Sequence[Tensor]) -> Tensor:
        copy_to(results, work())
        return results[0]

    return run


# --- meshes ------------------------------------------------------------------------------------------------------


def refined(model: NeuralSubdivision, pair: Pair, positions: Tensor, batch: Batch) -> list[Mesh]:
    """The levels that a network makes of a pair's coarse mesh, placed at `positions`."""
    from neusub.topology import topology_levels

    topologies, last = topology_levels(pair.faces, pair.level_sizes[0], pair.levels)
    with torch.no_grad():
        outputs = model(positions, batch.levels)
    faces = [*(topology.faces for topology in topologies), last]
    return [Mesh(out.double().numpy(), f) for out, f in zip(outputs, faces)]
