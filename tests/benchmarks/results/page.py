"""The page of results, `docs/results/index.md`, made of the table and of nothing else."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from tests.benchmarks.results.arms import arms
from tests.benchmarks.results.coverage_part import coverage_part
from tests.benchmarks.results.cpu_part import cpu_part
from tests.benchmarks.results.duel_part import duel_part
from tests.benchmarks.results.programme import Programme
from tests.benchmarks.results.row import Key, Row

from qdgrasp_coordinator.analysis.page import markdown

INTRODUCTION = """# Results that accumulate

Made by `make results-page` from [runs.csv](runs.csv), which has a line for each finished run
([its columns](../results.md#the-table-of-runs)). The runs are those that the campaigns in
[deploy/results](../../deploy/results) ask for; `make results` carries out what is missing, cheapest first.
"""


def page(known: Programme, table: Mapping[Key, Row]) -> str:
    """The whole page."""
    here = arms(known, table)
    parts = [INTRODUCTION, _standing(known, table), coverage_part(here), duel_part(here), cpu_part(here)]
    return "\n".join(part.rstrip("\n") + "\n" for part in parts)


def _standing(known: Programme, table: Mapping[Key, Row]) -> str:
    """Which runs are in, and of which code."""
    wanted = known.wanted
    here = [table[one] for one in wanted if one in table]
    others = len(table) - len(here)
    besides = f" {others} more rows of the table are of runs that it does not ask for." if others else ""
    return (
        f"{len(here)} of the {len(wanted)} runs of the programme are in.{besides}\n\n"
        + markdown(("campaign", "runs", "in", "missing"), list(_campaigns(known, table)))
        + "\n"
        + markdown(("evaluation code", "version", "rows"), list(_codes(here)))
    )


def _campaigns(known: Programme, table: Mapping[Key, Row]) -> Iterator[tuple[str, ...]]:
    for name, runs in known.campaigns.items():
        here = sum(one.key in table for one in runs)
        link = f"[{name}](../../deploy/results/{name}.toml)"
        yield link, str(len(runs)), str(here), str(len(runs) - here)


def _codes(here: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    for (code, version), rows in Counter((row.code, row.version) for row in here).most_common():
        yield f"`{code}`", version, str(rows)
