from collections.abc import Iterator

import numpy as np
import pytest
from tests.coordinator.monitor.web.finds import finds, random_finds

from qdgrasp_coordinator.counts.cells import cells
from qdgrasp_coordinator.counts.finds import Found
from qdgrasp_coordinator.monitor.web import voxels
from qdgrasp_coordinator.monitor.web.voxels import HEADER, MARK, Voxels
from qdgrasp_protocol.outcome import Outcome

Cell = tuple[int, int, int]
Shown = dict[tuple[Cell, int, int], tuple[int, float]]
"""The journal number and the eta for each cell, outcome and synergy."""


def read(page: bytes) -> tuple[int, bool, Shown]:
    """The serial to ask from next, whether there is more at once, and what a page shows."""
    mark, n, upto, more, _, _ = HEADER.unpack_from(page)
    assert mark == MARK
    assert len(page) == HEADER.size + 17 * n
    numbers = np.frombuffer(page, "<u4", n, HEADER.size).tolist()
    etas = np.frombuffer(page, "<f4", n, HEADER.size + 4 * n).tolist()
    places = np.frombuffer(page, "<i2", 3 * n, HEADER.size + 8 * n).reshape(-1, 3).tolist()
    labels = np.frombuffer(page, "<i2", n, HEADER.size + 14 * n).tolist()
    outcomes = np.frombuffer(page, "u1", n, HEADER.size + 16 * n).tolist()
    names = zip(map(tuple, places), outcomes, labels, strict=True)
    return upto, bool(more), dict(zip(names, zip(numbers, etas, strict=True), strict=True))


def in_cells(page: bytes) -> dict[Cell, tuple[int, int]]:
    """The journal number and the outcome in each cell, where it has one alone."""
    return {place: (number, outcome) for (place, outcome, _), (number, _) in read(page)[2].items()}


def pages(kept: Voxels, first: int = 0) -> Iterator[Shown]:
    while True:
        first, more, shown = read(kept.page(first))
        yield shown
        if not more:
            return


def best(found: Found) -> Shown:
    """The same by the plainest means."""
    kept: Shown = {}
    for one in found:
        name = (tuple(cells(one["descriptor"]).tolist()), int(one["outcome"]), int(one["synergy"]))
        if name not in kept or one["eta"] > kept[name][1]:
            kept[name] = (int(one["number"]), float(one["eta"]))
    return kept


def shown(kept: Voxels) -> Shown:
    return {name: what for page in pages(kept) for name, what in page.items()}


def test_each_cell_outcome_and_synergy_keeps_its_best_find_and_of_equals_the_first() -> None:
    found = random_finds(2000)
    kept = Voxels()
    kept.insert(found, 4000)
    assert shown(kept) == best(found)
    assert len(kept) == len(best(found))


@pytest.mark.parametrize("on_a_page", [1, 7, 100])
def test_pages_add_up_to_the_same_however_long_they_are(
    monkeypatch: pytest.MonkeyPatch, on_a_page: int
) -> None:
    found = random_finds(500)
    kept = Voxels()
    kept.insert(found, 1000)
    whole = shown(kept)
    monkeypatch.setattr(voxels, "MOST", on_a_page)
    assert shown(kept) == whole
    assert {len(page) for page in list(pages(kept))[:-1]} <= {on_a_page}


def test_whoever_asks_on_while_finds_come_has_what_a_late_comer_gets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(voxels, "MOST", 20)
    found, kept = random_finds(900), Voxels()
    heard: Shown = {}
    first = 0
    for start in range(0, 900, 90):
        kept.insert(found[start : start + 90], 2 * (start + 90))
        first, _, page = read(kept.page(first))  # one page at a time: it falls behind
        heard |= page
    for page in pages(kept, first):
        heard |= page
    assert heard == shown(kept) == best(found)


def test_only_what_changed_is_on_a_later_page() -> None:
    kept = Voxels()
    kept.insert(finds([3, 5], [(0, 0, 1), (0, 0, 2)], [Outcome.DROPPED, Outcome.SHAKEN]), 6)
    first, _, _ = read(kept.page(0))
    kept.insert(finds([6, 7, 8], [(0, 0, 1), (0, 0, 2), (0, 0, 3)], [Outcome.SHAKEN] * 3), 9)
    upto, more, page = read(kept.page(first))
    assert not more
    assert page == {((0, 0, 1), Outcome.SHAKEN, -1): (6, -1), ((0, 0, 3), Outcome.SHAKEN, -1): (8, -1)}
    assert read(kept.page(upto))[2] == {}


def test_a_find_that_is_told_again_is_news_when_its_eta_is_known() -> None:
    kept, found = Voxels(), finds([3, 5], [(0, 0, 1)] * 2, [Outcome.HELD] * 2)
    kept.insert(found, 3)
    first, _, _ = read(kept.page(0))
    kept.insert(found, 3)
    assert read(kept.page(first)) == (first, False, {})
    kept.insert(finds([3, 5], [(0, 0, 1)] * 2, [Outcome.HELD] * 2, etas=[0.25, 0.5]), 6)
    assert read(kept.page(first))[2] == {((0, 0, 1), Outcome.HELD, -1): (5, 0.5)}


def test_it_is_told_when_there_is_more_to_read() -> None:
    kept = Voxels()
    kept.insert(random_finds(5), 10, is_whole=False)
    assert read(kept.page(0))[1]


def test_there_is_an_answer_before_anything_was_found() -> None:
    assert read(Voxels().page(0)) == (0, False, {})


def test_no_more_are_kept_than_there_is_room_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(voxels, "LARGEST", 100)
    kept, found = Voxels(), random_finds(2000)
    for start in range(0, 2000, 500):
        kept.insert(found[start : start + 500], 2 * (start + 500))
    assert len(kept) == 100
    assert shown(kept).keys() <= best(found).keys()


def test_a_find_beyond_all_reach_is_left_out() -> None:
    kept = Voxels()
    kept.insert(finds([0, 1], [(10**6, 0, 0), (1, 2, 3)], [Outcome.HELD] * 2), 2)
    assert shown(kept) == {((1, 2, 3), Outcome.HELD, -1): (1, -1)}
