"""Workers that commands start, and how long they may take to leave."""

from pathlib import Path
from typing import Any

import pytest
from tests.deploy.commands import understood

import qdgrasp_coordinator
from qdgrasp_coordinator.watching.workers import GRACE, hire_worker
from qdgrasp_protocol.crew import MARGIN, Crew


class Staff(Crew):
    """A crew that notes with what its members are started, and starts nobody."""

    def hire(self, name: str, module: str, arguments: Any, core: int | None = None) -> None:
        self.command = ["qdgrasp-worker", *arguments]


@pytest.mark.parametrize("grace", [0.25, GRACE, 60.0])
def test_a_worker_is_told_to_leave_before_its_crew_ends_it(tmp_path: Path, grace: float) -> None:
    staff = Staff(tmp_path, grace)
    hire_worker(staff, 0, ["--connect", "tcp/127.0.0.1:7447"])
    assert understood(staff.command)["grace"] == pytest.approx(max(0.0, grace - MARGIN))


def test_workers_are_started_in_one_place() -> None:
    room = Path(qdgrasp_coordinator.__file__).parent
    starters = [file.relative_to(room) for file in room.rglob("*.py") if '.hire(f"worker' in file.read_text()]
    assert starters == [Path("watching/workers.py")]
