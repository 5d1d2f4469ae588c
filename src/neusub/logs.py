"""What a training tells of each epoch: log.csv, and TensorBoard events."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

__all__ = ["TrainingLog"]


class TrainingLog:
    """log.csv and TensorBoard events, one row an epoch; rows after the checkpoint that a run resumes from go."""

    columns = ("epoch", "training_loss", "validation_loss", "best_loss", "best_epoch", "seconds", "seconds_left")

    def __init__(self, folder: Path, epoch: int):
        self.path, self.folder, self.epoch = folder / "log.csv", folder, epoch

    def __enter__(self) -> TrainingLog:
        from torch.utils.tensorboard import SummaryWriter

        rows = []
        if self.path.exists() and self.epoch:
            with self.path.open(newline="") as file:
                rows = [row for row in csv.DictReader(file) if int(row["epoch"]) <= self.epoch]
        self.file = self.path.open("w", newline="")
        self.writer: csv.DictWriter = csv.DictWriter(self.file, self.columns)
        self.writer.writeheader()
        self.writer.writerows(rows)
        self.board = SummaryWriter(str(self.folder), purge_step=self.epoch + 1)
        return self

    def write(self, state: Any, training_loss: float, loss: float, epochs: int) -> dict:
        left = state.seconds / state.epoch * (epochs - state.epoch)
        row = dict(zip(self.columns, (state.epoch, training_loss, loss, state.best_loss, state.best_epoch,
                                      round(state.seconds, 3), round(left, 1))))
        self.writer.writerow(row)
        self.file.flush()
        for name in ("training_loss", "validation_loss"):
            self.board.add_scalar(name, row[name], state.epoch)
        return row

    def __exit__(self, *_) -> None:
        self.file.close()
        self.board.close()
