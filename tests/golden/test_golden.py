"""Promises to the outside are as the golden files say: wire, files, commands, rows.

`python -m tests.golden --write` has the golden files say how it is now.
"""

from pathlib import Path

import pytest
from tests.fakes.messages import KINDS, example
from tests.golden import runs, wire
from tests.golden.golden_files import MAKERS, differences

from qdgrasp_worker.platform import probe_digest

REMEDY = "differs; where that is meant: python -m tests.golden --write"


@pytest.mark.parametrize("name", [name for name in MAKERS if name != runs.DIGESTS.name])
def test_the_outside_is_what_the_golden_file_says(name: str) -> None:
    assert not (found := differences(name, MAKERS[name]())), f"{name} {REMEDY}\n{found}"


def test_an_example_has_no_value_that_might_be_left_out() -> None:
    for kind in (*KINDS, *wire.SHOWN.values()):
        made = example(kind)
        defaults = dict(zip(kind.__struct_fields__[::-1], kind.__struct_defaults__[::-1], strict=False))
        assert not [name for name, value in defaults.items() if name != "v" and getattr(made, name) == value]


@pytest.mark.usefixtures("same_platform")
def test_the_probes_give_what_they_gave() -> None:
    assert probe_digest() == runs.golden()["probes"]


@pytest.mark.timeout(1800)  # twenty seconds on a quiet machine
@pytest.mark.usefixtures("same_platform")
def test_runs_of_every_search_and_protocol_have_their_golden_digests(tmp_path: Path) -> None:
    assert runs.digests(tmp_path) == runs.golden()["runs"]
