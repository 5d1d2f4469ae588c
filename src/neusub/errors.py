"""Named errors.  Each message names the element, its value and the remedy; all derive from `NeusubError`."""

from __future__ import annotations

__all__ = ["MeshError", "NeusubError"]


class NeusubError(Exception):
    """Base of every error that neusub raises on purpose."""


class MeshError(NeusubError, ValueError):
    """A mesh that cannot be used as it is."""
