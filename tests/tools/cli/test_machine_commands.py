"""`qdgrasp security`: its output and exit codes."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from qdgrasp_protocol.errors import OutputError, SecurityError
from qdgrasp_tools.cli import machine_commands
from qdgrasp_tools.security import access_report
from qdgrasp_tools.security.access_list import TrafficKind
from qdgrasp_tools.security.access_probe import PROBE_KEYS, Delivery, LoginAttempt, allowed_deliveries
from qdgrasp_tools.security.access_report import AccessReport, access_matrix, wide_deliveries

ALL = {meeting for way in TrafficKind for meeting in allowed_deliveries(way, PROBE_KEYS)}
RESULT = next(key for key in PROBE_KEYS if "@result" in key)
DUE = Delivery(TrafficKind.PUT, RESULT, "worker", "coordinator")
FORGED = Delivery(TrafficKind.PUT, RESULT, "guest", "coordinator")
OVERHEARD = Delivery(TrafficKind.PUT, RESULT, "worker", "monitor, by a wide pattern")


def run(*arguments: object) -> tuple[int, str]:
    done = CliRunner().invoke(machine_commands.security_app, [*map(str, arguments)])
    if isinstance(done.exception, OutputError | SecurityError):
        raise done.exception
    return done.exit_code, done.output


def test_init_writes_a_folder_and_add_another_in_it(tmp_path: Path) -> None:
    folder = tmp_path / "security"
    code, said = run("init", folder, "--host", "head", "--days", 7)
    assert (code, "good for 7 days" in said, "qdgrasp-router --listen tls/" in said) == (0, True, True)
    code, said = run("add", folder, "worker", "lab-7")
    assert (code, str(folder / "lab-7") in said) == (0, True)
    assert (folder / "lab-7" / "worker.key").is_file()
    with pytest.raises(OutputError, match="or add to it with `qdgrasp security add"):
        run("init", folder)


def test_check_asks_for_the_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("QDGRASP_SECURITY", raising=False)
    with pytest.raises(SecurityError, match="--security"):
        run("check")


@pytest.mark.parametrize(
    ("seen", "knocks", "code", "words"),
    [
        (ALL, [], 0, " silent, 0 wrong; "),
        (ALL | {FORGED}, [], 1, "WRONG: guest to coordinator (put, hear) on @result/*, which is not allowed"),
        (ALL | {OVERHEARD}, [], 1, "WRONG: by a pattern that no role may use: worker to monitor"),
        (
            ALL - {Delivery(TrafficKind.PUT, RESULT, "worker", "coordinator")},
            [],
            1,
            "WRONG: not seen: worker to coordinator",
        ),
        (ALL, [LoginAttempt("no certificate", got_in=True)], 1, "WRONG: got in with no certificate"),
    ],
)
def test_check_ends_with_one_where_anything_is_wrong(monkeypatch, seen, knocks, code, words) -> None:
    found = AccessReport(access_matrix(seen), wide_deliveries(seen), knocks)
    monkeypatch.setattr(access_report, "check_access", lambda *_, **__: found)
    assert (not found.faults) == (code == 0)
    ended, said = run("check", "--security", ".")
    assert ended == code
    assert words in said
    assert said.count("WRONG: ") == code
