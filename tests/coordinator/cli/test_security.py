"""`qdgrasp security`: what it prints, and how it ends."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from qdgrasp_coordinator.cli import security
from qdgrasp_coordinator.security import proof
from qdgrasp_coordinator.security.meetings import Meeting, allowed
from qdgrasp_coordinator.security.proof import Proof
from qdgrasp_coordinator.security.stage import KEYS
from qdgrasp_coordinator.security.strangers import Knock
from qdgrasp_coordinator.security.traffic import Way
from qdgrasp_coordinator.security.verdicts import cells, wide
from qdgrasp_protocol.errors import OutputError, SecurityError

ALL = {meeting for way in Way for meeting in allowed(way, KEYS)}
RESULT = next(key for key in KEYS if "@result" in key)
DUE = Meeting(Way.PUT, RESULT, "worker", "coordinator")
FORGED = Meeting(Way.PUT, RESULT, "guest", "coordinator")
OVERHEARD = Meeting(Way.PUT, RESULT, "worker", "monitor, by a wide pattern")


def run(*arguments: object) -> tuple[int, str]:
    done = CliRunner().invoke(security.app, [*map(str, arguments)])
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
        (ALL | {OVERHEARD}, [], 1, "WRONG: by a pattern that nobody may use: worker to monitor"),
        (
            ALL - {Meeting(Way.PUT, RESULT, "worker", "coordinator")},
            [],
            1,
            "WRONG: not seen: worker to coordinator",
        ),
        (ALL, [Knock("no certificate", got_in=True)], 1, "WRONG: got in with no certificate"),
    ],
)
def test_check_ends_with_one_where_anything_is_wrong(
    monkeypatch: pytest.MonkeyPatch, seen: set[Meeting], knocks: list[Knock], code: int, words: str
) -> None:
    found = Proof(cells(seen), wide(seen), knocks)
    monkeypatch.setattr(proof, "prove", lambda *_, **__: found)
    assert found.holds == (code == 0)
    ended, said = run("check", "--security", ".")
    assert ended == code
    assert words in said
    assert said.count("WRONG: ") == code
