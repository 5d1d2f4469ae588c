"""Named errors.  Each message names the element, its value and the remedy; all derive from `NeusubError`."""

from __future__ import annotations

__all__ = ["MeshError", "ModelError", "NeusubError", "PairFileError", "TrainingError"]


class NeusubError(Exception):
    """Base of every error that neusub raises on purpose."""


class MeshError(NeusubError, ValueError):
    """A mesh that cannot be used as it is."""


class PairFileError(NeusubError, ValueError):
    """A file of training pairs that is missing, broken or does not hold what was asked for."""


class TrainingError(NeusubError, ValueError):
    """A training run that cannot be begun, resumed or continued."""


class ModelError(NeusubError, ValueError):
    """A file of weights that is missing, broken or of another kind."""
