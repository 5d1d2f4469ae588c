"""Truths of the compiled kernels that no compiler checks."""

import ast
from pathlib import Path

import neusub

SOURCE = Path(neusub.__file__).parent
TESTS = Path(__file__).parent


def kernels_of(tree: ast.Module) -> dict[str, bool]:
    """Names of a module's kernels, and whether only kernels may call them."""
    found = {}
    for node in tree.body:
        for decorator in getattr(node, "decorator_list", []):
            if isinstance(decorator, ast.Call) and ast.unparse(decorator.func) == "njit":
                found[node.name] = "INNER" in ast.unparse(decorator)
    return found


def test_inner_kernels_are_called_by_kernels_alone():
    trees = {path: ast.parse(path.read_text()) for path in [*SOURCE.rglob("*.py"), *TESTS.glob("*.py")]}
    known = {path.stem: kernels_of(tree) for path, tree in trees.items()}
    assert sum(map(sum, (found.values() for found in known.values()))) > 50
    for path, tree in trees.items():
        inner = {name for name, is_inner in known[path.stem].items() if is_inner}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("neusub."):
                module = known.get(node.module.rpartition(".")[2], {})
                inner |= {alias.name for alias in node.names if module.get(alias.name)}
        for node in tree.body:
            if getattr(node, "name", None) in known[path.stem]:
                continue
            called = {ast.unparse(call.func) for call in ast.walk(node) if isinstance(call, ast.Call)}
            wrong = called & (inner | {f"kernels.{name}" for name, is_inner in known["kernels"].items() if is_inner})
            assert not wrong, f"{path.name}: {', '.join(wrong)}"
