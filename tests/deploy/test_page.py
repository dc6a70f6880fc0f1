import re

import pytest
from tests.deploy.commands import COMMANDS, DEPLOY, understood

PAGE = DEPLOY.parent / "docs" / "machines.md"
BLOCKS = re.findall(r"```sh\n(.*?)```", PAGE.read_text(), re.DOTALL)
LINES = [re.sub(r"\s+#.*", "", line).strip() for block in BLOCKS for line in block.splitlines()]
OURS = [line for line in LINES if line.split()[0] in COMMANDS]


@pytest.mark.parametrize("line", OURS)
def test_a_command_on_the_page_has_the_options_that_it_shows(line: str) -> None:
    assert understood(line.split()) is not None


def test_the_page_shows_every_process_and_every_way_to_steer() -> None:
    shown = {" ".join(line.split()[:2]) if line.startswith("qdgrasp ") else line.split()[0] for line in OURS}
    steering = {f"qdgrasp {verb}" for verb in ("jobs", "pause", "drain", "cancel", "security", "campaign")}
    assert (set(COMMANDS) - {"qdgrasp"}) | steering <= shown


def test_files_in_commands_are_there() -> None:
    named = {word for line in LINES for word in line.split() if word.startswith("deploy/")}
    assert len(named) >= 4
    assert [name for name in named if not (DEPLOY.parent / name).exists()] == []
