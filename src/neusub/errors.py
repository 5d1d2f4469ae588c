"""Named errors.  Each message names the element, its value and the remedy; all derive from `NeusubError`."""

from __future__ import annotations

__all__ = [
    "DecimationError",
    "DuplicateFaceError",
    "EmptyMeshError",
    "IndexRangeError",
    "MeshError",
    "MeshFileError",
    "ModelError",
    "NeusubError",
    "NonFiniteError",
    "NonManifoldEdgeError",
    "NonManifoldVertexError",
    "OrientationError",
    "PairFileError",
    "ParameterizationError",
    "RepeatedVertexError",
    "ShapeError",
    "TooLargeError",
    "TrainingError",
    "UnreferencedVertexError",
]


class NeusubError(Exception):
    """Base of every error that neusub raises on purpose."""


class MeshError(NeusubError, ValueError):
    """A mesh that cannot be used as it is."""


class ShapeError(MeshError):
    """An array of the wrong shape or type."""


class EmptyMeshError(MeshError):
    """A mesh without faces."""


class NonFiniteError(MeshError):
    """A coordinate that is NaN, infinite, or so large (above 1e75) that squares of areas are."""


class IndexRangeError(MeshError):
    """A face that points at a vertex, or a texture vertex, that does not exist."""


class RepeatedVertexError(MeshError):
    """A face that has the same vertex at two corners."""


class DuplicateFaceError(MeshError):
    """Two faces over the same three vertices, in whatever order."""


class NonManifoldEdgeError(MeshError):
    """An edge with three or more faces."""


class OrientationError(MeshError):
    """Two neighbouring faces that run the same way along their common edge."""


class NonManifoldVertexError(MeshError):
    """A vertex whose faces form more than one fan."""


class UnreferencedVertexError(MeshError):
    """A vertex that no face uses."""


class TooLargeError(MeshError):
    """A refinement that this machine's memory cannot hold."""


class MeshFileError(NeusubError, OSError):
    """A file that cannot be read or written: missing, a folder, of unknown kind, truncated, without permission."""


class PairFileError(NeusubError, ValueError):
    """A file of training pairs that is missing, broken or does not hold what was asked for."""


class DecimationError(NeusubError, ValueError):
    """A decimation that was asked for something impossible: no target, two, one above the mesh's size."""


class ParameterizationError(NeusubError, ValueError):
    """A point that does not lie in the mesh, a signal of another size, or a file that holds no map."""


class TrainingError(NeusubError, ValueError):
    """A training run that cannot be begun, resumed or continued."""


class ModelError(NeusubError, ValueError):
    """A file of weights that is missing, broken or of another kind."""
