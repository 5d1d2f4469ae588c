"""python -m experiments list | NAME [options]"""

from __future__ import annotations

import importlib
import pkgutil
import sys

import experiments


def names() -> list[str]:
    """The modules that have a `main`, which is what an experiment is."""
    found = []
    for module in pkgutil.iter_modules(experiments.__path__):
        if not module.name.startswith("_") and hasattr(importlib.import_module(f"experiments.{module.name}"), "main"):
            found.append(module.name)
    return found


def main() -> int:
    arguments = sys.argv[1:] or ["list"]
    if arguments[0] == "list":
        for name in names():
            module = importlib.import_module(f"experiments.{name}")
            shows = ", ".join(getattr(module, "SHOWS", ()))
            print(f"{name:20s}{(module.__doc__ or '').splitlines()[0]}{f'  [{shows}]' if shows else ''}")
        return 0
    if arguments[0] not in names():
        print(f"{arguments[0]}: no experiment of this name. There are {', '.join(names())}.", file=sys.stderr)
        return 2
    sys.argv = [f"python -m experiments {arguments[0]}", *arguments[1:]]
    importlib.import_module(f"experiments.{arguments[0]}").main()
    return 0


if __name__ == "__main__":
    sys.exit(main())
