"""What things cost on this machine: `make bench`, or `python -m tests.benchmarks --help`.

All figures are CPU time unless they say otherwise. What is compared was measured in turns in this one
process: read figures as ratios. Intervals are quartiles over the rounds.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from tests.benchmarks import coordination, evaluations, growth, recording, scaling, startup, where
from tests.benchmarks.measure import Figure, machine, spread, taken

from qdgrasp_worker.platform import code_digest

Part = Callable[[float], list[Figure]]
"""Takes the seconds for each line."""
PARTS: dict[str, Part] = {
    "evaluations": evaluations.measure,
    "processes": scaling.measure,
    "coverage": growth.measure,
    "coordinator": coordination.measure,
    "recorder": recording.measure,
    "start-up": startup.measure,
}


def table(name: str, figures: Sequence[Figure]) -> Table:
    """One part for a person."""
    has_naive = any(figure.naive for figure in figures)
    heads = ["what", "per second", "one takes", "x naive" if has_naive else "x first line", "remark"]
    shown = Table(*heads, title=name, title_justify="left")
    for figure in figures:
        rate = spread(figure.rates or [figure.per_second])
        times = spread(figure.naive, 2) if has_naive else spread(figure.ratios(figures[0]), 2)
        shown.add_row(figure.name, rate, taken(figure.microseconds), times, figure.remark)
    return shown


def measured(parts: Sequence[str], seconds: float, console: Console) -> dict[str, list[Figure]]:
    """The figures of parts, each shown as soon as it is there."""
    found = {}
    for name in parts:
        began = time.monotonic()
        found[name] = PARTS[name](seconds)
        console.print(table(name, found[name]))
        console.print(f"{time.monotonic() - began:.0f} s\n", style="dim")
    return found


def whole(found: dict[str, list[Figure]]) -> dict[str, Any]:
    """Everything as plain values."""
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": machine(),
        "code": code_digest(),
        "parts": {name: [figure.as_dict() for figure in figures] for name, figures in found.items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    parser.add_argument("--only", action="append", choices=list(PARTS), help="a part; may be repeated")
    parser.add_argument("--seconds", type=float, default=2.0, help="for each line (default: 2)")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    parser.add_argument("--out", type=Path, help="folder for bench.json and the figure")
    asked = parser.parse_args()
    console = Console(stderr=True, width=150, quiet=asked.json)
    found = measured(asked.only or list(PARTS), asked.seconds, console)
    text = json.dumps(whole(found), indent=1) + "\n"
    if asked.json:
        sys.stdout.write(text)
    if asked.out:
        asked.out.mkdir(parents=True, exist_ok=True)
        (asked.out / "bench.json").write_text(text)
        if "evaluations" in found:
            where.draw(found["evaluations"]).write(asked.out / where.NAME)


if __name__ == "__main__":
    main()
