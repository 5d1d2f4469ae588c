"""python -m experiments list | NAME [options]"""

from __future__ import annotations

import ast
import importlib
import sys
from pathlib import Path


def experiments() -> dict[str, ast.Module]:
    """The modules that have a `main`, which is what an experiment is; read, not imported, as that takes seconds."""
    modules = {path.stem: ast.parse(path.read_text()) for path in sorted(Path(__file__).parent.glob("[!_]*.py"))}
    return {name: module for name, module in modules.items()
            if any(isinstance(node, ast.FunctionDef) and node.name == "main" for node in module.body)}


def summary(module: ast.Module) -> str:
    """The first paragraph of a module's docstring, and the labels of the paper's source that it answers to."""
    words = " ".join((ast.get_docstring(module) or "").split("\n\n")[0].split())
    labels = [ast.literal_eval(node.value) for node in module.body if isinstance(node, ast.Assign)
              and isinstance(node.targets[0], ast.Name) and node.targets[0].id == "SHOWS"]
    return words + "".join(f"  [{', '.join(shows)}]" for shows in labels)


def main() -> int:
    known, (name, *rest) = experiments(), sys.argv[1:] or ["list"]
    if name == "list":
        for key, module in known.items():
            print(f"{key:20s}{summary(module)}")
        return 0
    if name not in known:
        print(f"{name}: no experiment of this name. There are {', '.join(known)}.", file=sys.stderr)
        return 2
    sys.argv = [f"python -m experiments {name}", *rest]
    importlib.import_module(f"experiments.{name}").main()
    return 0


if __name__ == "__main__":
    sys.exit(main())
