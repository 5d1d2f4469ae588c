"""Threads of a training."""

import pytest
import torch

from neusub.threads import in_threads, some_threads


def test_threads_are_as_before_when_one_of_them_fails():
    before, seen = torch.get_num_threads(), []

    def fail(number: int) -> None:
        seen.append(torch.get_num_threads())
        raise ZeroDivisionError

    with some_threads(4):
        with pytest.raises(ZeroDivisionError), in_threads(2) as each:
            list(each(fail, range(2)))
        assert set(seen) == {2}
        assert torch.get_num_threads() == 4
    assert torch.get_num_threads() == before
