"""`qdgrasp-monitor`: what it prints, and what it makes of its options."""

import json

import msgspec
import pytest
from tests.coordinator.monitor.shown import values, views

from qdgrasp_coordinator.cli.monitor import address, chosen, show, to_json
from qdgrasp_coordinator.monitor.jobs import JobView
from qdgrasp_protocol.errors import ImpossibleValue, UnknownName

ENDPOINT = "tcp/127.0.0.1:1"
BOTH = views(values("mugs") | values("cubes"))


def test_one_job_is_chosen_by_its_name_and_all_without_one() -> None:
    assert [view.job for view in chosen(BOTH, None)] == ["cubes", "mugs"]
    assert [view.job for view in chosen(BOTH, "mugs")] == ["mugs"]


def test_a_job_that_is_not_there_is_missed_only_where_there_are_others() -> None:
    with pytest.raises(UnknownName, match="Did you mean 'mugs'"):
        chosen(BOTH, "mug")
    assert chosen([], "mug") == []


def test_json_is_one_line_from_which_all_can_be_read_again() -> None:
    line = to_json(BOTH, ENDPOINT)
    assert "\n" not in line
    read = json.loads(line)
    assert read["endpoint"] == ENDPOINT
    assert msgspec.convert(read["jobs"], list[JobView]) == BOTH


@pytest.mark.parametrize("ascii_only", [True, False])
def test_one_look_shows_all_jobs_and_names_those_of_another_version(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, ascii_only: bool
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    show(BOTH, ENDPOINT, ["old"], ascii_only=ascii_only)
    said = capsys.readouterr().out
    for words in ("mugs: running", "cubes: running", "qdgrasp-monitor: old", "1 000 of 3 000", "n0"):
        assert words in said
    assert max(map(len, said.splitlines())) <= 80
    assert said.isascii() or not ascii_only


def test_one_look_at_nothing_says_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    show([], ENDPOINT, [], ascii_only=False)
    assert capsys.readouterr().out.startswith(f"No job is at {ENDPOINT}")


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("127.0.0.1:8080", ("127.0.0.1", 8080)),
        ("[::1]:80", ("::1", 80)),
        ("head:0", ("head", 0)),
    ],
)
def test_the_place_of_the_page_is_a_host_and_a_port(text: str, place: tuple[str, int]) -> None:
    assert address(text) == place


@pytest.mark.parametrize("text", ["", "8080", ":8080", "head", "head:", "head:x", "head:65536", "head:-1"])
def test_what_is_no_place_is_refused_with_how_to_write_one(text: str) -> None:
    with pytest.raises(ImpossibleValue, match="HOST:PORT, such as"):
        address(text)
