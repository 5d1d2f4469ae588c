"""Every command and every line of Python in the README runs."""

import re
import shlex
from pathlib import Path

import pytest

import neusub
import shapes
from neusub.mesh import Mesh
from test_cli import neusub_command

README = (Path(__file__).parents[1] / "README.md").read_text()
BLOCKS = re.findall(r"```(\w*)\n(.*?)```", README, flags=re.S)
COMMANDS = [line.split("#")[0].strip() for kind, text in BLOCKS if not kind for line in text.splitlines()
            if line.startswith("neusub ")]
TRAINING = [line for line in COMMANDS if line.split()[1] in ("import-pairs", "train") or "run/model" in line]


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    neusub.save(Mesh(**shapes.uv_box()), "cow.obj")
    neusub.save(Mesh(*shapes.cube()), "part.obj")
    neusub.save(Mesh(*shapes.icosphere(3)), "original.obj")
    neusub.save(Mesh(*shapes.grid()), "scan.ply")
    return tmp_path


def matching(word: str) -> list[str]:
    """What a shell makes of a word."""
    return sorted(map(str, Path().glob(word))) if "*" in word else [word]


def test_the_readme_has_commands_and_python():
    assert len(COMMANDS) > 10
    assert any(kind == "python" for kind, _ in BLOCKS)


def test_its_commands_run(workplace, capsys):
    for line in COMMANDS:
        if line in TRAINING:
            continue
        words = [path for word in shlex.split(line)[1:] for path in matching(word)]
        status, _, err = neusub_command(capsys, *words)
        assert status == 0, f"{line}: {err}"


def test_its_training_runs(workplace, elephant, capsys):
    (workplace / "cartoon_elephant.npz").symlink_to(elephant)
    for line in TRAINING:
        words = shlex.split(line)[1:] + (["--epochs", "1"] if " train " in line else [])
        status, _, err = neusub_command(capsys, *words)
        assert status == 0, f"{line}: {err}"
    assert Path("run/model.safetensors").exists()


def test_its_python_runs(workplace, capsys):
    for kind, text in BLOCKS:
        if kind == "python":
            exec(compile(text, "README.md", "exec"), {})
    assert len(neusub.load("cow_fine.obj").faces) == 16 * len(neusub.load("cow.obj").faces)
