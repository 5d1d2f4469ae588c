"""Every command and every line of Python in the README and in the guide runs."""

import re
import shlex
from pathlib import Path

import pytest

import neusub
import shapes
from neusub.mesh import Mesh
from test_cli import neusub_command

ROOT = Path(__file__).parents[1]
README, GUIDE = ((ROOT / name).read_text() for name in ("README.md", "docs/guide.md"))
BLOCKS = re.findall(r"```(\w*)\n(.*?)```", README + GUIDE, flags=re.S)
COMMANDS = [line.split("#")[0].strip() for kind, text in BLOCKS if not kind for line in text.splitlines()
            if line.startswith("neusub ")]
OWN_PAIRS = [line for line in COMMANDS if "my_pairs" in line]
ELEPHANT = [line for line in COMMANDS if line not in OWN_PAIRS
            and (line.split()[1] in ("import-pairs", "train") or "run/model" in line)]


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    neusub.save(Mesh(**shapes.uv_box()), "cow.obj")
    neusub.save(Mesh(*shapes.cube()), "part.obj")
    neusub.save(Mesh(*shapes.icosphere(1)), "lod.obj")
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
        if line in OWN_PAIRS or line in ELEPHANT:
            continue
        words = [path for word in shlex.split(line)[1:] for path in matching(word)]
        status, _, err = neusub_command(capsys, *words)
        assert status == 0, f"{line}: {err}"


def test_its_training_on_own_pairs_runs(workplace, capsys):
    run_shortened(OWN_PAIRS, capsys)
    assert Path("my_run/model.safetensors").exists()


def test_its_training_on_the_authors_pairs_runs(workplace, elephant, capsys):
    (workplace / "cartoon_elephant.npz").symlink_to(elephant)
    run_shortened(ELEPHANT, capsys)
    assert Path("run/model.safetensors").exists()


def run_shortened(lines, capsys):
    """Run commands with one epoch, and six pairs instead of 200."""
    for line in lines:
        words = ["6" if word == "200" else word for word in shlex.split(line)[1:]]
        status, _, err = neusub_command(capsys, *words, *(["--epochs", "1"] if " train " in line else []))
        assert status == 0, f"{line}: {err}"


def test_its_python_runs(workplace, capsys):
    names: dict = {}  # a page is read from its top, so later lines know what came before
    for kind, text in BLOCKS:
        if kind == "python":
            exec(compile(text, "README.md or docs/guide.md", "exec"), names)
    assert len(neusub.load("cow_fine.obj").faces) == 16 * len(neusub.load("cow.obj").faces)
