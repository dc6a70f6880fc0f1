"""Tests ranked grasps under other disturbances: `python -m benchmarks.physics.calibration`.

Each run is carried out, ranked, and its grasps are simulated again; then its lines stand in the table, and
page and figure are made of the table anew. A run that the table has, of the same numbers and code, is not
simulated again; simulations of an interrupted run are in the folder.
"""

import argparse
import hashlib
import sys
import time
from pathlib import Path

from benchmarks.physics.calibration import report, table
from benchmarks.physics.calibration.study import EVALUATIONS, SCENES, SEEDS, Design, Study, design_of
from benchmarks.physics.calibration.table import Origin, RunKey
from benchmarks.results.measure import HEX

from qdgrasp_protocol.errors import QdgraspError
from qdgrasp_worker.engines import ENGINES
from qdgrasp_worker.platform import code_digest, worlds
from qdgrasp_worker.syntax_digest import syntax_digest

TABLE = Path(__file__).resolve().parents[3] / "docs" / "results" / "calibration.csv"
NAME_DIGITS = 12
NUMBERS = {
    "best": "grasps of each run by rank",
    "held": "grasps drawn of the others that hold",
    "successes": "grasps drawn of the successes that are left",
    "trials": "trials of a drawn grasp",
    "arm": "errors of the arm for each grasp",
}
"""The numbers of a design besides its budget."""


def origin_of(design: Design) -> Origin:
    """The origin of runs that are measured now."""
    mujoco = syntax_digest(*worlds(ENGINES["mujoco"]))
    return Origin(design.words, code_digest()[:HEX], mujoco[:HEX])


def measure_missing(runs: list[tuple[RunKey, Design]], out: Path, file: Path) -> None:
    """Measure the runs that the table does not have, one after the other."""
    for run, design in runs:
        origin = origin_of(design)
        if table.is_measured(table.read(file), run, origin):
            print(f"{run.words}: is in", file=sys.stderr, flush=True)
            continue
        folder = out / hashlib.sha256("\n".join(origin).encode()).hexdigest()[:NAME_DIGITS]
        folder.mkdir(parents=True, exist_ok=True)
        began = time.process_time()
        rows = Study(run, design, folder).measure(origin)
        report.write(table.add(file, run, rows), file)
        seconds = time.process_time() - began
        print(f"{run.words}: {len(rows)} grasps, {seconds:.0f} CPU s", file=sys.stderr, flush=True)


def scene_of(words: str) -> tuple[str, str]:
    """A hand and an object."""
    hand, colon, target = words.partition(":")
    if not (hand and colon and target):
        raise argparse.ArgumentTypeError(f"must be HAND:OBJECT, such as panda:ycb_mug, got {words}")
    return hand, target


def count(words: str) -> int:
    """Parse a positive whole number."""
    if not words.isdecimal() or not int(words):
        raise argparse.ArgumentTypeError(f"must be a whole number greater than 0, got {words}")
    return int(words)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = argparse.ArgumentParser(prog="python -m benchmarks.physics.calibration", description=__doc__)
    made.add_argument("--out", type=Path, metavar="DIR", help="keeps what was simulated")
    made.add_argument("--page", action="store_true", help="make page and figure of the table, and no more")
    made.add_argument(
        "--table", type=Path, default=TABLE, metavar="FILE", help="page and figure lie beside it"
    )
    made.add_argument("--scenes", nargs="+", type=scene_of, default=SCENES, metavar="HAND:OBJECT")
    made.add_argument("--seeds", nargs="+", type=int, default=SEEDS, metavar="N")
    budgets = ", ".join(f"{hand} {budget}" for hand, budget in EVALUATIONS.items())
    made.add_argument("--evaluations", type=count, metavar="N", help=f"of each run (default: {budgets})")
    for name, words in NUMBERS.items():
        default = getattr(Design, name)
        made.add_argument(
            f"--{name}", type=count, default=default, metavar="N", help=f"{words} (default: {default})"
        )
    return made


def main(words: list[str] | None = None) -> None:
    """Measure the missing runs, or make the page."""
    given = parser()
    asked = given.parse_args(words)
    if asked.out is None and not asked.page:
        given.error("--out is missing: name a folder for what is simulated, or take --page")
    if asked.page and not asked.table.exists():
        given.error(f"there is no table {asked.table}: measure with --out, or name another with --table")
    try:
        if asked.page:
            report.write(table.read(asked.table), asked.table)
            return
        numbers = {name: getattr(asked, name) for name in ("evaluations", *NUMBERS)}
        runs = [
            (RunKey(hand, target, seed), design_of(hand, **numbers))
            for seed in asked.seeds
            for hand, target in asked.scenes
        ]
        measure_missing(runs, asked.out, asked.table)
    except QdgraspError as error:
        given.error(str(error))
    except KeyboardInterrupt:
        sys.exit("Stopped; the same command goes on.")


if __name__ == "__main__":
    main()
