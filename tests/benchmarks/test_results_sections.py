"""Sections of the page of results: the paper's claims, judged from the table, and reference sets."""

import dataclasses
from collections import Counter
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.results import reference_sets
from benchmarks.results.comparison import Arm
from benchmarks.results.measure import rows_digest
from benchmarks.results.paper_claims import claims_part, numbers, sigma_part
from benchmarks.results.paper_figures import draw, figure_panels
from benchmarks.results.reference_sets import SceneSet, gather, read, sets_part
from benchmarks.results.table import Key, key
from msgspec.structs import replace
from tests.benchmarks.test_results_runs import record
from tests.benchmarks.test_results_table import TODAY, row
from tests.coordinator.recorded_runs import random_rows

from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.report.claims import ClaimAgreement


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
    assert summary[3].startswith("**cannot be said** (0 of 3)")
    assert line[4] == "4"
    assert "few seeds" in line


def test_an_object_with_few_seeds_takes_no_verdict_from_the_others() -> None:
    few = [arm(name, *FIVE[:3], object="ycb_banana") for name in ("contact_me_scs", "approach_me_scs")]
    whole = [arm("contact_me_scs", *FIVE), arm("approach_me_scs", *FIVE)]
    found, alone = number("b", *few, *whole), number("b", *few)
    assert (found.objects, found.seeds, alone.objects, alone.seeds) == (1, 5, 1, 3)
    assert found.verdict(10_000, 5) is ClaimAgreement.AGREES


def test_numbers_that_only_stand_beside_have_a_line_and_no_verdict() -> None:
    text = claims_part([arm("contact_rand", *FIVE, near_nu=0.5)])
    assert "| d | `contact_rand` | panda | 1 | 5 | 10,000 | 0.5 |" in text


def test_the_values_of_single_objects_stand_beside_the_number() -> None:
    other = [
        arm("contact_me_scs", *FIVE, object="ycb_bowl"),
        arm("approach_me_scs", *FIVE, object="ycb_bowl"),
    ]
    whole = [arm("contact_me_scs", *FIVE), arm("approach_me_scs", *(end / 2 for end in FIVE))]
    assert number("b", *other, *whole).of_single_objects(10_000, 5) == pytest.approx([1.0, 2.0])
    text = claims_part([*other, *whole])
    assert " | 1 to 2 | " in next(line for line in text.splitlines() if line.startswith("| b | `contact_me"))
    assert "| panda | ycb_bowl | 10,000 | `contact_me_scs` | 5 | 50.00 (49.00 to 52.00) |" in text


def test_the_papers_figures_are_means_over_the_objects_that_all_methods_have() -> None:
    half = {"budget": 5000, "coverage_500": 0.1, "coverage_1k": 0.2, "coverage_2k": 0.3}
    arms = [
        arm("contact_me_scs", 0.4, 0.6, 0.5, **half),
        arm("contact_rand", 0.2, **half),
        arm("contact_me_scs", 0.7, object="ycb_bowl", **half),
        arm("contact_rand", 0.4, object="ycb_bowl", **half),
        arm("contact_me_scs", 0.9, object="ycb_banana", **half),
        arm("approach_me_scs", 0.9, object="ycb_banana", **half),
    ]
    sigma = [arm("me_scs", 0.4, 0.6), arm("me_scs", 0.8, 0.9, settings="mutation_sigma=0.2")]
    first, second, third = (
        figure_panels(arms[:4], sigma[:0]),
        figure_panels(arms, []),
        figure_panels([], sigma),
    )
    (one,) = first
    assert (one.heading, one.words) == ("Figure 1, panda", "mug and bowl, 1 to 3 seeds")
    assert one.lines["contact_me_scs"] == (
        [0, 500, 1000, 2000, 5000],
        pytest.approx([0.0, 0.1, 0.2, 0.3, 0.6]),
    )
    assert [panel.heading for panel in second] == ["Figure 1, panda"]  # no object has all of Figure 2
    (two,) = third
    assert two.lines == {"me_scs": ([0.1, 0.2], pytest.approx([0.5, 0.85]))}
    assert draw([], []) is None


def test_a_claim_agrees_when_all_its_numbers_are_in_and_do() -> None:
    ends = {"contact_me_scs": 1.0, "contact_rand": 0.3, "approach_rand": 0.4}

    def verdict(hand: str, **more: float) -> str:
        found = [
            arm(name, *(end * value for value in FIVE), gripper=hand) for name, end in (ends | more).items()
        ]
        (line,) = (line for line in claims_part(found).splitlines() if line.startswith("| a | ME"))
        return line.split(" | ")[3].removesuffix(" |")

    assert verdict("allegro") == "**agrees** (2 of 2)"
    assert verdict("panda") == "**cannot be said** (2 of 3)"
    assert verdict("panda", antipodal_rand=0.5) == "**agrees** (3 of 3)"
    assert verdict("panda", antipodal_rand=1.1) == "**does not** (2 of 3)"


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


def test_sigma_has_a_line_for_each_method_with_the_best_value_standing_out() -> None:
    usual = arm("contact_me_scs", 0.4, 0.6, 0.5)
    other = arm("contact_me_scs", 0.8, 0.7, 0.9, settings="mutation_sigma=0.02")
    (line,) = (line for line in sigma_part([usual, other]).splitlines() if "`contact_me_scs`" in line)
    assert line.split(" | ")[3:] == ["6", "**80.00 (70.00 to 90.00)**", "50.00 (40.00 to 60.00)", "62 |"]
    assert not sigma_part([])


SCENE = ("panda", "tennis_ball", "paper")


def runs(path: Path, *seeds: int, **settings: Any) -> dict[Key, RunFolder]:
    """Finished runs by their keys, each with rows of its own."""
    name = settings.get("method", "run")
    made = (
        record(path / f"{name}{seed}", random_rows(300, seed, reach=0.03), seed=seed, **settings)
        for seed in seeds
    )
    return {key(folder.spec): folder for folder in made}


def rows_of(folders: dict[Key, RunFolder], code: str = TODAY) -> dict[Key, Any]:
    """A row of each run, with the digest of its journal."""
    found = {}
    for one, folder in folders.items():
        with folder.journal() as journal:
            digest = rows_digest(journal.rows(0, journal.count))
        found[one] = replace(row("any"), **one._asdict(), code=code, journal=digest)
    return found


def gathered(home: Path, folders: dict[Key, RunFolder], known: dict[Key, Any] | None = None) -> bool:
    return gather(home, folders, rows_of(folders) if known is None else known, [TODAY])


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
    folders, home = runs(tmp_path, 1, 2, 3), tmp_path / "sets"
    known = rows_of(folders)
    last = sorted(known)[-1]
    without_row = known.pop(last)
    assert gathered(home, folders, known)
    assert not gathered(home, folders, known)
    expected = [found_cells(folder) for one, folder in sorted(folders.items())]
    assert set(map(tuple, one_set(home).found.cells.tolist())) == expected[0] | expected[1]

    assert gathered(home, folders, known | {last: without_row})
    assert len(one_set(home).found) == len(set.union(*expected))
    assert [run.key.seed for run in one_set(home).runs] == [1, 2, 3]


@pytest.mark.parametrize("first", [0, 1], ids=["short first", "long first"])
def test_of_a_run_and_a_longer_one_the_longer_counts(tmp_path: Path, first: int) -> None:
    rows = random_rows(300, 1, reach=0.03)
    known = [record(tmp_path / f"run{n}", rows[:n], evaluations=n) for n in (200, 300)]
    for folder in (known[first], known[1 - first]):
        gathered(tmp_path / "sets", {key(folder.spec): folder})
    assert [run.key.budget for run in one_set(tmp_path / "sets").runs] == [300]
    assert len(one_set(tmp_path / "sets").found) == len(found_cells(known[1]))


def test_runs_of_code_that_is_not_current_begin_a_set_anew(tmp_path: Path) -> None:
    home, (old, new) = tmp_path / "sets", (runs(tmp_path, 1), runs(tmp_path, 2))
    gather(home, old, rows_of(old, "b" * 16), ["b" * 16])
    gathered(home, new)
    assert [(run.key.seed, run.code) for run in one_set(home).runs] == [(2, TODAY)]
    (folder,) = new.values()
    assert len(one_set(home).found) == len(found_cells(folder))


def test_a_folder_that_is_not_the_one_of_its_row_is_left_out(tmp_path: Path) -> None:
    folders = runs(tmp_path, 1)
    (known,) = rows_of(folders).values()
    assert not gathered(tmp_path / "sets", folders, {known.key: replace(known, journal="f" * 16)})
    assert read(tmp_path / "sets") == []


def test_a_scene_without_a_success_has_no_set_yet(tmp_path: Path) -> None:
    rows = random_rows(300)
    rows["outcome"], rows["fitness"] = Outcome.MISSED, 0
    nothing = {key(folder.spec): folder for folder in [record(tmp_path / "nothing", rows, seed=9)]}
    known = {one: replace(found, successes=0) for one, found in rows_of(nothing).items()}
    assert not gathered(tmp_path / "sets", nothing, known)
    some = runs(tmp_path, 1)
    assert gathered(tmp_path / "sets", nothing | some, known | rows_of(some))
    assert [run.key.seed for run in one_set(tmp_path / "sets").runs] == [1, 9]


def test_coverage_is_by_each_run_by_all_of_a_method_and_by_it_alone(tmp_path: Path) -> None:
    folders = runs(tmp_path, 1, 2) | runs(tmp_path, 3, method="contact_rand", population=500)
    gathered(tmp_path / "sets", folders)
    found = {one.seed: found_cells(folder) for one, folder in folders.items()}
    whole = len(set.union(*found.values()))
    other, mine = one_set(tmp_path / "sets").coverage
    assert (other.method, mine.method, mine.budget) == ("`contact_rand`", "`me_rand` (population=10)", 300)
    assert mine.by_run.tolist() == pytest.approx([len(found[seed]) / whole for seed in (1, 2)])
    assert mine.together == pytest.approx(len(found[1] | found[2]) / whole)
    assert mine.alone == pytest.approx(len((found[1] | found[2]) - found[3]) / whole)
    assert 0 < other.alone == pytest.approx(1 - mine.together)


def test_under_physical_it_is_of_cells_that_hold(tmp_path: Path) -> None:
    gathered(tmp_path / "sets", runs(tmp_path, 1, 2))
    of_touch = one_set(tmp_path / "sets")
    of_hold = SceneSet(("panda", "tennis_ball", "physical in mujoco"), of_touch.found, of_touch.runs)
    assert (len(of_touch.counted), len(of_hold.counted)) == (len(of_touch.found), len(of_touch.found.robust))
    (one,), (other,) = of_touch.coverage, of_hold.coverage
    assert not np.array_equal(one.by_run, other.by_run)


def test_the_section_has_a_line_for_each_set_and_for_each_method_on_it(tmp_path: Path) -> None:
    folders = runs(tmp_path, 1, 2, 3, 4, 5) | runs(tmp_path, 1, 2, 3, 4, 5, method="contact_rand")
    gathered(tmp_path / "sets", folders)
    found = one_set(tmp_path / "sets")
    text = sets_part([found], 3)
    sizes, *coverage = (line for line in text.splitlines() if line.startswith("| panda |"))
    assert "There are sets of 1 of the 3 scenes" in text
    units: dict[int, set[Any]] = {}
    for one, folder in folders.items():
        units.setdefault(one.seed, set()).update(found_cells(folder))
    often = Counter(Counter(chain(*units.values())).values())
    total = often.total() + 4 / 5 * often[1] ** 2 / (2 * often[2])
    assert f"| 10 | 5 | {len(found.found)} | {total:.0f} (" in sizes
    for line, each in zip(coverage, found.coverage, strict=True):
        assert f"| 300 | {each.method} | {len(each.by_run)} | {100 * np.median(each.by_run):.1f} (" in line
        assert line.endswith(f" | {100 * each.together:.1f} | {100 * each.alone:.1f} |")
    assert sets_part([], 3) == ""


def test_a_set_with_cells_that_no_complete_seed_found_has_no_estimate(tmp_path: Path) -> None:
    folders = runs(tmp_path, 1, 2, 3, 4, 5, 6) | runs(tmp_path, 1, 2, 3, 4, 5, method="contact_rand")
    gathered(tmp_path / "sets", folders)
    found = one_set(tmp_path / "sets")
    assert f"| 11 | 5 | {len(found.found)} |  |  |" in sets_part([found], 3)


def test_one_run_has_no_estimate_and_a_set_in_which_nothing_holds_no_coverage(tmp_path: Path) -> None:
    gathered(tmp_path / "sets", runs(tmp_path, 1))
    found = one_set(tmp_path / "sets")
    none = {"cells": found.found.cells[:0], "fitness": found.found.fitness[:0]}
    empty = dataclasses.replace(found.found, **none, by_run=found.found.by_run[:, :0])
    text = sets_part([found, SceneSet(found.scene, empty, found.runs)], 2)
    assert "nan" not in text
    assert f"| 1 | 1 | {len(found.found)} |  |  |" in text


def test_a_set_that_is_gone_is_named_until_its_runs_make_it_again(tmp_path: Path) -> None:
    folders, home = runs(tmp_path, 1), tmp_path / "sets"
    gathered(home, folders)
    (home / reference_sets.file_name(SCENE)).unlink()
    with pytest.raises(InputError, match=r"ball-paper\.npz is not the set .* it does not exist; delete it"):
        read(home)
    assert gathered(home, folders)
    assert len(one_set(home).runs) == 1


def test_a_damaged_list_of_runs_is_named_with_its_line(tmp_path: Path) -> None:
    gathered(tmp_path / "sets", runs(tmp_path, 1))
    file = tmp_path / "sets" / reference_sets.RUNS
    file.write_text(file.read_text().replace(",1,300,", ",one,300,"))
    with pytest.raises(InputError, match=r"runs\.csv, line 2: .*restore the line"):
        read(tmp_path / "sets")
