"""Steps that a GPU's recording can take: none asks the device for a value, none brings it one."""

from dataclasses import replace

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

import neusub.training
import shapes
from neusub.flaps import FlapGroups, LevelFlaps
from neusub.generation import Batch, FaceTargets
from neusub.layers import columns
from neusub.network import NeuralSubdivision
from neusub.training import PRESETS, batch_of, loss_of_batch, recordable
from test_training import CONFIG, loop_pair


def test_which_trainings_are_recorded():
    gpu, most = torch.device("cuda"), neusub.training.KEPT_PAIRS
    assert all(recordable(config, gpu, most) for config in PRESETS.values())
    assert recordable(replace(CONFIG, precision="32"), gpu, 1)
    assert not recordable(CONFIG, torch.device("cpu"), 1)
    assert not recordable(replace(CONFIG, precision="bf16-mixed"), gpu, 1)
    with pytest.warns(UserWarning, match="not recorded"):
        assert not recordable(CONFIG, gpu, most + 1)


class NothingFromTheHost(TorchDispatchMode):
    """Raises where a tensor is used that neither was given nor came out of an operation: one made of Python's numbers,
    which are copied to the device."""

    def __init__(self, given):
        super().__init__()
        self.kept, self.known = [], set()
        self.remember(given)

    def remember(self, values):
        for storage in (x.untyped_storage() for x in tree_leaves(values) if isinstance(x, torch.Tensor)):
            self.kept.append(storage)  # or its number would be another's later
            self.known.add(storage._cdata)

    def __torch_dispatch__(self, operation, types, args=(), kwargs=None):
        for x in tree_leaves((args, kwargs)):
            assert not isinstance(x, torch.Tensor) or x.untyped_storage()._cdata in self.known, operation
        results = operation(*args, **(kwargs or {}))
        self.remember(results)
        return results


def without_numbers(batch: Batch) -> Batch:
    """On torch's device meta, where every question about a value raises, as it does while a GPU's work is recorded."""
    def bare(tensor):
        return None if tensor is None else tensor.to("meta")

    def groups(known: FlapGroups) -> FlapGroups:
        known.complete()
        values = {name: tuple(map(bare, value)) if isinstance(value, tuple) else bare(value)
                  for name, value in vars(known).items()}
        made = FlapGroups(values["corners"], values["missing"], values["offsets"])
        vars(made).update(values)
        return made

    levels = [LevelFlaps(groups(level.by_vertex), groups(level.by_edge), bare(level.edges), level.topology)
              for level in batch.levels]
    return Batch(bare(batch.positions), levels, bare(batch.targets), [bare(w) for w in batch.weights],
                 bare(batch.normals), [FaceTargets(*map(bare, level)) for level in batch.faces])


@pytest.mark.parametrize("preset", ["paper", "default"])
@pytest.mark.parametrize("shape", [shapes.torus(), shapes.grid()])
def test_a_step_asks_its_device_for_nothing_and_brings_it_nothing(shape, preset):
    config = replace(PRESETS[preset], normals=0.03)
    batch = without_numbers(batch_of([loop_pair(*shape)], config, torch.device("cpu")))
    network = NeuralSubdivision(config.network).to("meta")
    columns.cache_clear()
    given = [batch.positions, batch.targets, batch.normals, batch.weights, batch.faces, list(network.parameters()),
             [level.edges for level in batch.levels],
             [list(vars(groups).values()) for level in batch.levels for groups in (level.by_vertex, level.by_edge)]]
    with NothingFromTheHost(given):
        loss = loss_of_batch(batch, network(batch.positions, batch.levels), config)
        gradients = torch.autograd.grad(loss, list(network.parameters()))
        with torch.no_grad():
            loss_of_batch(batch, network(batch.positions, batch.levels), config)
    assert [g.shape for g in gradients] == [w.shape for w in network.parameters()]
