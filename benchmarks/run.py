"""All benchmarks for CPUs, one after the other: `make bench`.  Words after the command, such as --large, go to the last
two.  `gpu.py` is for a GPU."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

if __name__ == "__main__":
    for name in ("startup", "schemes", "network", "selfparam"):
        print(f"--- {name}", flush=True)
        words = sys.argv[1:] if name in ("network", "selfparam") else []
        subprocess.run([sys.executable, str(Path(__file__).with_name(f"{name}.py")), *words], check=True)
