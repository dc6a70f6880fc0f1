"""Measures costs on this machine: `make bench`, or `python -m benchmarks --help`.

All figures are CPU time unless they say otherwise. Things that are compared are measured in turns in
this one process: read figures as ratios. Intervals are quartiles over the rounds.
"""

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks import coordination, evaluation_speed, figure, measure, memory, single_run, startup
from benchmarks.measure import Figure, machine, spread
from rich.console import Console

from qdgrasp_worker.platform import code_digest

Part = Callable[[float], Iterable[Figure]]
"""Takes the seconds for each line."""
PARTS: dict[str, Part] = {
    "evaluations": evaluation_speed.measure_evaluations,
    "processes": evaluation_speed.measure_scaling,
    "coverage": single_run.measure_growth,
    "coordinator": coordination.measure_coordination,
    "recorder": coordination.measure_recording,
    "start-up": startup.measure,
    "memory": memory.measure,
}


def whole(found: dict[str, list[Figure]]) -> dict[str, Any]:
    """All figures as plain values."""
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": machine(),
        "code": code_digest(),
        "parts": {name: [figure.as_dict() for figure in figures] for name, figures in found.items()},
    }


def shown(name: str, part: Iterable[Figure], console: Console) -> list[Figure]:
    """Measure the figures of a part, and print progress."""
    found = []
    with console.status(name) as status:
        for figure in part:
            found.append(figure)
            status.update(f"{name}: {figure.name} {spread(figure.rates or [figure.per_second])} a second")
    return found


def write(out: Path, found: dict[str, list[Figure]]) -> None:
    """Write the figures so far: as JSON, as a page, and as a picture."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "bench.json").write_text(json.dumps(whole(found), indent=1) + "\n")
    sections = [measure.markdown(name, figures) for name, figures in found.items()]
    (out / "bench.md").write_text("\n\n".join(["# Measured costs", *sections]) + "\n")
    if "evaluations" in found:
        figure.draw(found["evaluations"]).write(out / figure.NAME)


def seconds(text: str) -> float:
    """The time for a line [s] that an argument says."""
    value = float(text)
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"must be greater than 0 and finite, got {text}")
    return value


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--only", action="append", choices=list(PARTS), help="a part; may be repeated")
    parser.add_argument("--seconds", type=seconds, default=2.0, help="for each line (default: 2)")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    parser.add_argument("--out", type=Path, help="folder for bench.json, bench.md and the figure")
    asked = parser.parse_args()
    console, found = Console(stderr=True, width=150, quiet=asked.json), {}
    for name in asked.only or PARTS:
        began = time.monotonic()
        found[name] = shown(name, PARTS[name](asked.seconds), console)
        console.print(measure.table(name, found[name]))
        console.print(f"{time.monotonic() - began:.0f} s\n", style="dim")
        if asked.out:
            write(asked.out, found)
    if asked.json:
        sys.stdout.write(json.dumps(whole(found), indent=1) + "\n")


if __name__ == "__main__":
    main()
