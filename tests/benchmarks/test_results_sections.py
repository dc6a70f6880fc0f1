"""Sections of the page of results: the paper's claims, judged from the table, and reference sets."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.results import reference_sets
from benchmarks.results.comparison import Arm
from benchmarks.results.paper_claims import claims_part, numbers
from benchmarks.results.reference_sets import SceneSet, gather, read, sets_part
from benchmarks.results.table import Key, key
from msgspec.structs import replace
from tests.benchmarks.test_results_runs import record
from tests.benchmarks.test_results_table import TODAY, row
from tests.coordinator.recorded_runs import random_rows

from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.report.claims import ClaimAgreement
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import Outcome


def arm(method: str, *ends: float, **values: Any) -> Arm:
    """Runs of a method on the mug with these coverages in the end, by seed from 1 on."""
    rows = {
        seed: row(method, seed, **{"budget": 10_000, "coverage": end, "coverage_5k": end / 2, **values})
        for seed, end in enumerate(ends, start=1)
    }
    return Arm(rows[1].key._replace(seed=0), tuple(rows), rows)


def number(letter: str, *arms: Arm) -> Any:
    return next(one for one in numbers(arms) if one.claim.letter == letter)


FIVE = (0.50, 0.52, 0.49, 0.51, 0.50)


def test_a_ratio_is_of_coverage_after_as_many_evaluations() -> None:
    found = number("b", arm("contact_me_scs", *FIVE), arm("approach_me_scs", *(end / 2 for end in FIVE)))
    assert found.interval(10_000, 5).value == pytest.approx(2.0)
    assert found.verdict(10_000, 5) is ClaimAgreement.DOES_NOT


def test_a_verdict_is_stable_from_where_it_stays() -> None:
    late = arm("approach_me_scs", *FIVE, coverage_1k=0.1, coverage_2k=0.3, coverage_500=0.1, coverage_5k=0.3)
    ours = arm("contact_me_scs", *FIVE, coverage_1k=0.3, coverage_2k=0.3, coverage_500=0.1, coverage_5k=0.3)
    found = number("b", ours, late)
    assert found.verdict(500, 5) is ClaimAgreement.AGREES
    assert found.verdict(1000, 5) is ClaimAgreement.DOES_NOT
    assert found.stable_from() == (2000, 5)


def test_with_four_seeds_there_is_no_verdict() -> None:
    text = claims_part([arm("contact_me_scs", *FIVE[:4]), arm("approach_me_scs", *FIVE)])
    summary, line = (line.split(" | ") for line in text.splitlines() if line.startswith("| b |"))
    assert summary[3].startswith("**cannot be said** (0 of 1 number)")
    assert line[4] == "4"
    assert "few seeds" in line


def test_a_claim_agrees_when_all_its_numbers_do() -> None:
    ends = {"contact_me_scs": 1.0, "approach_me_scs": 1.2, "contact_rand": 0.3, "approach_rand": 1.1}
    text = claims_part([arm(name, *(end * value for value in FIVE)) for name, end in ends.items()])
    verdicts = dict(
        line.split(" | ")[::3] for line in text.splitlines() if line.startswith("| ") and "**" in line
    )
    assert verdicts | {"| d": ""} == {
        "| d": "",
        "| a": "**does not** (3 of 4 numbers) |",
        "| b": "**agrees** (1 of 1 number) |",
    }


def test_the_second_half_is_taken_where_half_of_the_budget_is_a_milestone() -> None:
    found = number("c", arm("antipodal_rand", *FIVE))
    assert found.interval(10_000, 5).value == pytest.approx(0.5)
    assert found.budgets == [1000, 2000, 10_000]
    assert not [*numbers([arm("antipodal_rand", *FIVE, budget=5000)])]


def test_nu_is_that_of_the_end() -> None:
    found = number("d", arm("contact_me_scs", *FIVE, near_nu=0.7))
    assert found.verdict(10_000, 5) is ClaimAgreement.AGREES


def test_longer_runs_make_a_number_of_their_own() -> None:
    long = arm("antipodal_rand", 0.6, 0.6, budget=100_000, coverage_50k=0.57)
    found = [one for one in numbers([arm("antipodal_rand", *FIVE), long]) if one.claim.letter == "c"]
    assert [(one.budgets[-1], one.seeds) for one in found] == [(10_000, 5), (100_000, 2)]
    assert found[1].interval(100_000, 2).value == pytest.approx(0.05)


def test_a_method_with_other_settings_says_nothing_of_it() -> None:
    other = arm("contact_me_scs", *FIVE, settings="population=50")
    assert not [one for one in numbers([other, arm("approach_me_scs", *FIVE)]) if one.claim.letter == "b"]
    assert "No runs of the claims' campaigns are in yet" in claims_part([])


SCENE = ("panda", "tennis_ball", "paper")


def runs(path: Path, *seeds: int, **settings: Any) -> dict[Key, RunFolder]:
    """Finished runs by their keys, each with rows of its own."""
    made = (
        record(
            path / f"{settings.get('method', 'run')}{seed}",
            random_rows(300, seed, reach=0.03),
            seed=seed,
            **settings,
        )
        for seed in seeds
    )
    return {key(folder.spec): folder for folder in made}


def rows_of(folders: dict[Key, RunFolder], code: str = TODAY) -> dict[Key, Any]:
    return {one: replace(row("any"), **one._asdict(), code=code) for one in folders}


def found_cells(folder: RunFolder) -> set[tuple[int, ...]]:
    with folder.journal() as journal:
        rows = journal.rows(0, journal.count)
    positions = rows[rows["outcome"] >= Outcome.DROPPED]["base_to_object"][:, :3]
    return set(map(tuple, cells(positions).tolist()))


def one_set(home: Path) -> SceneSet:
    (found,) = read(home)
    assert found.scene == SCENE
    return found


def test_a_set_has_the_cells_of_all_runs_with_a_row(tmp_path: Path) -> None:
    folders = runs(tmp_path, 1, 2, 3)
    known = rows_of(folders)
    last = sorted(known)[-1]
    without_row = known.pop(last)
    home = tmp_path / "sets"
    assert gather(home, folders, known)
    assert not gather(home, folders, known)
    expected = [found_cells(folder) for one, folder in sorted(folders.items())]
    assert set(map(tuple, one_set(home).found.cells.tolist())) == expected[0] | expected[1]

    assert gather(home, folders, known | {last: without_row})
    assert len(one_set(home).found) == len(set.union(*expected))
    assert [run.seed for run in one_set(home).runs] == [1, 2, 3]


def test_a_longer_run_takes_the_place_of_the_shorter(tmp_path: Path) -> None:
    short = record(tmp_path / "short", random_rows(200, 1), evaluations=200)
    long = record(tmp_path / "long", random_rows(300, 1), evaluations=300)
    for folder in (short, long):
        folders = {key(folder.spec): folder}
        gather(tmp_path / "sets", folders, rows_of(folders))
    assert [run.budget for run in one_set(tmp_path / "sets").runs] == [300]


def test_runs_of_other_code_begin_a_set_anew(tmp_path: Path) -> None:
    home, (old, new) = tmp_path / "sets", (runs(tmp_path, 1), runs(tmp_path, 2))
    gather(home, old, rows_of(old, "b" * 16))
    gather(home, new, rows_of(new))
    assert [(run.seed, run.code) for run in one_set(home).runs] == [(2, TODAY)]
    (folder,) = new.values()
    assert len(one_set(home).found) == len(found_cells(folder))


def test_coverage_is_of_the_cells_that_another_run_found(tmp_path: Path) -> None:
    folders = runs(tmp_path, 1, 2) | runs(tmp_path, 1, method="contact_rand", population=500)
    gather(tmp_path / "sets", folders, rows_of(folders))
    found = {(one.method, one.seed): found_cells(folder) for one, folder in folders.items()}
    coverage = one_set(tmp_path / "sets").coverage
    others = found["me_rand", 1] | found["me_rand", 2]
    assert coverage["`contact_rand`"] == pytest.approx([len(found["contact_rand", 1] & others) / len(others)])
    assert len(coverage["`me_rand` (population=10)"]) == 2


def test_under_physical_it_is_of_cells_that_hold(tmp_path: Path) -> None:
    folders = runs(tmp_path, 1, 2)
    gather(tmp_path / "sets", folders, rows_of(folders))
    of_touch = one_set(tmp_path / "sets")
    of_hold = SceneSet(("panda", "tennis_ball", "physical in mujoco"), of_touch.found, of_touch.runs)
    assert (of_touch.estimate.seen, of_hold.estimate.seen) == (
        len(of_touch.found),
        len(of_touch.found.robust),
    )
    (one,), (other,) = (each.coverage.values() for each in (of_touch, of_hold))
    assert not np.array_equal(one, other)


def test_the_section_names_the_best_method_of_each_scene(tmp_path: Path) -> None:
    folders = runs(tmp_path, 1, 2) | runs(tmp_path, 3, 4, method="contact_rand", population=500)
    gather(tmp_path / "sets", folders, rows_of(folders))
    found = one_set(tmp_path / "sets")
    sizes, coverage = (line for line in sets_part([found]).splitlines() if line.startswith("| panda |"))
    assert f"| 4 | {len(found.found)} | {found.found.estimate.total:.0f} (" in sizes
    best = max(np.median(shares) for shares in found.coverage.values())
    assert f"| **{100 * best:.1f} (" in coverage
    assert coverage.count("**") == 2
    assert sets_part([]) == ""


def test_a_damaged_list_of_runs_is_named_with_its_line(tmp_path: Path) -> None:
    folders = runs(tmp_path, 1)
    gather(tmp_path / "sets", folders, rows_of(folders))
    file = tmp_path / "sets" / reference_sets.RUNS
    file.write_text(file.read_text().replace(",1,300,", ",one,300,"))
    with pytest.raises(InputError, match=r"runs\.csv, line 2: .*restore the line"):
        read(tmp_path / "sets")
