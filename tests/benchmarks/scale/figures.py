"""What was found, beside what is wanted."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rich.table import Table
from tests.benchmarks.measure import number


@dataclass(frozen=True)
class Figure:
    """One number."""

    name: str
    value: float
    unit: str
    least: float | None = None
    most: float | None = None
    remark: str = ""

    @property
    def is_met(self) -> bool | None:
        """Whether it is within what is wanted; None: nothing is."""
        if self.least is None and self.most is None:
            return None
        return (self.least or -float("inf")) <= self.value <= (self.most or float("inf"))

    @property
    def wanted(self) -> str:
        if self.least is not None:
            return f"at least {number(self.least)}"
        return "" if self.most is None else f"at most {number(self.most)}"

    def as_dict(self) -> dict[str, Any]:
        return {**vars(self), "is_met": self.is_met}


def table(name: str, figures: Sequence[Figure]) -> Table:
    """A part for a terminal."""
    shown = Table("what", "figure", "wanted", "", "remark", title=name, title_justify="left")
    for figure in figures:
        met = {None: "", True: "yes", False: "NO"}[figure.is_met]
        shown.add_row(figure.name, f"{number(figure.value)} {figure.unit}", figure.wanted, met, figure.remark)
    return shown
