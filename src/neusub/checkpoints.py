"""Checkpoints of a training: a run that was interrupted goes on from one as if it had not been."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from neusub import __version__
from neusub.configuration import FOR_USE, TrainingConfig
from neusub.errors import TrainingError
from neusub.files import replacing

if TYPE_CHECKING:
    from neusub.training import Run

__all__ = ["State", "load_checkpoint", "save_checkpoint"]


@dataclass
class State:
    """What a checkpoint holds beside weights and optimizer."""

    epoch: int = 0  # epochs that are done
    best_loss: float = float("inf")
    best_epoch: int = 0
    seconds: float = 0.0


def save_checkpoint(path: Path, run: Run) -> None:
    """Weights, best weights and Adam's moments in one safetensors file, whole or not at all."""
    tensors = {f"model.{key}": value for key, value in run.model.state_dict().items()}
    tensors |= {f"best.{key}": value for key, value in run.best.items()}
    for index, moments in run.optimizer.state_dict()["state"].items():
        tensors |= {f"adam.{index}.{key}": value for key, value in moments.items()}
    header = {"config": asdict(run.config), "data": run.data, "start": run.start, "state": asdict(run.state),
              "version": __version__}
    with replacing(path) as new:
        save_file({k: v.detach().cpu().contiguous().clone() for k, v in tensors.items()}, new,
                  metadata={"neusub": json.dumps(header)})


def load_checkpoint(path: Path, run: Run) -> None:
    """Put a checkpoint into the run.  Raises TrainingError where it is unreadable or of another run."""
    try:
        with safe_open(path, framework="pt") as file:
            header = json.loads(file.metadata()["neusub"])
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dict)
    except (SafetensorError, OSError, KeyError, ValueError) as error:
        raise TrainingError(f"{path}: not a readable checkpoint ({error}). Remove it to begin anew.") from None
    free = {"device", "threads", "checkpoint_every", *FOR_USE}  # change nothing learned but its rounding
    here, default = (json.loads(json.dumps(asdict(config))) for config in (run.config, TrainingConfig()))
    lengths = [config["epochs"] // config["cycles"] for config in ({**default, **header["config"]}, here)]
    if run.config.schedule == "constant" or lengths[0] == lengths[1]:  # a run may go on for more cycles
        free |= {"epochs", "cycles"}
    for field in fields(TrainingConfig):
        was, now = header["config"].get(field.name, default[field.name]), here[field.name]
        if isinstance(now, dict):  # an option that came in after the run began has its default
            was = {**default[field.name], **was}
        if was != now and field.name not in free:
            raise TrainingError(f"{path}: the run has {field.name} = {was!r}, not {now!r}. Resume it with its own "
                                "options, or choose another folder.")
    for was, now in zip_longest(header["data"], run.data, fillvalue={}):  # older ones do not say what was held out
        if (was.get("hash"), was.get("held_out", now.get("held_out"))) != (now.get("hash"), now.get("held_out")):
            raise TrainingError(f"{path}: the run was begun on other pair files. Resume it with those, and the same "
                                "ones held out.")
    if (header.get("start") or {}).get("hash") != (run.start or {}).get("hash"):
        raise TrainingError(f"{path}: the run began with other weights. Resume it with the same model to start from.")
    run.model.load_state_dict({k[6:]: v for k, v in tensors.items() if k.startswith("model.")})
    run.best = {k[5:]: v for k, v in tensors.items() if k.startswith("best.")}
    moments: dict[int, dict[str, Tensor]] = {}
    for key, value in tensors.items():
        if key.startswith("adam."):
            _, index, name = key.split(".")
            moments.setdefault(int(index), {})[name] = value
    groups = run.optimizer.state_dict()["param_groups"]
    run.optimizer.load_state_dict({"state": moments, "param_groups": groups})
    run.state = State(**header["state"])
