"""What things cost on this machine: `make bench`, or `python -m tests.benchmarks [--json] [--seconds S]`.

All figures are CPU time unless they say otherwise, measured one after the other in this one process: read
them as ratios to the first line and to each other.
"""

import argparse
import json
import sys

from rich.console import Console
from rich.table import Table
from tests.benchmarks import coordination, evaluations, recording
from tests.benchmarks.measure import Figure, machine


def table(figures: list[Figure]) -> Table:
    shown = Table("what", "per second", "one takes", "x first line", "remark", title="qdgrasp bench")
    for figure in figures:
        rate, ratio = f"{figure.per_second:,.0f}", f"{figure.per_second / figures[0].per_second:.3g}"
        shown.add_row(figure.name, rate, f"{figure.microseconds:,.1f} us", ratio, figure.remark)
    return shown


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    parser.add_argument("--seconds", type=float, default=6.0, help="CPU seconds for each line")
    asked = parser.parse_args()
    figures: list[Figure] = []
    for part in (evaluations, coordination, recording):
        figures += part.measure(asked.seconds)
    if not asked.json:
        Console(stderr=True, width=140).print(table(figures))
    values = {"machine": machine(), "figures": [figure.as_dict() for figure in figures]}
    sys.stdout.write(json.dumps(values, indent=None if asked.json else 1) + "\n")


if __name__ == "__main__":
    main()
