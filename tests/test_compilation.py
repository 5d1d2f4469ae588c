"""Truths of the compiled kernels that no compiler checks."""

import ast
from pathlib import Path

import pytest

import neusub

SOURCE = Path(neusub.__file__).parent
FOLDERS = [SOURCE, *(Path(__file__).parents[1] / name for name in ("tests", "benchmarks", "experiments", "examples"))]


def kernels_of(tree: ast.Module) -> dict[str, bool]:
    """Names of a module's kernels, and whether only kernels may call them."""
    found = {}
    for node in tree.body:
        for decorator in getattr(node, "decorator_list", []):
            if isinstance(decorator, ast.Call) and ast.unparse(decorator.func) == "njit":
                found[node.name] = any(option in ast.unparse(decorator) for option in ("INNER", "ONCE"))
    return found


def inner_of(tree: ast.Module) -> set[str]:
    return {name for name, is_inner in kernels_of(tree).items() if is_inner}


def wrong_mentions(tree: ast.Module, inner: dict[str, set[str]]) -> set[str]:
    """Inner kernels that a module names outside of kernels; inner: of each module that has any."""
    names, modules = inner_of(tree), {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("neusub"):
            for alias in node.names:
                if alias.name in inner.get(node.module, ()):
                    names.add(alias.asname or alias.name)
                modules[alias.asname or alias.name] = f"{node.module}.{alias.name}"
        elif isinstance(node, ast.Import):
            modules |= {alias.asname or alias.name: alias.name for alias in node.names}
    wrong = set()
    for node in tree.body:
        if getattr(node, "name", None) in kernels_of(tree):
            continue
        own = {other.id for other in ast.walk(node) if isinstance(other, ast.Name) and isinstance(other.ctx, ast.Store)}
        for mention in ast.walk(node):
            if isinstance(mention, ast.Name) and mention.id in names - own:
                wrong.add(mention.id)
            if isinstance(mention, ast.Attribute):
                owner = ast.unparse(mention.value)
                if mention.attr in inner.get(modules.get(owner, owner), ()):
                    wrong.add(mention.attr)
    return wrong


def test_only_kernels_name_inner_kernels():
    inner = {}
    for path in SOURCE.rglob("*.py"):
        module = ".".join(["neusub", *path.relative_to(SOURCE).with_suffix("").parts])
        inner[module] = inner_of(ast.parse(path.read_text()))
    assert sum(map(len, inner.values())) > 50
    for path in (path for folder in FOLDERS for path in folder.rglob("*.py")):
        wrong = wrong_mentions(ast.parse(path.read_text()), inner)
        assert not wrong, f"{path.name}: {', '.join(wrong)}"


@pytest.mark.parametrize("source", [
    "from neusub import kernels\nkernels.speak()",
    "from neusub import kernels\ndef f():\n    run(kernels.speak, 1)",
    "from neusub.kernels import speak\nrun(speak)",
    "from neusub.kernels import speak as s\ndef f():\n    s()",
    "import neusub.kernels\nneusub.kernels.speak()",
])
def test_a_mention_of_an_inner_kernel_is_found(source):
    assert wrong_mentions(ast.parse(source), {"neusub.kernels": {"speak"}})
