"""The README's pictures: docs/comparison.webp of the demo, docs/map.webp of examples/map.py.

    python -m experiments readme_pictures
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from experiments.common import HERE
from experiments.drawing import PICTURES, write_picture

EXAMPLES = HERE.parent / "examples"


def main() -> None:
    argparse.ArgumentParser(prog="python -m experiments readme_pictures", description=__doc__,
                            formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run([sys.executable, str(EXAMPLES / "demo.py"), "--output", folder], check=True)
        subprocess.run([sys.executable, str(EXAMPLES / "map.py"), "--output", folder / "map.png"], check=True)
        for picture in ("comparison", "map"):
            print(write_picture(picture, Image.open(folder / f"{picture}.png"), PICTURES.parent))


if __name__ == "__main__":
    main()
