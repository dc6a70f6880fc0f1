"""What docs/bus.md says of each figure is what stands in the source."""

import re
from pathlib import Path

import pytest
from msgspec import Struct

from qdgrasp_coordinator.counts.curve import Curve
from qdgrasp_coordinator.counts.entry import RunEntries, RunEntry
from qdgrasp_coordinator.counts.events import Event, Events
from qdgrasp_coordinator.counts.figures import Figures, JobFigures, JobMeta
from qdgrasp_coordinator.counts.finds import COLUMNS
from qdgrasp_coordinator.counts.meanings import meanings
from qdgrasp_coordinator.counts.team import TeamFigures, WorkerFigures
from qdgrasp_coordinator.counts.totals import Totals
from qdgrasp_protocol.messages import Finds
from qdgrasp_protocol.sign import Sign

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "bus.md").read_text()
SHOWN = (
    *(Totals, JobFigures, RunEntry, Figures, TeamFigures, WorkerFigures, JobMeta),
    *(Event, Events, Curve, RunEntries, Finds, Sign),
)


def own(kind: type[Struct]) -> list[str]:
    """The fields that a struct does not have from another one."""
    inherited = getattr(kind.__base__, "__struct_fields__", ())
    return [name for name in kind.__struct_fields__ if name not in inherited]


@pytest.mark.parametrize("kind", SHOWN)
def test_the_page_says_of_each_figure_what_the_source_does(kind: type[Struct]) -> None:
    section = PAGE.partition(f"### `{kind.__name__}`\n")[2].partition("\n###")[0]
    described = dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", section, re.MULTILINE))
    assert described == {name: meanings(kind)[name] for name in own(kind)}


def test_the_page_has_no_other_figures() -> None:
    assert set(re.findall(r"^### `(\w+)`$", PAGE, re.MULTILINE)) == {kind.__name__ for kind in SHOWN}


def test_the_page_names_every_column_of_finds() -> None:
    described = re.findall(r"^- `(\w+)`, (\S+) x (\w+): (.*)$", PAGE, re.MULTILINE)
    assert described == [(one.name, one.item, one.width, one.meaning) for one in COLUMNS]
