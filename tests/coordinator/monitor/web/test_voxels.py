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
Shown = dict[Cell, tuple[int, int]]
"""The journal number and the outcome in each cell."""


def read(page: bytes) -> tuple[int, int, Shown]:
    """The number to ask from next, the journal's rows, and what a page shows."""
    mark, n, upto, rows, _, _ = HEADER.unpack_from(page)
    assert mark == MARK
    assert len(page) == HEADER.size + 11 * n
    numbers = np.frombuffer(page, "<u4", n, HEADER.size).tolist()
    places = np.frombuffer(page, "<i2", 3 * n, HEADER.size + 4 * n).reshape(-1, 3).tolist()
    outcomes = np.frombuffer(page, "u1", n, HEADER.size + 10 * n).tolist()
    return upto, rows, {tuple(place): kind for place, *kind in zip(places, numbers, outcomes, strict=True)}


def pages(kept: Voxels, first: int = 0) -> Iterator[Shown]:
    while True:
        first, rows, shown = read(kept.page(first))
        yield shown
        if first >= rows:
            return


def best(found: Found) -> Shown:
    """The same by the plainest means."""
    kept: Shown = {}
    for one in found:
        place: Cell = tuple(cells(one["descriptor"]).tolist())
        if place not in kept or one["outcome"] > kept[place][1]:
            kept[place] = (int(one["number"]), int(one["outcome"]))
    return kept


def shown(kept: Voxels) -> Shown:
    return {place: tuple(kind) for page in pages(kept) for place, kind in page.items()}


def test_each_cell_keeps_its_best_find_and_of_equals_the_first() -> None:
    found = random_finds(2000)
    kept = Voxels()
    kept.insert(found, 4000, 4000)
    assert shown(kept) == best(found)
    assert len(kept) == len(best(found))


@pytest.mark.parametrize("on_a_page", [1, 7, 100])
def test_pages_add_up_to_the_same_however_long_they_are(
    monkeypatch: pytest.MonkeyPatch, on_a_page: int
) -> None:
    found = random_finds(500)
    kept = Voxels()
    kept.insert(found, 1000, 1000)
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
        kept.insert(found[start : start + 90], 2 * (start + 90), 1800)
        first, _, page = read(kept.page(first))  # one page at a time: it falls behind
        heard |= {place: tuple(kind) for place, kind in page.items()}
    for page in pages(kept, first):
        heard |= {place: tuple(kind) for place, kind in page.items()}
    assert heard == shown(kept) == best(found)


def test_only_what_changed_is_on_a_later_page() -> None:
    kept = Voxels()
    kept.insert(finds([3, 5], [(0, 0, 1), (0, 0, 2)], [Outcome.DROPPED, Outcome.HELD]), 6, 6)
    first, _, _ = read(kept.page(0))
    kept.insert(finds([6, 7, 8], [(0, 0, 1), (0, 0, 2), (0, 0, 3)], [Outcome.SHAKEN] * 3), 9, 9)
    upto, rows, page = read(kept.page(first))
    assert (upto, rows) == (9, 9)
    assert page == {(0, 0, 1): [6, Outcome.SHAKEN], (0, 0, 3): [8, Outcome.SHAKEN]}


def test_there_is_an_answer_before_anything_was_found() -> None:
    assert read(Voxels().page(0)) == (0, 0, {})


def test_no_more_are_kept_than_there_is_room_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(voxels, "LARGEST", 100)
    kept, found = Voxels(), random_finds(2000)
    for start in range(0, 2000, 500):
        kept.insert(found[start : start + 500], 2 * (start + 500), 4000)
    assert len(kept) == 100
    assert shown(kept).keys() <= best(found).keys()


def test_a_find_beyond_all_reach_is_left_out() -> None:
    kept = Voxels()
    kept.insert(finds([0, 1], [(10**6, 0, 0), (1, 2, 3)], [Outcome.HELD] * 2), 2, 2)
    assert shown(kept) == {(1, 2, 3): (1, Outcome.HELD)}
