"""Options of long work as frozen dataclasses, apart from what they configure: the command line reads them at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

__all__ = ["FOR_USE", "PRESETS", "Architecture", "PairConfig", "TrainingConfig"]


Activation = Literal["relu", "silu"]
Input = Literal["on_surface", "decimated"]
Loss = Literal["squared", "distance", "surface"]
Precision = Literal["32-true", "32", "bf16-mixed", "16-mixed"]
Schedule = Literal["constant", "cosine"]
Weighting = Literal["vertices", "areas"]
Bound = tuple[float, float] | tuple[float, float, float]  # in shortest edges, heights[, smallest altitudes]


def check_bound(bound: Bound | None) -> None:
    if bound is not None and len(bound) not in (2, 3):
        raise ValueError(f"bound = {bound}: give two numbers or three.")


def check_known(name: str, value: str, kind: Any) -> None:
    """kind: a Literal of what there is."""
    if value not in get_args(kind):
        raise ValueError(f"{name} = {value!r}: take one of {', '.join(get_args(kind))}.")


@dataclass(frozen=True)
class Architecture:
    """What a network is; the defaults are the paper's."""

    width: int = 32  # of the hidden layers
    features: int = 29  # learned, of each vertex
    vectors: int = 0  # learned too, and turning with the vertex's surroundings
    relative: bool = False  # lengths of each half-flap in units of its own mean edge: the network knows no scale
    residual: bool = False  # modules add to a vertex's features and vectors, instead of replacing them
    activation: Activation = "relu"
    turns: bool = False  # the input's vertices bring at how many edges the surface turns, and how far (`frames.py`)
    flat: float = 0.0  # displacements fade with heights below this many edges; 0: they do not (`bounds.py`)
    sharp: float = 0.0  # and around sharp edges of faces that are flat to this sine; 0: they do not (`bounds.py`)
    bound: Bound | None = None  # of displacements (`bounds.py`)
    trained: int = 2  # levels; beyond them `settle` acts
    settle: float = 0.0  # vertices go over to Loop's points where heights are below this many edges; 0: they do not
    crisp: bool = False  # displacements keep to the planes of faces between flat and sharp edges (`crisp.py`)
    unturned: bool = False  # no triangle is turned over that is not in the midpoint refinement (`bounds.py`)

    def __post_init__(self) -> None:
        check_bound(self.bound)
        for name, least in (("width", 1), ("features", 0), ("vectors", 0), ("trained", 1), ("flat", 0), ("sharp", 0),
                            ("settle", 0)):
            if not getattr(self, name) >= least:
                raise ValueError(f"{name} = {getattr(self, name)}: take at least {least}.")
        check_known("activation", self.activation, Activation)


FOR_USE = "bound", "sharp", "settle", "crisp", "unturned"  # of `TrainingConfig`: what changes nothing that is learned


@dataclass(frozen=True)
class TrainingConfig:
    """What a run does; saved with every checkpoint."""

    epochs: int = 700
    batch: int = 1  # meshes a step
    learning_rate: float = 2e-3
    schedule: Schedule = "constant"  # cosine goes down to zero at the end of each cycle
    cycles: int = 1  # of the cosine: each starts at the full rate (SGDR, Loshchilov and Hutter 2017)
    levels: int = 2  # at most; pairs with fewer are taken as deep as they are
    shallow: float = 0.0  # share of the steps that stop at level 1, where most of the error is: a fifth of the work
    input: Input = "on_surface"  # where the coarse vertices lie
    network: Architecture = Architecture()
    bound: Bound | None = (0.2, 0.3)  # of the trained model's displacements; `network` has that of the training
    sharp: float = 0.0  # of the trained model; `network` has that of the training
    settle: float = 0.0  # of the trained model, beyond `levels`
    crisp: bool = False  # of the trained model
    unturned: bool = False  # of the trained model
    loss: Loss = "squared"  # `Batch.loss`
    weighting: Weighting = "vertices"  # by the target's area around it, or each counts the same
    normals: float = 0.0  # weight of the error of the faces' normals in the loss, beside that of positions: smoothness
    seed: int = 0
    device: str = "auto"
    precision: Precision = "32-true"  # as Lightning Fabric names it: pairs are in single precision
    threads: int = 0  # of the CPU; 0 leaves them as they are
    checkpoint_every: int = 5  # epochs

    def __post_init__(self) -> None:
        for name in ("epochs", "batch", "levels", "cycles", "checkpoint_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} = {getattr(self, name)}: take at least 1.")
        if self.epochs % self.cycles:
            raise ValueError(f"epochs = {self.epochs}, cycles = {self.cycles}: take a multiple, or one cycle.")
        check_bound(self.bound)
        for name in ("settle", "crisp", "unturned"):
            if getattr(self.network, name):
                raise ValueError(f"network.{name} = {getattr(self.network, name)}: give the training's own, for use.")
        for name, kind in (("schedule", Schedule), ("input", Input), ("loss", Loss), ("weighting", Weighting),
                           ("precision", Precision)):
            check_known(name, getattr(self, name), kind)
        for name in ("seed", "threads"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} = {getattr(self, name)}: take at least 0.")
        if not self.normals >= 0:
            raise ValueError(f"normals = {self.normals}: take 0, or a positive weight.")
        if not 0 <= self.shallow <= 1:
            raise ValueError(f"shallow = {self.shallow}: take a share, 0 to 1.")
        if not self.learning_rate > 0:
            raise ValueError(f"learning_rate = {self.learning_rate}: take a positive number.")
        if self.cycles > 1 and self.schedule == "constant":
            raise ValueError(f"cycles = {self.cycles}: a constant schedule has none. Take schedule = 'cosine'.")
        self.for_use(self.levels)  # raises for what is out of range

    @property
    def is_single(self) -> bool:
        """Whether weights and sums are in single precision; Fabric knows it by two names."""
        return self.precision in ("32-true", "32")

    def for_use(self, levels: int) -> Architecture:
        """The network that comes out of the training; levels: how many it had."""
        return replace(self.network, trained=levels, **{name: getattr(self, name) for name in FOR_USE})


PRESETS = {
    "paper": TrainingConfig(),
    "fast": TrainingConfig(batch=4, schedule="cosine", epochs=400),
    "default": TrainingConfig(batch=2, schedule="cosine", epochs=72, cycles=2, learning_rate=1e-3, levels=3,
                              shallow=0.6, loss="surface",
                              network=Architecture(48, 40, vectors=3, relative=True, residual=True, activation="silu",
                                                   turns=True, flat=0.3, sharp=0.03, bound=(0.5, 0.6)),
                              bound=(0.25, 0.6, 0.3), sharp=0.04, settle=0.2, crisp=True, unturned=True),
}
PRESETS["default-decimated"] = replace(PRESETS["default"], input="decimated", sharp=0.08)


@dataclass(frozen=True)
class PairConfig:
    """How training pairs are made; kept in their files.  Give exactly one of per_mesh and total."""

    per_mesh: int | None = None  # training pairs of each source
    total: int | None = None  # training pairs of all sources together, spread evenly
    validation: int = 0  # held out, of all sources together; with seeds of their own
    vertices: tuple[int, int] = (150, 300)  # of the coarse meshes, both included
    levels: int = 2
    strategy: str = "random"
    seed: int = 0

    def __post_init__(self) -> None:
        if (self.per_mesh is None) == (self.total is None):
            raise ValueError(f"per_mesh = {self.per_mesh}, total = {self.total}: give exactly one.")
        for name in ("per_mesh", "total", "levels"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"{name} = {value}: take at least 1.")
        for name in ("validation", "seed"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} = {getattr(self, name)}: take at least 0.")
        if not 4 <= self.vertices[0] <= self.vertices[1]:
            raise ValueError(f"vertices = {self.vertices}: take a range from at least 4 upwards.")

    def counts(self, n_sources: int) -> dict[str, list[int]]:
        """Pairs of each source, for each split; the first sources get one more where it does not come out even."""
        def spread(total: int) -> list[int]:
            return [total // n_sources + (k < total % n_sources) for k in range(n_sources)]

        train = [self.per_mesh] * n_sources if self.per_mesh else spread(self.total or 0)
        return {"train": train, "validation": spread(self.validation)}
