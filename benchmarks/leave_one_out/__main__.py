"""Constants of the default search refitted without one object: `python -m benchmarks.leave_one_out --help`.

Each finished run is a line of `leave-one-out.csv` in the folder that `--out` names, and is not carried out
again: a stop costs at most one run a process. The page beside it says what is varied, how it is chosen, and
the results.
"""

import argparse
from pathlib import Path

from benchmarks.leave_one_out.page import page
from benchmarks.leave_one_out.refit import refits
from benchmarks.leave_one_out.runs import (
    EVALUATIONS,
    HELD_OUT,
    HELD_OUT_SEEDS,
    Key,
    code_digest,
    held_out_runs,
    read,
    run_missing,
    tuning_runs,
)
from benchmarks.results.programme import TUNING
from benchmarks.results.table import locked

from qdgrasp_coordinator.storage import atomic_files
from qdgrasp_protocol.errors import QdgraspError
from qdgrasp_tools.cli.options import cores

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"
TABLE, PAGE = "leave-one-out.csv", "leave-one-out.md"


def measure(asked: argparse.Namespace) -> None:
    """Carry out what is missing, unless the page alone is asked for, and make the page, stopped or not."""
    file, current = asked.out / TABLE, {code_digest(), *asked.accept}

    def chosen(runs: list[Key]) -> list[Key]:
        return [key for key in runs if key.scene in asked.scenes and key.seed in asked.seeds]

    with locked(file):
        try:
            if not asked.page:
                run_missing(file, chosen(tuning_runs(asked.evaluations)), current, asked.processes)
                sets = [one.variant for one in refits(read(file), asked.evaluations).values()]
                run_missing(file, chosen(held_out_runs(sets, asked.evaluations)), current, asked.processes)
        finally:
            atomic_files.replace(asked.out / PAGE, page(read(file), asked.evaluations).encode())


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.leave_one_out", description=__doc__)
    objects = (*TUNING, *HELD_OUT)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the table and its page")
    parser.add_argument("--page", action="store_true", help="make the page of the table, and run nothing")
    parser.add_argument("--scenes", nargs="+", choices=objects, default=objects, help="objects to run")
    parser.add_argument("--seeds", nargs="+", type=int, default=HELD_OUT_SEEDS, help="seeds to run")
    parser.add_argument("--evaluations", type=int, default=EVALUATIONS, help="budget of each run")
    parser.add_argument("--processes", type=int, default=cores(), help="runs at once; default: a core each")
    parser.add_argument(
        "--accept", nargs="+", default=(), help="digests of older code that gives the same runs"
    )
    try:
        measure(parser.parse_args())
    except QdgraspError as error:
        parser.error(str(error))
    except KeyboardInterrupt:
        parser.exit(130, "Stopped; the same command goes on.\n")


if __name__ == "__main__":
    main()
