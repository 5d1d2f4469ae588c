"""What tests share: fresh kernels, where the reference data lies, and the skip that says it is absent."""

from pathlib import Path

import pytest
from hypothesis import settings

SHARED = Path(__file__).parents[2] / "shared"
SOURCE = Path(__file__).parents[1] / "src" / "neusub"

settings.register_profile("untimed", deadline=None)  # kernels may have to be compiled, and machines are busy
settings.load_profile("untimed")


def pytest_configure(config: pytest.Config) -> None:
    """numba compiles a kernel anew when its own file has changed, but not when a kernel that it calls has: compile all
    of them anew where any file is newer than what is cached."""
    if hasattr(config, "workerinput"):
        return  # a worker of pytest-xdist: the controller has done it before it started one
    for folder in (SOURCE, SOURCE / "selfparam"):
        cached = {path: path.stat().st_mtime for path in (folder / "__pycache__").glob("*.nb[ic]")}
        kernels = [path for path in folder.glob("*.py") if "njit" in path.read_text()]
        if cached and max(path.stat().st_mtime for path in kernels) > min(cached.values()):
            for path in cached:
                path.unlink(missing_ok=True)


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
