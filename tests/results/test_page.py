"""The page of results: what the table says, and nothing that it does not."""

import re
from pathlib import Path
from typing import Any

import pytest
from tests.benchmarks.results import table as tables
from tests.benchmarks.results.arms import arms
from tests.benchmarks.results.coverage_part import coverage_part
from tests.benchmarks.results.cpu_part import cpu_part
from tests.benchmarks.results.duel_part import duel_part
from tests.benchmarks.results.page import page
from tests.benchmarks.results.programme import Programme, Wanted, programme
from tests.benchmarks.results.row import Row
from tests.results import make_rows
from tests.results.make_rows import BEFORE, TODAY

from qdgrasp_protocol.spec import RunSpec

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"
CUBE = {"gripper": "ref_panda_2f", "object": "ycb_rubiks_cube", "protocol": "released", "overlaps": "redraw"}


def row(method: str = "aimed", seed: int = 0, **values: Any) -> Row:
    """A finished run of the default method or another, with that method's own settings."""
    settings = "population=50" if method == "aimed" else ""
    return make_rows.row(method, seed, **{"settings": settings, **values})


def of(*rows: Row, absent: tuple[Row, ...] = ()) -> tuple[Programme, dict]:
    """A programme of these runs, and a table of the first ones."""
    runs = tuple(Wanted("run", _spec(one)) for one in (*rows, *absent))
    return Programme({"some": runs}), {one.key: one for one in rows}


def _spec(one: Row) -> RunSpec:
    named = {
        name: getattr(one, name) for name in ("gripper", "object", "protocol", "method", "overlaps", "seed")
    }
    settings = {"population": int(one.settings.removeprefix("population="))} if one.settings else {}
    return RunSpec(**named, **settings, evaluations=one.budget)


def cells(text: str, first: str) -> list[str]:
    """The cells of the line of a table that begins with `first`."""
    (line,) = [line for line in text.splitlines() if line.startswith(f"| {first} |")]
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_the_page_that_lies_beside_the_table_is_the_one_it_makes() -> None:
    whole = tables.read(RESULTS / "runs.csv")
    assert (RESULTS / "index.md").read_text(encoding="utf-8") == page(programme(), whole)


def test_a_page_of_nothing_says_that_everything_is_missing() -> None:
    known, _ = of(row(), row("me_scs"))
    text = page(known, {})
    assert "0 of the 2 runs of the programme are in" in text
    assert "1 of 1 comparisons are not in yet" in text


def test_a_row_that_nobody_asks_for_is_counted_apart() -> None:
    known, whole = of(row())
    other = row("me_scs")
    assert "1 more rows of the table are of runs that it does not ask for" in page(
        known, whole | {other.key: other}
    )


class TestCoverage:
    found = tuple(
        row(seed=seed, budget=10_000, coverage_5k=0.6, coverage_10k=end, coverage=end, **CUBE)
        for seed, end in enumerate((0.84, 0.86, 0.80))
    )

    def text(self, *rows: Row, absent: tuple[Row, ...] = ()) -> str:
        return coverage_part(arms(*of(*rows, absent=absent)))

    def test_it_has_median_range_and_what_is_aimed_at(self) -> None:
        line = cells(self.text(*self.found), "ref_panda_2f")
        assert "84.0 (80.0 to 86.0)" in line
        assert line[-2] == "50 at 5,000: met, 85 at 10,000: **short**"

    def test_what_is_short_is_said_by_how_much(self) -> None:
        assert "1.0 points short of 85 % at 10,000" in self.text(*self.found)

    def test_runs_that_are_not_in_are_counted(self) -> None:
        text = self.text(*self.found[:1], absent=self.found[1:])
        assert "1 of 3" in cells(text, "ref_panda_2f")
        assert "2 of the 3 runs are not in yet" in text

    def test_without_a_run_no_aim_is_met_or_missed(self) -> None:
        text = self.text(absent=self.found)
        assert cells(text, "ref_panda_2f")[-2] == "50 at 5,000, 85 at 10,000"
        assert "short" not in text


class TestDuels:
    def text(self, ours: dict[int, float], theirs: dict[int, float], **figures: float) -> str:
        rows = [row(seed=seed, coverage=value, robust_coverage=0.3) for seed, value in ours.items()]
        rows += [row("me_scs", seed, coverage=value, robust_coverage=0.4) for seed, value in theirs.items()]
        return duel_part(arms(*of(*rows)))

    def test_differences_are_of_runs_with_one_seed(self) -> None:
        text = self.text({0: 0.2, 1: 0.3, 2: 0.9}, {0: 0.1, 1: 0.2})
        line = cells(text, "panda")
        assert line[3] == "2"
        assert line[5:7] == ["25.0 (20.0 to 30.0)", "15.0 (10.0 to 20.0)"]
        assert line[7:10] == ["+10.0", "+10.0 to +10.0", "win"]

    def test_an_interval_around_zero_is_nobodys_win(self) -> None:
        text = self.text({0: 0.2, 1: 0.2}, {0: 0.1, 1: 0.3})
        assert cells(text, "panda")[9] == "level"

    def test_one_seed_proves_nothing(self) -> None:
        assert cells(self.text({0: 0.2}, {0: 0.1}), "panda")[8:10] == ["", "one seed"]

    def test_losses_are_listed_in_every_figure(self) -> None:
        text = self.text({0: 0.1, 1: 0.1}, {0: 0.2, 1: 0.2})
        assert "losses 1. Behind nowhere in: mean best fitness; orientations; niches." in text
        assert "| coverage, or cells | panda | ycb_mug | `me_scs` 10.0 |  |" in text
        assert "| robust coverage | panda | ycb_mug | `me_scs` 10.0 |  |" in text

    def test_who_is_ahead_but_not_for_certain_stands_apart(self) -> None:
        text = self.text({0: 0.2, 1: 0.2}, {0: 0.1, 1: 0.4})
        assert "| coverage, or cells | panda | ycb_mug |  | `me_scs` 5.0 |" in text

    def test_where_there_is_no_set_cells_are_compared(self) -> None:
        rows = [row(seed=seed, cells=100) for seed in (0, 1)] + [
            row("me_scs", seed, cells=60) for seed in (0, 1)
        ]
        assert cells(duel_part(arms(*of(*rows))), "panda")[4:8] == [
            "cells",
            "100 (100 to 100)",
            "60 (60 to 60)",
            "+40",
        ]

    def test_several_objects_are_also_taken_together(self) -> None:
        rows = [
            row(method, seed, object=name, coverage=value)
            for method, value in (("aimed", 0.3), ("me_scs", 0.1))
            for name in ("ycb_mug", "ycb_bowl")
            for seed in (0, 1)
        ]
        assert "| panda | `me_scs` | 2 | coverage, % | +20.0 | +20.0 to +20.0 | win |" in duel_part(
            arms(*of(*rows))
        )

    def test_countings_are_kept_apart(self) -> None:
        rows = [row(coverage=0.2), row(coverage=0.5, overlaps="redraw"), row("me_scs", coverage=0.1)]
        headings = re.findall("^### .*", duel_part(arms(*of(*rows))), re.MULTILINE)
        assert headings == [
            "### 1,000 evaluations, every pose counted",
            "### 1,000 evaluations, every pose counted; default: overlaps redrawn",
        ]

    def test_two_evaluation_codes_are_marked(self) -> None:
        rows = [row(coverage=0.2, code=TODAY), row("me_scs", coverage=0.1, code=BEFORE)]
        text = duel_part(arms(*of(*rows)))
        assert cells(text, "panda")[-1] == f"`{TODAY[:6]}` / `{BEFORE[:6]}`"
        assert "Of two evaluation codes: 1 of 1" in text

    def test_one_evaluation_code_is_not(self) -> None:
        text = self.text({0: 0.2}, {0: 0.1})
        assert cells(text, "panda")[-1] == f"`{TODAY[:6]}`"
        assert "Of two evaluation codes" not in text

    def test_the_default_with_other_settings_is_another_method(self) -> None:
        rows = [row(coverage=0.3), row(coverage=0.2, settings="population=70"), row("me_scs", coverage=0.1)]
        text = duel_part(arms(*of(*rows)))
        against = [line.split("|")[3].strip() for line in text.splitlines() if line.startswith("| panda")]
        assert against == ["`aimed` (population=70)", "`me_scs`"]
        assert coverage_part(arms(*of(row(settings="population=70", budget=10_000)))).count("| panda") == 0


BESIDE_THE_AUTHORS = {"object": "ycb_rubiks_cube", "budget": 10_000}


@pytest.mark.parametrize(
    ("other", "times"),
    [({}, "63.3"), ({"budget": 5000}, ""), ({"object": "ycb_mug"}, ""), ({"protocol": "released"}, "")],
)
def test_the_authors_rate_stands_beside_runs_like_theirs_alone(other: dict[str, Any], times: str) -> None:
    found = row(**BESIDE_THE_AUTHORS | other, coverage=0.5, coverage_per_cpu_second=0.05)
    assert cells(cpu_part(arms(*of(found))), "panda")[9] == times


def test_the_ceiling_is_a_new_cell_with_every_success() -> None:
    found = row(
        **BESIDE_THE_AUTHORS, set_size=1000, coverage=0.5, cpu_seconds=10.0, coverage_per_cpu_second=0.05,
        success_ms=10.0,
    )  # fmt: skip
    line = cells(cpu_part(arms(*of(found))), "panda")
    assert line[8:13] == ["5.000", f"{5 / 0.079:.1f}", "10.0", "10.00", "50"]


@pytest.mark.parametrize("figure", ["coverage", "cpu_seconds"])
def test_an_arm_without_a_run_has_no_number(figure: str) -> None:
    (arm,) = arms(*of(absent=(row(),)))
    assert arm.words(figure) == ""
