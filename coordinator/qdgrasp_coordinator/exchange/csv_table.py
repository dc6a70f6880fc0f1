"""CSV: the same table as Parquet, as text; lines that begin with # say what the file is."""

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.exchange.about import About
from qdgrasp_coordinator.exchange.columns import columns
from qdgrasp_coordinator.exchange.decimals import shortest
from qdgrasp_coordinator.exchange.grasps import Grasps


def write(path: Path, grasps: Grasps, about: About) -> None:
    """Write grasps as CSV in UTF-8, lines ended by a newline."""
    table = list(columns(grasps, about.frame))
    with path.open("w", encoding="utf-8", newline="") as file:
        file.writelines(f"# {line}\n" for said in _said(about) for line in said.splitlines())
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(column.name for column in table)
        writer.writerows(zip(*(_words(column.values) for column in table), strict=True))


def _said(about: About) -> Iterator[str]:
    """What the file says of itself: texts, the lines of each spec on lines of their own."""
    for name, value in about.values.items():
        if name != "runs":
            words = " ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
            yield f"{name}: {words}"
    for run in about.runs:
        yield f"run: {run.run}"
        yield f"  digest: {run.digest}"
        yield from (f"  {line}" for line in run.spec.splitlines())


def _words(values: NDArray[np.generic]) -> list[str]:
    """Values (n,) as text; NaN is empty."""
    if values.dtype.kind != "f":
        return [str(value) for value in values.tolist()]
    return [word if word != "nan" else "" for word in shortest(values)]  # type: ignore[arg-type]
