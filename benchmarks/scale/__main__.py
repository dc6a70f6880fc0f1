"""Measures the limits of a coordinator: `make scale`, `python -m benchmarks.scale --help`.

Workers are stand-ins that answer at once with prepared results, except where real ones are named; router and
recorder are processes of their own. CPU times hold on a busy machine, rates and seconds only on a quiet one.
"""

import argparse
import json
import logging
import sys
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

from benchmarks.measure import machine
from benchmarks.scale import slow_clients, throughput
from benchmarks.scale.rig import ScaleFigure, table
from rich.console import Console

from qdgrasp_protocol.process import configure_logging

PARTS: dict[str, Callable[[float], Iterator[ScaleFigure]]] = {
    "asleep": throughput.measure_sleeping_workers,
    "dispatch": throughput.measure_dispatch,
    "recorded": throughput.measure_recorded,
    "searches": throughput.measure_searching,
    "sessions": throughput.measure_sessions,
    "stuck": slow_clients.measure_stuck_subscriber,
    "watched": slow_clients.measure_monitors,
    "pairs": throughput.measure_pairs,
}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scale", description=__doc__)
    parser.add_argument("--only", action="append", choices=list(PARTS), help="a part; may be repeated")
    parser.add_argument("--seconds", type=float, default=5.0, help="for each measurement (default: 5)")
    parser.add_argument("--out", type=Path, help="a JSON file for the figures")
    asked = parser.parse_args()
    configure_logging("scale", level=logging.WARNING)
    console, found = Console(stderr=True, width=150), {}
    for name in asked.only or PARTS:
        found[name] = list(PARTS[name](asked.seconds))
        console.print(table(name, found[name]))
    if asked.out:
        asked.out.parent.mkdir(parents=True, exist_ok=True)
        parts = {name: [figure.as_dict() for figure in figures] for name, figures in found.items()}
        date = datetime.now(UTC).isoformat(timespec="seconds")
        asked.out.write_text(
            json.dumps({"date": date, "machine": machine(), "parts": parts}, indent=1) + "\n"
        )
    return int(any(figure.is_met is False for figures in found.values() for figure in figures))


if __name__ == "__main__":
    sys.exit(main())
