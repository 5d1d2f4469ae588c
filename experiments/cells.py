"""Cells and rows of the documentation's tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from experiments.measures import SCHEMES

LABELS = {"loop": "Loop", "bunny": "`bunny`", "elephant": "`elephant`", "default": "`default`",
          "default, uncross": "`default`, crossings taken back"}
ALL = (*SCHEMES, "elephant", "default")


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(cells) + " |\n" for cells in (head, *rows)]
    return "".join([lines[0].replace("|  |", "| |"), "|" + "---|" * len(head) + "\n", *lines[1:]])


def label(method: str) -> str:
    return LABELS.get(method, method)


def hm(entry: dict) -> str:
    return f"{entry['H']:.2f} / {entry['M']:.3f}"


def hmn(entry: dict) -> str:
    return f"{hm(entry)} / {entry['normals']:.1f}"
