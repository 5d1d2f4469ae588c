"""Training, in one readable loop: pairs in, one safetensors file of weights out.

The paper's protocol (`preset="paper"`): one mesh a step, Adam at 2e-3, 700 epochs, the weights of the epoch with the
best validation loss kept.  The order of an epoch depends on the seed and the epoch alone and a checkpoint holds the
optimizer's state, so a run that was interrupted and resumed equals one that was not, bit for bit on a CPU.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from neusub.checkpoints import State, load_checkpoint, save_checkpoint
from neusub.configuration import FOR_USE, PRESETS, TrainingConfig
from neusub.errors import PairFileError, TrainingError
from neusub.generation import Batch, Pair, batch_pairs, file_hash, load_pairs, read_header, scaled, shortened
from neusub.logs import TrainingLog
from neusub.network import NeuralSubdivision
from neusub.recording import Recorder, has_room
from neusub.subdivider import Subdivider, resolve_device
from neusub.threads import Map, in_threads, some_threads, workers_of

__all__ = ["PRESETS", "TrainingConfig", "TrainingResult", "epoch_order", "make_recordable", "mean_coarse_edge",
           "set_rate", "train"]

EDGE = 0.1  # mean coarse edge that pairs are brought to for a network that knows no scale: about the paper's
KEPT_PAIRS = 2000  # prepared pairs that are kept in memory, some 3 MB each of two levels, four times that of three on
# a GPU; above, they are prepared when needed


@dataclass(frozen=True)
class TrainingResult:
    """The best weights of a run and how it went.

    best_loss is of the network that was trained; loss_in_use of the model, which has what `TrainingConfig` adds for use
    (bounds), on the same held-out pairs: None without them.
    """

    model: Subdivider
    best_loss: float
    loss_in_use: float | None
    best_epoch: int
    epochs: int
    seconds: float
    folder: Path


@dataclass
class Run:
    """A run under way."""

    config: TrainingConfig
    data: list[dict]  # headers of the pair files
    pairs: list[Pair]
    fabric: Any
    model: Any
    optimizer: Any
    best: dict[str, Tensor]
    state: State
    recorder: Recorder | None = None  # on a GPU
    start: dict | None = None  # `origin_of` the model that the weights began as

    @classmethod
    def begin(cls, train_files: Sequence[str | Path], validation_files: Sequence[str | Path], config: TrainingConfig,
              start: Subdivider | None = None):
        """Read the headers and the training pairs; seed weights and optimizer."""
        from lightning_fabric import Fabric

        for given in (train_files, validation_files):
            if isinstance(given, str) or not isinstance(given, Sequence):
                raise PairFileError(f"pairs are given as a {type(given).__name__}. Give a list of pair files.")
        files = [*train_files, *validation_files]
        data = [{**read_header(f), "file": Path(f).name, "hash": file_hash(f), "held_out": k >= len(train_files)}
                for k, f in enumerate(files)]
        pairs = read_pairs(train_files, config)
        if not pairs:
            raise PairFileError("no training pairs. Give the files that `neusub pairs` or `import-pairs` wrote.")
        deepest = max(pair.levels for pair in pairs)
        if deepest < config.levels:
            warnings.warn(f"no pair has more than {deepest} levels: {deepest} are trained, not {config.levels}. Make "
                          "deeper pairs for more.", stacklevel=4)
        for pair in pairs:
            pair.positions(config.input)  # raises where there are none
        device = torch.device(resolve_device(config.device))
        fabric = Fabric(accelerator=device.type, devices=1 if device.index is None or device.type == "cpu"
                        else [device.index], precision=config.precision)  # type: ignore[arg-type]
        torch.manual_seed(config.seed)
        network = NeuralSubdivision(config.network)
        if start:
            network.load_state_dict(weights_to_start(start, config))
        adam = torch.optim.Adam(network.parameters(), lr=config.learning_rate, fused=True)
        model, optimizer = fabric.setup(network, adam)
        recorder = Recorder(fabric.device) if recordable(config, fabric.device, len(pairs)) else None
        return cls(config, data, pairs, fabric, model, optimizer, copied(model.state_dict()), State(), recorder,
                   origin_of(start) if start else None)

    def epoch(self, batches: _Batches, validation: list[Batch], each: Map) -> tuple[float, float]:
        """One epoch; its training and its validation loss, NaN where nothing is held out.

        The weights of the epoch with the least are kept; where nothing is held out, with the least training loss, or of
        the last one, if some steps are shallow, for then an epoch's loss says mostly how many were.
        """
        began = time.perf_counter()
        set_rate(self.optimizer, self.config, self.state.epoch)
        training_loss = run_epoch(self.fabric, self.model, self.optimizer, batches, self.state.epoch, each,
                                  self.recorder)
        loss = training_loss
        if validation:
            loss = validate(self.model.module, validation, self.config, each, self.recorder)
        if not np.isfinite(training_loss + loss):
            raise TrainingError(f"the loss of epoch {self.state.epoch + 1} is not finite. Train in another folder at "
                                f"a learning rate below {self.config.learning_rate}, or look for broken pairs.")
        self.state.epoch += 1
        self.state.seconds += time.perf_counter() - began
        if loss < self.state.best_loss or (self.config.shallow and not validation):
            self.state.best_loss, self.state.best_epoch = loss, self.state.epoch
            self.best = copied(self.model.state_dict())
        return training_loss, loss if validation else float("nan")

    def best_model(self) -> Subdivider:
        """The best weights with their card."""
        is_validated = any(entry["held_out"] for entry in self.data)
        plan = self.config.for_use(max(pair.levels for pair in self.pairs))
        network = NeuralSubdivision(plan)
        network.load_state_dict({key: value.cpu() for key, value in self.best.items()})
        keys = ("file", "hash", "source", "source_hash", "split", "licence", "count")
        card = {
            "architecture": {"kind": "half-flap", **asdict(plan)},
            "input": self.config.input,
            "scale": {"box": mean_coarse_box(self.pairs, self.config.input),
                      "edge": mean_coarse_edge(self.pairs, self.config.input)},
            "training": {
                "config": asdict(self.config),
                "data": [{key: entry[key] for key in keys if key in entry} for entry in self.data],
                "epochs": self.state.epoch,
                "seconds": round(self.state.seconds, 1),
                **({"start": self.start} if self.start else {}),
            },
            "licence": licences([*self.data, *([self.start] if self.start else [])]),
            "scores": {f"{kind}_{key}": value for kind in ("validation" if is_validated else "training",)
                       for key, value in (("loss", self.state.best_loss), ("epoch", self.state.best_epoch))},
        }
        return Subdivider(network, card)


def train(
    train_files: Sequence[str | Path],
    validation_files: Sequence[str | Path],
    out: str | Path,
    config: TrainingConfig | None = None,
    *,
    start: Subdivider | None = None,
    resume: bool = False,
    on_epoch: Callable[[dict], None] | None = None,
) -> TrainingResult:
    """Train a network from pair files.

    Writes into `out`: model.safetensors (the best weights so far, with their card), checkpoint.safetensors, log.csv and
    TensorBoard events.

    start: the model whose weights the run begins with, in place of random ones (fine-tuning); its network is the
    config's, and its weights are the best ones, of epoch 0, until an epoch is better.  on_epoch is called with each row
    of the log.
    Raises TrainingError for a folder that already holds a run (unless resume), a checkpoint of another configuration,
    start or other data, a start of another network, or a loss that is not finite; PairFileError.
    """
    config, out = config or PRESETS["paper"], Path(out)
    checkpoint = out / "checkpoint.safetensors"
    if checkpoint.exists() and not resume:
        raise TrainingError(f"{out} holds a run already. Pass resume (--resume) to go on with it, or another folder.")
    with some_threads(config.threads):
        return trained(train_files, validation_files, out, config, start, on_epoch)


def trained(train_files: Sequence[str | Path], validation_files: Sequence[str | Path], out: Path,
            config: TrainingConfig, start: Subdivider | None, on_epoch: Callable[[dict], None] | None,
            ) -> TrainingResult:
    """`train` in a folder without a run, or with one to resume."""
    checkpoint = out / "checkpoint.safetensors"
    run = Run.begin(train_files, validation_files, config, start)
    if checkpoint.exists():
        load_checkpoint(checkpoint, run)
    if run.state.epoch > config.epochs:
        raise TrainingError(f"{out}: the run has {run.state.epoch} epochs already, {config.epochs} were asked for.")
    workers = workers_of(config, run.fabric.device)
    batches = _Batches(run.pairs, config, run.fabric.device, workers)
    validation = [batch_of([pair], config, run.fabric.device) for pair in read_pairs(validation_files, config)]
    make_recordable(validation)
    if start and validation and not run.state.epoch:  # a run that only makes them worse gives back what it began with
        run.state.best_loss = validate(run.model.module, validation, config)
    out.mkdir(parents=True, exist_ok=True)
    with TrainingLog(out, run.state.epoch) as log, in_threads(workers) as each:
        while run.state.epoch < config.epochs:
            row = log.write(run.state, *run.epoch(batches, validation, each), config.epochs)
            if run.state.epoch % config.checkpoint_every == 0 or run.state.epoch == config.epochs:
                run.best_model().save(out / "model.safetensors")
                save_checkpoint(checkpoint, run)
            if on_epoch:
                on_epoch(row)
    model, in_use, state = run.best_model(), None, run.state
    if validation:
        network = model.network.to(run.fabric.device)
        in_use = model.card["scores"]["validation_loss_in_use"] = validate(network, validation, config)
        network.cpu()
    model.save(out / "model.safetensors")
    return TrainingResult(model, state.best_loss, in_use, state.best_epoch, state.epoch, state.seconds, out)


def read_pairs(files: Sequence[str | Path], config: TrainingConfig) -> list[Pair]:
    """The pairs, with at most the trained levels; for a network that knows no scale, each at the same scale."""
    pairs = [shortened(pair, config.levels) for file in files for pair in load_pairs(file)]
    return [scaled(pair, EDGE / mean_coarse_edge([pair])) for pair in pairs] if config.network.relative else pairs


def batch_of(pairs: list[Pair], config: TrainingConfig, device: torch.device) -> Batch:
    return batch_pairs(pairs, config.input, device, weighting=config.weighting, normals=config.normals > 0)


def loss_of_batch(batch: Batch, outputs: list[Tensor], config: TrainingConfig) -> Tensor:
    return batch.loss(outputs, config.loss, config.normals)


def licences(origins: Iterable[dict]) -> str:
    return "; ".join(sorted({part for entry in origins for part in entry.get("licence", "not stated").split("; ")}))


def weights_to_start(start: Subdivider, config: TrainingConfig) -> dict[str, Tensor]:
    """Raises TrainingError where they are of another network than the config's."""
    plan, wanted = asdict(start.network.plan), asdict(config.network)
    differing = [name for name in wanted if name not in (*FOR_USE, "trained") and plan[name] != wanted[name]]
    if differing:
        details = ", ".join(f"{name} {plan[name]}, not {wanted[name]}" for name in differing)
        raise TrainingError(f"the model to start from is another network: {details}. Train with the preset or the "
                            "architecture that it came from.")
    return start.network.state_dict()


def origin_of(start: Subdivider) -> dict:
    """What a model's card and a checkpoint say of the model that a run began with: which weights, and how they came."""
    content = b"".join(value.float().cpu().numpy().tobytes() for _, value in sorted(start.network.state_dict().items()))
    known = {key: start.card[key] for key in ("licence", "sources", "scores", "training") if key in start.card}
    return {"hash": sha256(content).hexdigest()[:16], **known}


def make_recordable(batches: list[Batch]) -> None:
    """On a GPU, have half-flaps make all that they keep: a recording must find it there."""
    for level in (level for batch in batches if batch.positions.is_cuda for level in batch.levels):
        level.by_vertex.complete()
        level.by_edge.complete()


def copied(weights: dict[str, Tensor]) -> dict[str, Tensor]:
    return {key: value.clone() for key, value in weights.items()}


def epoch_order(count: int, seed: int, epoch: int) -> np.ndarray:
    """The order of the meshes in an epoch."""
    return np.random.default_rng([seed, epoch]).permutation(count)


def mean_coarse_edge(pairs: list[Pair], input: str = "on_surface") -> float:
    """Mean edge length of the coarse meshes of one kind of input, in the unit of the targets."""
    edges = [np.diff(pair.positions(input)[pair.topologies[0].edges], axis=1) for pair in pairs]
    return float(np.mean([np.linalg.norm(vectors, axis=-1).mean() for vectors in edges]))


def mean_coarse_box(pairs: list[Pair], input: str) -> float:
    """Mean of the longest sides of their boxes."""
    return float(np.mean([np.ptp(pair.positions(input), axis=0).max() for pair in pairs]))


def run_epoch(fabric, model, optimizer, batches: _Batches, epoch: int, each: Map, recorder: Recorder | None) -> float:
    """One pass over the training pairs; the mean loss of a mesh, over the levels that its step went to."""
    weights = list(model.parameters())
    total, count = torch.zeros((), device=fabric.device, dtype=torch.float64), 0
    if recorder:  # recordings leave gradients in the same place
        for weight in weights:
            weight.grad = torch.zeros_like(weight) if weight.grad is None else weight.grad

    def loss_of(part: Batch, depth: int, meshes: int) -> Tensor:
        with fabric.autocast():  # the module itself: the wrapper would copy the half-flaps, to convert them
            outputs = model.module(part.positions, part.levels[:depth])
        return loss_of_batch(part, outputs, batches.config) / meshes

    def with_gradients(part: Batch, depth: int, meshes: int) -> tuple[Tensor, ...]:
        loss = loss_of(part, depth, meshes)
        return loss.detach(), *torch.autograd.grad(loss, weights)

    for number, parts, meshes, depth in batches.epoch(epoch):
        if recorder:
            loss = recorder.run((number, depth), partial(with_gradients, parts[0], depth, meshes),
                                [recorder.loss, *(weight.grad for weight in weights)], number in batches.kept)
        else:
            optimizer.zero_grad(set_to_none=True)
            if len(parts) == 1:
                loss = loss_of(parts[0], depth, meshes)
                fabric.backward(loss)
            else:
                losses, *gradients = zip(*each(partial(with_gradients, depth=depth, meshes=meshes), parts))
                loss = torch.stack(losses).sum()
                for weight, shares in zip(weights, gradients):
                    weight.grad = sum(shares[1:], start=shares[0])
        optimizer.step()
        total += loss.detach() * meshes
        count += meshes
    return float(total) / count


def recordable(config: TrainingConfig, device: torch.device, pairs: int) -> bool:
    """Whether steps are recorded: on a CUDA GPU, of batches that are kept, in single precision.  (Half of the bits may
    scale losses by what is found in the gradients, which a recording cannot ask for.)"""
    if device.type != "cuda" or not config.is_single:
        return False
    if pairs > KEPT_PAIRS:
        warnings.warn(f"{pairs} training pairs: above {KEPT_PAIRS} steps are not recorded as CUDA graphs, and training "
                      "takes several times as long. Train on fewer.", stacklevel=5)
    return pairs <= KEPT_PAIRS


def validate(model, batches: list[Batch], config: TrainingConfig, each: Map = map,
             recorder: Recorder | None = None) -> float:
    """Mean over the meshes of the loss of one."""
    def loss_of(number: int, batch: Batch) -> Tensor:
        def work() -> list[Tensor]:
            return [loss_of_batch(batch, model(batch.positions, batch.levels), config)]

        with torch.no_grad():
            return recorder.run(number, work, [recorder.loss]).clone() if recorder else work()[0]

    return float(np.mean([float(x) for x in each(loss_of, range(len(batches)), batches)]))


def set_rate(optimizer, config: TrainingConfig, epoch: int) -> None:
    """The learning rate of an epoch."""
    cycle = config.epochs // config.cycles
    factors = {"constant": 1.0, "cosine": 0.5 * (1 + np.cos(np.pi * (epoch % cycle) / cycle))}
    for group in optimizer.param_groups:
        group["lr"] = config.learning_rate * factors[config.schedule]


class _Batches:
    """The training pairs in fixed groups of equal depth, in a part for each worker, made once and kept; only their
    order changes from epoch to epoch.

    Unions that changed with the epoch were a quarter slower, as each had to be sorted anew.
    """

    def __init__(self, pairs: list[Pair], config: TrainingConfig, device: torch.device, workers: int):
        self.pairs, self.config, self.device, self.workers = pairs, config, device, workers
        count = len(pairs)
        order = np.arange(count) if config.batch == 1 else np.random.default_rng(config.seed).permutation(count)
        depths = np.array([pair.levels for pair in pairs])
        self.groups = [alike[i : i + config.batch] for depth in np.unique(depths)
                       for alike in (order[depths[order] == depth],) for i in range(0, len(alike), config.batch)]
        self.kept: dict[int, list[Batch]] = {}

    def epoch(self, epoch: int) -> Iterator[tuple[int, list[Batch], int, int]]:
        """Of each batch its number, its parts, its number of meshes, and to which level its step goes."""
        stops = np.random.default_rng([self.config.seed, epoch, 1]).random(len(self.groups)) < self.config.shallow
        for k in epoch_order(len(self.groups), self.config.seed, epoch):
            parts, group = self.kept.get(k), self.groups[k]
            if parts is None:
                parts = [batch_of([self.pairs[i] for i in part], self.config, self.device)
                         for part in np.array_split(group, min(self.workers, len(group)))]
                if len(self.pairs) <= KEPT_PAIRS and has_room(self.device):
                    self.kept[k] = parts
                    make_recordable(parts)
            yield int(k), parts, len(group), 1 if stops[k] else len(parts[0].levels)
