"""`qdgrasp-monitor`: its output, and the effect of its options."""

import json

import msgspec
import pytest
from tests.tools.monitor.sample_jobs import values, views
from typer.testing import CliRunner

from qdgrasp_protocol.errors import InputError
from qdgrasp_tools.cli import job_commands
from qdgrasp_tools.cli.job_commands import monitor_app
from qdgrasp_tools.monitor.job_model import JobView

TOKEN = "a-token-of-some-length"  # noqa: S105 - it opens nothing
ENDPOINT = "tcp/127.0.0.1:1"
BOTH = views(values("mugs") | values("cubes"))


def test_json_is_one_line_from_which_all_can_be_read_again() -> None:
    line = job_commands.to_json(BOTH, ENDPOINT)
    assert "\n" not in line
    read = json.loads(line)
    assert read["endpoint"] == ENDPOINT
    assert msgspec.convert(read["jobs"], list[JobView]) == BOTH


def test_one_look_shows_all_jobs(capsys, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    job_commands.print_look(BOTH, ENDPOINT)
    said = capsys.readouterr().out
    for words in ("mugs: running", "cubes: running", "1 000 of 3 000", "n0"):
        assert words in said
    assert max(map(len, said.splitlines())) <= 80


@pytest.mark.parametrize("flag", ["--once", "--json"])
def test_a_page_has_no_flags_of_a_terminal(flag: str) -> None:
    refused = CliRunner().invoke(monitor_app, [flag, "--web", "localhost:0"])
    assert isinstance(refused.exception, InputError)
    assert "--web serves a page" in str(refused.exception)
