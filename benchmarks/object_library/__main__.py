"""Makes a library of varied closed meshes, and measures the time to check them.

`python -m benchmarks.object_library OUT --meshes 1000 --seed 0 --intake`; then
`qdgrasp campaign OUT/library.csv --gripper panda --skip-unusable` is a campaign over all of them.
"""

import argparse
import time
from pathlib import Path

from benchmarks.object_library.generator import make_library

from qdgrasp_assets.mesh_check import check_mesh


def intake(out: Path) -> tuple[float, int]:
    """Check every mesh of a library, and return the seconds that took and how many cannot be used."""
    begun = time.perf_counter()
    bad = sum(bool(check_mesh(file).faults) for file in sorted((out / "meshes").iterdir()))
    return time.perf_counter() - begun, bad


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("out", type=Path, help="a new folder")
    parser.add_argument("--meshes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--intake", action="store_true", help="check all of them twice, and say how long it takes"
    )
    given = parser.parse_args()
    print(make_library(given.out, given.meshes, given.seed))
    if given.intake:
        for turn in ("first", "second"):
            seconds, bad = intake(given.out)
            print(f"{turn} time: {seconds:.1f} s, {bad} of {given.meshes} cannot be used")


if __name__ == "__main__":
    main()
