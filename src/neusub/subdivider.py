"""A trained network with what it needs to know: load, save, subdivide.

A model is one safetensors file: the weights, and a JSON card in its header that says what it is, what it was trained
on, under which licence, for which kind of input and at which scale.
"""

from __future__ import annotations

import copy
import json
from importlib import resources
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from numpy import ndarray
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from neusub import __version__
from neusub.configuration import Architecture, Input
from neusub.creases import cut_open, marked_creases, refine_creases
from neusub.crossing import uncrossed
from neusub.errors import ModelError
from neusub.files import replacing
from neusub.flaps import level_flaps
from neusub.memory import check_fits, freed_memory_kept
from neusub.mesh import Mesh, check_is_mesh
from neusub.network import NeuralSubdivision
from neusub.schemes import subdivide_classic, subdivision_operator
from neusub.topology import Topology, connected_components, topology_levels

__all__ = ["Subdivider", "model_names", "subdivide"]

FORMAT = "neusub-model-1"
DEFAULT_MODEL = "default"
THIN = 1e-6  # an altitude, of the largest coordinate
THIN_PART = 1e-3  # a thickness, of the length
Scheme = Literal["neural", "loop", "butterfly", "midpoint"]
Scale = Literal["edge", "box", "none"]


def model_names() -> list[str]:
    """Names of the models that come with the package."""
    return sorted(path.name.removesuffix(".safetensors") for path in resources.files("neusub.weights").iterdir()
                  if path.name.endswith(".safetensors"))


class Subdivider:
    """A trained network and its card.  The card's `scale` gives the training's unit box and mean coarse edge."""

    def __init__(self, network: NeuralSubdivision, card: dict[str, Any]):
        check_card(card)
        self.network = network.eval().requires_grad_(False)
        self.card = card

    @classmethod
    def load(cls, name_or_path: str | Path = DEFAULT_MODEL, *, device: str = "auto",
             dtype: torch.dtype = torch.float32) -> Subdivider:
        """Load a model by its name (see `model_names`) or its file; dtype: float32 or float64.  Raises ModelError."""
        if dtype not in (torch.float32, torch.float64):
            raise ModelError(f"dtype {dtype}: take torch.float32 or torch.float64.")
        path = Path(name_or_path)
        if str(name_or_path) in model_names():
            path = Path(str(resources.files("neusub.weights") / f"{name_or_path}.safetensors"))
        elif not path.is_file():
            raise ModelError(f"{name_or_path}: neither a file nor a model that comes with neusub "
                             f"({', '.join(model_names()) or 'there are none'}).")
        try:
            with safe_open(path, framework="pt") as file:
                header = json.loads((file.metadata() or {}).get("neusub", "{}"))
                weights = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dict)
        except (SafetensorError, OSError, ValueError) as error:
            raise ModelError(f"{path}: not a readable safetensors file ({error}).") from None
        if header.get("format") != FORMAT:
            raise ModelError(f"{path}: the header's format is {header.get('format')!r}, not {FORMAT!r}.")
        card = {key: value for key, value in header.items() if key not in ("format", "version")}
        check_card(card)
        architecture = card["architecture"]
        try:
            network = NeuralSubdivision(checked_architecture(architecture))
            network.load_state_dict(weights)
        except (KeyError, RuntimeError, TypeError, ValueError) as error:
            raise ModelError(f"{path}: the weights do not fit the architecture {architecture} ({error}).") from None
        bad = next((name for name, values in weights.items() if not values.isfinite().all()), None)
        if bad:
            raise ModelError(f"{path}: the weights {bad} are not all finite. Train it again, or get it again.")
        return cls(network.to(resolve_device(device), dtype), card)

    def save(self, path: str | Path) -> None:
        """Write weights and card as one file, whole or not at all."""
        header = {"format": FORMAT, "version": __version__, **self.card}
        weights = {key: value.float().cpu().contiguous() for key, value in self.network.state_dict().items()}
        with replacing(path) as new:
            save_file(weights, new, metadata={"neusub": json.dumps(header, sort_keys=True)})

    def companion(self, input: Input) -> Subdivider:
        """The model for a kind of input: this one, or the one that its card names.  Raises ModelError."""
        if input == self.card["input"]:
            return self
        name = self.card.get("companions", {}).get(input)
        if name is None:
            raise ModelError(f"the model is for {self.card['input']} input, and its card names no weights for {input}. "
                             "Leave the kind of input out, or take another model.")
        weight = next(self.network.parameters())
        return Subdivider.load(name, device=str(weight.device), dtype=weight.dtype)

    def subdivide(self, mesh: Mesh, levels: int = 2, limit_levels: int = 0, *, scale: Scale = "edge",
                  input: Input | None = None, creases: ndarray | None = None,
                  crease_angle: float | None = None) -> list[Mesh]:
        """Levels 0 .. levels of the network, then `limit_levels` of classic Loop, in the mesh's own scale and place.

        Level 0 has the input's faces and vertices that the network moved.  scale: what is brought to the card's
        before the network and taken back after it, by one factor for all levels: "edge", each component's mean edge;
        "box", the longest side of the whole mesh's box; "none", nothing.
        input: where the coarse vertices lie, if not as the model's card says: "on_surface", "decimated" (`companion`).
        creases: bool (nE,), edge indices (n,) or vertex pairs (n, 2), and crease_angle, in degrees, of the edges that
        are creases too: they go along butterfly's curve rule, and neither side of them sees the other.
        UVs go linearly along each corner's edges, colours to the mean of an edge's ends.
        Raises ValueError for levels below 1, an unknown scale or a crease that is no edge, ModelError for a kind of
        input without weights.
        """
        if input is not None and input != self.card["input"]:
            return self.companion(input).subdivide(mesh, levels, limit_levels, scale=scale, creases=creases,
                                                   crease_angle=crease_angle)
        if levels < 1 or limit_levels < 0:
            raise ValueError(f"levels = {levels}, limit_levels = {limit_levels}: at least one level, and none below 0.")
        check_fits(len(mesh.faces), levels + limit_levels)
        with freed_memory_kept(len(mesh.faces) * 4**levels):
            return self._levels(mesh, levels, limit_levels, scale, creases, crease_angle)

    def _levels(self, mesh: Mesh, levels: int, limit_levels: int, scale: Scale, creases: ndarray | None,
                crease_angle: float | None) -> list[Mesh]:
        topologies, faces = topology_levels(mesh.faces, len(mesh.vertices), levels)
        sharp = marked_creases(topologies[0], mesh.vertices, creases, crease_angle)
        if sharp is not None and sharp.any():
            outputs = self._creased(mesh.vertices, topologies, faces, sharp, scale)
        else:
            outputs = self._refined(mesh.vertices, topologies, scale)
        result, colors = [mesh.replace_vertices(outputs[0])], mesh.colors
        for topology, fine, vertices in zip(topologies, [*(t.faces for t in topologies[1:]), faces], outputs[1:]):
            if colors is not None:
                colors = np.concatenate([colors, colors[topology.edges].mean(axis=1)])
            result.append(result[-1].refined(vertices, fine, colors))
        if limit_levels == 0:
            return result
        if sharp is not None:
            for topology, finer in zip(topologies, [*topologies[1:], result[-1].topology]):
                sharp = refine_creases(topology, sharp, finer)
        return result + subdivide_classic(result[-1], "loop", limit_levels, creases=sharp)[1:]

    def _refined(self, vertices: ndarray, topologies: list[Topology], scale: Scale,
                 given: list[tuple[ndarray, ndarray]] | None = None) -> list[ndarray]:
        """Positions of each level; given: of each level, vertices and their places."""
        component, centre, factor = self._normalisation(vertices, topologies[0], scale)
        components = [component]
        for topology in topologies:
            components.append(np.concatenate([components[-1], components[-1][topology.edges[:, 0]]]))
        network = self.network
        normalised = (vertices - centre[component]) * factor[component, None]
        if has_thin_faces(normalised, topologies[0].faces) or has_thin_parts(normalised, component):
            network = copy.deepcopy(network).double()
        weight = next(network.parameters())

        def seen(positions: ndarray, component: ndarray) -> torch.Tensor:
            values = (positions - centre[component]) * factor[component, None]
            return torch.as_tensor(values, dtype=weight.dtype, device=weight.device)

        puts = None if given is None else [
            (torch.as_tensor(index, device=weight.device), seen(places, component[index]))
            for (index, places), component in zip(given, components)]
        with torch.inference_mode():
            flaps = [level_flaps(topology, weight.device) for topology in topologies]
            outputs = network(seen(vertices, component), flaps, puts)
            del flaps
        return [output.cpu().numpy() / factor[component, None] + centre[component]
                for output, component in zip(outputs, components)]

    def _creased(self, vertices: ndarray, topologies: list[Topology], faces: ndarray, sharp: ndarray,
                 scale: Scale) -> list[ndarray]:
        """Positions of each level: the mesh is cut along its creases, whose own points butterfly's curves give."""
        cut_faces, origin = cut_open(topologies[0], sharp)
        cuts, last_cut = topology_levels(cut_faces, len(origin), len(topologies))
        copies = []  # of each level, for each of its vertices one of the cut mesh's: their faces' corners correspond
        for whole, cut in zip([*(t.faces for t in topologies), faces], [*(t.faces for t in cuts), last_cut]):
            copies.append((whole.reshape(-1), cut.reshape(-1)))
        curves = subdivision_operator(topologies[0], "butterfly", len(topologies), creases=sharp).apply(vertices)
        given, masks = [], [np.zeros(len(vertices), dtype=bool)]
        masks[0][topologies[0].edges[sharp]] = True
        for topology, finer in zip(topologies, [*topologies[1:], None]):
            masks.append(np.concatenate([masks[-1], sharp]))
            if finer is not None:
                sharp = refine_creases(topology, sharp, finer)
        for (whole, cut), mask, places in zip(copies, masks, curves):
            on_crease = mask[whole]
            given.append((cut[on_crease], places[whole[on_crease]]))
        outputs = self._refined(vertices[origin], cuts, scale, given)
        results = []
        for (whole, cut), output, places in zip(copies, outputs, curves):
            result = places.copy()  # isolated vertices stay
            result[whole] = output[cut]
            results.append(result)
        return results

    def _normalisation(self, vertices: ndarray, topology: Topology, scale: Scale):
        """Component of each vertex; centre (k, 3) and factor (k,) of each component."""
        if scale == "edge":
            count, component = connected_components(topology.faces, len(vertices))
            factor = self.card["scale"]["edge"] / _mean_edges(vertices, topology, component, count)
        elif scale in ("box", "none"):
            count, component = 1, np.zeros(len(vertices), dtype=np.int64)
            side = float(np.ptp(vertices, axis=0).max())
            factor = np.array([self.card["scale"]["box"] / (side or 1.0) if scale == "box" else 1.0])
        else:
            raise ValueError(f"scale {scale!r} is not one of 'edge', 'box', 'none'.")
        weights = np.bincount(component, minlength=count)
        centre = np.stack([np.bincount(component, vertices[:, k], count) / weights for k in range(3)], axis=1)
        return component, centre, factor


def _mean_edges(vertices, topology: Topology, component: Int64[ndarray, " nV"], count: int) -> Float[ndarray, " k"]:
    """Mean edge length of each component; 1 where all its vertices coincide."""
    a, b = topology.edges.T
    lengths = np.linalg.norm(vertices[a] - vertices[b], axis=1)
    mean = np.bincount(component[a], lengths, count) / np.bincount(component[a], minlength=count)
    return np.where(mean > 0, mean, 1.0)


def has_thin_faces(vertices: Float64[ndarray, "nV 3"], faces: Int64[ndarray, "nF 3"]) -> bool:
    """Whether single precision cannot tell on which side of its longest edge some triangle lies.

    Those without area have no sides.
    """
    a, b, c = (vertices[column] for column in faces.T)
    doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.sqrt(np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0))
    return bool(((doubled > 0) & (doubled < THIN * np.abs(vertices).max() * longest)).any())


def has_thin_parts(vertices: Float64[ndarray, "nV 3"], component: Int64[ndarray, " nV"]) -> bool:
    """Whether single precision would be seen in the thickness of some component: of a plate, a thousandth of its size.

    Planes have none.  vertices: of each component around its centre.
    """
    products = [np.bincount(component, vertices[:, i] * vertices[:, j]) for i in range(3) for j in range(3)]
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(np.stack(products, axis=1).reshape(-1, 3, 3)), 0))
    return bool(((spread[:, 0] < THIN_PART * spread[:, 2]) & (spread[:, 0] > 1e-9 * spread[:, 2])).any())


def check_card(card: dict[str, Any]) -> None:
    """Raises ModelError where a card lacks what a model needs."""
    missing = {"architecture", "input", "scale"} - card.keys()
    if missing:
        raise ModelError(f"the model's card lacks {', '.join(sorted(missing))}. Save it with Subdivider.save.")
    if not isinstance(card["architecture"], dict):
        raise ModelError(f"the card's architecture is {card['architecture']!r}, not its options by name. Save it with "
                         "Subdivider.save.")
    if card["input"] not in get_args(Input):
        raise ModelError(f"the card's input is {card['input']!r}: take one of {', '.join(get_args(Input))}.")
    scale = card["scale"]
    if not isinstance(scale, dict) or not all(isinstance(scale.get(key), (int, float)) and scale[key] > 0
                                              for key in ("box", "edge")):
        raise ModelError(f"the card's scale is {scale!r}: give the training's box and edge, both above 0.")


def checked_architecture(entries: dict[str, Any]) -> Architecture:
    """A card's architecture.  Raises KeyError, TypeError or ValueError where it is none."""
    entries = {key: value for key, value in entries.items() if key != "kind"}
    if entries.get("bound") is not None:
        entries["bound"] = tuple(map(float, entries["bound"]))
    return Architecture(**entries)


def resolve_device(device: str) -> str:
    """`auto` is the GPU where there is one.  Raises ModelError for a device that is not there."""
    if device == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        raise ModelError(f"device {device!r} is not available ({str(error).splitlines()[0]}). Use 'auto' or 'cpu'.") \
            from None
    return device


def subdivide(
    mesh: Mesh,
    scheme: Scheme = "neural",
    levels: int = 2,
    *,
    model: str | Path | Subdivider = DEFAULT_MODEL,
    limit_levels: int = 0,
    scale: Scale = "edge",
    input: Input | None = None,
    device: str = "auto",
    creases: Any = None,
    crease_angle: float | None = None,
    uncross: bool = False,
) -> list[Mesh]:
    """Refine a mesh by a network or a classical scheme; the list of its levels, 0 first.

    limit_levels: levels of Loop after that.  model, scale, input, device: of the neural scheme (`Subdivider`).  creases
    (edges as vertex pairs) or crease_angle (degrees): edges that stay sharp; midpoint has no use for them.
    uncross: no faces cross or turn over that do not in the midpoint refinement of the level before (`crossing.py`).
    Raises ValueError for an unknown scheme, levels below 0 (below 1 of the network), or creases with midpoint;
    TooLargeError for more levels than fit into memory; TypeError for what is no mesh.
    """
    check_is_mesh(mesh)
    if scheme not in get_args(Scheme):
        raise ValueError(f"unknown scheme {scheme!r}: take one of {', '.join(get_args(Scheme))}.")
    if levels < 0 or limit_levels < 0:
        raise ValueError(f"levels = {levels}, limit_levels = {limit_levels}: none may be below 0.")
    if scheme == "midpoint" and (creases is not None or crease_angle is not None):
        raise ValueError("the scheme 'midpoint' has no creases. Use another scheme, or leave them out.")
    if scheme == "neural":
        model = model if isinstance(model, Subdivider) else Subdivider.load(model, device=device)
        result = model.subdivide(mesh, levels, limit_levels, scale=scale, input=input, creases=creases,
                                 crease_angle=crease_angle)
    else:
        result = subdivide_classic(mesh, scheme, levels, creases=creases, crease_angle=crease_angle,
                                   limit_levels=limit_levels)
    return uncrossed(mesh, result) if uncross else result
