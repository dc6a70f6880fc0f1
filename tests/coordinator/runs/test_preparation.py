"""From what is asked for to a run that can be carried out."""

from importlib.resources import files
from pathlib import Path

import pytest

from qdgrasp_coordinator.runs.preparation import full_spec, make_bundle
from qdgrasp_coordinator.searches.search import METHODS
from qdgrasp_protocol.errors import ImpossibleValue, JawNeeded

ASKED = {"gripper": "panda", "object": "tennis_ball"}


@pytest.mark.parametrize("entry", METHODS.values(), ids=METHODS)
def test_the_spec_is_completed_with_what_the_method_has(entry) -> None:
    spec = full_spec({**ASKED, "method": entry.name})
    assert (spec.population, spec.overlaps) == (entry.population, entry.overlaps)
    assert spec.generations_in_flight == entry.generations_in_flight


def test_without_a_method_a_run_has_the_default() -> None:
    assert full_spec(dict(ASKED)) == full_spec({**ASKED, "method": "aimed"})


def test_what_is_asked_for_stays() -> None:
    spec = full_spec({**ASKED, "method": "cma_mae", "population": 60, "overlaps": "redraw"})
    assert (spec.population, spec.overlaps) == (60, "redraw")


@pytest.mark.parametrize(("key", "value"), [("population", 500), ("generations_in_flight", 2)])
def test_what_the_method_cannot_do_is_refused(key, value) -> None:
    with pytest.raises(ImpossibleValue, match=rf"^{key} must be .*cma_mae"):
        full_spec({**ASKED, "method": "contact_cma_mae", key: value})


def jawless(folder: Path) -> Path:
    """The built-in Panda, not told to be a two-finger hand."""
    built_in = Path(str(files("qdgrasp_assets") / "grippers"))
    (folder / "panda.urdf").write_text((built_in / "panda.urdf").read_text())
    toml = folder / "hand.toml"
    before, _, jaw = (built_in / "panda.toml").read_text().partition("[jaw]")
    toml.write_text(before + jaw[jaw.index("[joints") :])
    return toml


def test_a_hand_without_a_jaw_is_refused_by_antipodal_methods_alone(tmp_path) -> None:
    asked = {**ASKED, "gripper": str(jawless(tmp_path))}
    make_bundle(full_spec({**asked, "method": "approach_rand"}))
    with pytest.raises(JawNeeded, match=r"'antipodal' is for two-finger hands, and the gripper 'hand'"):
        make_bundle(full_spec({**asked, "method": "antipodal_me_scs"}))
