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
    "import_pairs": "generation",
    "train": "training",
    "PairConfig": "configuration",
    "TrainingConfig": "configuration",
    "Architecture": "configuration",
    "PRESETS": "configuration",
    "Criteria": "selfparam",
    "Pair": "generation",
    "load_pairs": "generation",
    "save_pairs": "generation",
    "TrainingResult": "training",
    "point_distance": "metrics",
    "sample_surface": "metrics",
    "face_normals": "metrics",
    "decimate_maps": "selfparam.maps",
}

__all__ = [
    "PRESETS",
    "Architecture",
    "Criteria",
    "Mesh",
    "MeshError",
    "NeusubError",
    "Pair",
    "PairConfig",
    "SelfParameterization",
    "Subdivider",
    "TrainingConfig",
    "TrainingResult",
    "__version__",
    "decimate",
    "decimate_maps",
    "distance",
    "face_normals",
    "import_pairs",
    "info",
    "load",
    "load_pairs",
    "make_pairs",
    "point_distance",
    "remesh",
    "render",
    "sample_surface",
    "save",
    "save_pairs",
    "subdivide",
    "train",
]

if TYPE_CHECKING:
    from neusub.configuration import PRESETS as PRESETS
    from neusub.configuration import Architecture as Architecture
    from neusub.configuration import PairConfig as PairConfig
    from neusub.configuration import TrainingConfig as TrainingConfig
    from neusub.discretization import make_pairs as make_pairs
    from neusub.errors import MeshError as MeshError
    from neusub.errors import NeusubError as NeusubError
    from neusub.generation import Pair as Pair
    from neusub.generation import import_pairs as import_pairs
    from neusub.generation import load_pairs as load_pairs
    from neusub.generation import save_pairs as save_pairs
    from neusub.io import load as load
    from neusub.io import save as save
    from neusub.mesh import Mesh as Mesh
    from neusub.metrics import distance as distance
    from neusub.metrics import face_normals as face_normals
    from neusub.metrics import point_distance as point_distance
    from neusub.metrics import sample_surface as sample_surface
    from neusub.pictures import render as render
    from neusub.remeshing import remesh as remesh
    from neusub.repair import info as info
    from neusub.selfparam import Criteria as Criteria
    from neusub.selfparam import SelfParameterization as SelfParameterization
    from neusub.selfparam import decimate as decimate
    from neusub.selfparam.maps import decimate_maps as decimate_maps
    from neusub.subdivider import Subdivider as Subdivider
    from neusub.subdivider import subdivide as subdivide
    from neusub.training import TrainingResult as TrainingResult
    from neusub.training import train as train


def __getattr__(name: str):
    if name not in _WHERE:
        raise AttributeError(f"module 'neusub' has no attribute {name!r}")
    value = getattr(import_module(f"neusub.{_WHERE[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
