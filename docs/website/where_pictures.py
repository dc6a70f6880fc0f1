"""Pictures of a few grasps of runs for docs/where.md, with neighbours and regions.

python -m docs.website.where_pictures docs/where runs/handle runs/in-a-bin runs/shelved
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_tools.export.grasp_reader import GraspChoice, read_run, select_grasps
from qdgrasp_tools.rendering.views import view_of_hands

HANDS, PIXELS, COLOURS = 3, 480, 128
AZIMUTHS = {"handle": -30.0, "in-a-bin": -30.0, "shelved": -60.0}  # From where each is seen [deg]


def main(out: Path, *runs: Path) -> None:
    """Draw a picture of each run, called as its folder."""
    out.mkdir(parents=True, exist_ok=True)
    for run in runs:
        grasps = select_grasps(read_run(RunFolder.open(run)), GraspChoice(diverse=HANDS))
        image = view_of_hands(grasps.scene, grasps.rows, np.radians(AZIMUTHS[run.name]), PIXELS).image
        picture = Image.fromarray(np.rint(255 * image).astype(np.uint8))
        few = picture.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
        few.save(out / f"{run.name}.png", optimize=True)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
