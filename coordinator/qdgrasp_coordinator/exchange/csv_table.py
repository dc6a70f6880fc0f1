"""CSV: the same table as Parquet, as text; lines that begin with # say what the file is."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.exchange.about import About
from qdgrasp_coordinator.exchange.columns import columns
from qdgrasp_coordinator.exchange.decimals import shortest
from qdgrasp_coordinator.exchange.grasps import Grasps

SPECIAL = frozenset('",#\r\n')
"""A word with one of these stands in quotes: a reader would take what is behind a bare # for a remark."""


def write(path: Path, grasps: Grasps, about: About) -> None:
    """Write grasps as CSV in UTF-8, lines ended by a newline."""
    table = list(columns(grasps, about.frame))
    with path.open("w", encoding="utf-8", newline="") as file:
        file.writelines(f"# {line}\n" for said in _said(about) for line in said.splitlines())
        file.write(_line(_field(column.name) for column in table))
        file.writelines(map(_line, zip(*(_fields(column.values) for column in table), strict=True)))


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


def _line(fields: Iterable[str]) -> str:
    return ",".join(fields) + "\n"


def _fields(values: NDArray[np.generic]) -> list[str]:
    """Values (n,) as they stand between commas; NaN is empty."""
    if values.dtype.kind == "f":
        numbers = shortest(values)  # type: ignore[arg-type]  # the kind says that they are floats
        return [word if word != "nan" else "" for word in numbers]
    return [_field(str(value)) for value in values.tolist()]


def _field(word: str) -> str:
    if SPECIAL.isdisjoint(word):
        return word
    return '"' + word.replace('"', '""') + '"'
