"""Options of long work as frozen dataclasses, apart from what they configure: the command line reads them at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["PRESETS", "TrainingConfig"]


@dataclass(frozen=True)
class TrainingConfig:
    """What a run does; saved with every checkpoint."""

    epochs: int = 700
    batch: int = 1  # meshes a step
    learning_rate: float = 2e-3
    schedule: Literal["constant", "cosine"] = "constant"  # cosine goes down to zero at the last epoch
    levels: int = 2
    input: Literal["on_surface", "decimated"] = "on_surface"  # where the coarse vertices lie
    width: int = 32
    features: int = 29  # learned, of each vertex
    seed: int = 0
    device: str = "auto"
    precision: str = "32-true"  # as Lightning Fabric names it
    threads: int = 0  # of the CPU; 0 leaves them as they are
    checkpoint_every: int = 5  # epochs

    def __post_init__(self) -> None:
        for name in ("epochs", "batch", "levels", "width", "features", "checkpoint_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} = {getattr(self, name)}: take at least 1.")
        if not self.learning_rate > 0:
            raise ValueError(f"learning_rate = {self.learning_rate}: take a positive number.")


PRESETS = {
    "paper": TrainingConfig(),
    "fast": TrainingConfig(batch=4, schedule="cosine", epochs=400),
}
