"""Finds in a journal, page by page, with the etas of their trials."""

from pathlib import Path

import numpy as np
import pytest
from tests.coordinator.recorded_runs import random_rows, record, success_mask

from qdgrasp_coordinator.metrics.successes import TrialPlan
from qdgrasp_coordinator.storage import success_pages
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_coordinator.storage.success_pages import NO_ETA, RowContext, success_page
from qdgrasp_protocol.rows import Rows

TRIALS = 3
LEGEND = RowContext(TrialPlan(TRIALS))


def with_trials(nominal: Rows, seed: int = 1) -> Rows:
    """Rows of a journal with trials of successes behind the nominal rows of each generation."""
    random, parts = np.random.default_rng(seed), []
    for generation in np.unique(nominal["generation"]):
        rows = nominal[nominal["generation"] == generation]
        trials = np.repeat(rows[success_mask(rows)], TRIALS)
        trials["trial"] = 1 + np.arange(len(trials)) % TRIALS
        trials["fitness"] = random.integers(0, 3, len(trials))
        parts += [rows, trials]
    return np.concatenate(parts)


def etas(rows: Rows) -> dict[int, float]:
    """The eta of each success with all its trials by its number, by a plain loop."""
    found = {}
    for number in np.flatnonzero(success_mask(rows)).tolist():
        same = (rows["generation"] == rows["generation"][number]) & (rows["index"] == rows["index"][number])
        trials = rows[same & (rows["trial"] > 0)]
        found[number] = float(trials["fitness"].sum() / (2 * TRIALS)) if len(trials) == TRIALS else NO_ETA
    return found


@pytest.fixture
def rows() -> Rows:
    return with_trials(random_rows(60))


@pytest.fixture
def folder(tmp_path: Path, make_scene, rows: Rows) -> RunFolder:
    return record(tmp_path / "mug", make_scene(), rows)


def told(folder: RunFolder, first: int = 0, context: RowContext = LEGEND) -> tuple[dict[int, float], int]:
    """All pages from a row on, and the number from which to read on."""
    found: dict[int, float] = {}
    with folder.journal() as journal:
        while True:
            finds, upto = success_page(journal, first, context)
            found |= dict(zip(finds["number"].tolist(), finds["eta"].tolist(), strict=True))
            if upto in (first, journal.count):
                return found, upto
            first = upto


@pytest.mark.parametrize("scanned", [1, 7, 40, 1000])
def test_every_success_comes_with_its_eta_however_short_pages_are(folder, rows, monkeypatch, scanned) -> None:
    monkeypatch.setattr(success_pages, "ROWS_SCANNED", scanned)
    found, upto = told(folder)
    assert found == pytest.approx(etas(rows))
    assert NO_ETA not in found.values()
    assert upto == len(rows)


@pytest.mark.parametrize("most", [1, 5])
def test_no_page_has_more_than_an_answer_may_have(folder, rows, monkeypatch, most) -> None:
    monkeypatch.setattr(success_pages, "MOST_SUCCESSES", most)
    assert told(folder)[0] == pytest.approx(etas(rows))


@pytest.mark.parametrize("first", [1, 15, 44, 70])
def test_one_may_begin_anywhere_among_the_trials_of_others(folder: RunFolder, rows: Rows, first: int) -> None:
    expected = {number: eta for number, eta in etas(rows).items() if number >= first}
    assert told(folder, first)[0] == pytest.approx(expected)


@pytest.mark.parametrize("missing", [1, 2, 9, 14])
def test_successes_that_lack_trials_are_told_without_eta_and_are_to_be_read_again(
    tmp_path: Path, make_scene, rows: Rows, missing: int
) -> None:
    short = rows[:-missing]
    found, upto = told(record(tmp_path / "short", make_scene(), short))
    expected = etas(short)
    assert found == pytest.approx(expected)
    assert upto == min(number for number, eta in expected.items() if eta == NO_ETA)
