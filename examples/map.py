"""Any mesh down, any point back: decimate a fine mesh, send points through the map, and draw it.

    python examples/map.py --output map.png
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from demo import blob

from neusub import decimate
from neusub.map_pictures import render_map


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("map.png"))
    options = parser.parse_args()
    fine = blob()
    result = decimate(fine, n_faces=300)
    sys.stdout.write(f"{result.report()}\n")

    corner = np.array([[1 / 3, 1 / 3, 1 / 3]])
    faces, barycentric = result.to_fine(np.array([0]), corner)  # the centre of coarse face 0
    back = result.to_coarse(faces, barycentric)
    sys.stdout.write(f"centre of coarse face 0 -> fine face {faces[0]} -> coarse face {back[0][0]}, {back[1][0]}\n")

    height = result.transfer(fine.vertices[:, 1], levels=2)  # a signal on the fine vertices, on two levels
    sys.stdout.write(f"{len(height)} values on the second level, {height.min():.3f} to {height.max():.3f}\n")
    sys.stdout.write(f"picture: {render_map(result, options.output)}\n")


if __name__ == "__main__":
    main()
