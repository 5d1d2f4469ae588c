"""neusub: data-driven subdivision of triangle meshes (Neural Subdivision, Liu et al., SIGGRAPH 2020).

    mesh = neusub.load("cow.obj")
    fine = neusub.subdivide(mesh, levels=2)[-1]
    neusub.save(fine, "cow_fine.obj")

Names are imported when they are first used, so that the command line answers at once.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.1.0"

_WHERE = {
    "Mesh": "mesh",
    "NeusubError": "errors",
    "MeshError": "errors",
    "load": "io",
    "save": "io",
    "info": "repair",
    "Subdivider": "subdivider",
    "subdivide": "subdivider",
    "distance": "metrics",
    "decimate": "selfparam",
    "SelfParameterization": "selfparam",
    "remesh": "remeshing",
    "render": "pictures",
    "make_pairs": "discretization",
    "import_pairs": "importing",
    "train": "training",
    "PairConfig": "configuration",
    "TrainingConfig": "configuration",
    "PRESETS": "configuration",
    "Criteria": "selfparam",
}

__all__ = [
    "PRESETS",
    "Criteria",
    "Mesh",
    "MeshError",
    "NeusubError",
    "PairConfig",
    "SelfParameterization",
    "Subdivider",
    "TrainingConfig",
    "__version__",
    "decimate",
    "distance",
    "import_pairs",
    "info",
    "load",
    "make_pairs",
    "remesh",
    "render",
    "save",
    "subdivide",
    "train",
]

if TYPE_CHECKING:
    from neusub.configuration import PRESETS as PRESETS
    from neusub.configuration import PairConfig as PairConfig
    from neusub.configuration import TrainingConfig as TrainingConfig
    from neusub.discretization import make_pairs as make_pairs
    from neusub.errors import MeshError as MeshError
    from neusub.errors import NeusubError as NeusubError
    from neusub.importing import import_pairs as import_pairs
    from neusub.io import load as load
    from neusub.io import save as save
    from neusub.mesh import Mesh as Mesh
    from neusub.metrics import distance as distance
    from neusub.pictures import render as render
    from neusub.remeshing import remesh as remesh
    from neusub.repair import info as info
    from neusub.selfparam import Criteria as Criteria
    from neusub.selfparam import SelfParameterization as SelfParameterization
    from neusub.selfparam import decimate as decimate
    from neusub.subdivider import Subdivider as Subdivider
    from neusub.subdivider import subdivide as subdivide
    from neusub.training import train as train


def __getattr__(name: str):
    if name not in _WHERE:
        raise AttributeError(f"module 'neusub' has no attribute {name!r}")
    value = getattr(import_module(f"neusub.{_WHERE[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
