"""What tests share: where the reference data lies, and the skip that says it is absent."""

from pathlib import Path

import pytest

SHARED = Path(__file__).parents[2] / "shared"


@pytest.fixture(scope="session")
def golden() -> Path:
    if not (SHARED / "golden").is_dir():
        pytest.skip("../shared/golden is absent: numbers of the reference implementation are not compared")
    return SHARED / "golden"


@pytest.fixture(scope="session")
def elephant() -> Path:
    path = SHARED / "data" / "elephant" / "cartoon_elephant.npz"
    if not path.is_file():
        pytest.skip("../shared/data/elephant is absent: the authors' pairs are not read")
    return path
