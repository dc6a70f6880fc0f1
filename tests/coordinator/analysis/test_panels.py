from tests.coordinator.analysis.runs import climb, made

from qdgrasp_coordinator.analysis.entries import entries
from qdgrasp_coordinator.analysis.panels import measure_words, panels, run_words

RUNS = [
    made(method, climb(3, 5), seed=seed) for method in ("contact_rand", "contact_me_scs") for seed in (0, 1)
]


def test_the_heading_of_a_panel_says_how_many_seeds_and_evaluations_are_behind_its_curves() -> None:
    assert run_words(entries(RUNS), 3) == "2 seeds \u00d7 100 evaluations"
    more = [*RUNS, made("me_scs", climb(1), evaluations=40)]
    assert run_words(entries(more), 4) == "2 seeds \u00d7 100 evaluations; me_scs: 1 \u00d7 40, 1 unfinished"


def test_a_heading_without_room_says_from_where_to_where() -> None:
    more = [*RUNS, made("me_scs", climb(1), evaluations=40)]
    assert run_words(entries(more), 2) == "1\u20132 seeds \u00d7 40\u2013100 evaluations, 1 unfinished"


def test_a_scene_without_a_set_says_what_is_measured_and_why() -> None:
    (panel,) = panels(entries(RUNS))
    assert measure_words(panel) == "success cells of 1 cm: no S_G"
    assert (panel.end, panel.top) == (100, 5)
