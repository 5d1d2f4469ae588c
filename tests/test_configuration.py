"""Options of trainings and architectures that cannot be: named errors, before any work."""

import pytest

from neusub.configuration import Architecture, TrainingConfig


@pytest.mark.parametrize("name, value", [("width", 0), ("features", -1), ("vectors", -1), ("settle", float("nan")),
                                         ("activation", "tanh")])
def test_an_architecture_that_cannot_be_is_named(name, value):
    with pytest.raises(ValueError, match=f"{name} = .*: take"):
        Architecture(**{name: value})


@pytest.mark.parametrize("name, value", [("loss", "sqared"), ("weighting", "area"), ("schedule", "cos"),
                                         ("input", "on"), ("precision", "64-true")])
def test_a_misspelt_option_is_named(name, value):
    with pytest.raises(ValueError, match=f"{name} = '{value}': take one of"):
        TrainingConfig(**{name: value})


@pytest.mark.parametrize(("options", "message"), [
    ({"seed": -5}, "seed = -5: take"), ({"normals": -1}, "normals = -1: take 0"),
    ({"settle": -1.0}, "settle = -1.0: take at least 0"), ({"sharp": -1.0}, "sharp = -1.0: take at least 0"),
    ({"cycles": 2}, "cycles = 2: a constant schedule has none")])
def test_options_out_of_range_are_refused_before_any_work(options, message):
    with pytest.raises(ValueError, match=message):
        TrainingConfig(**options)
