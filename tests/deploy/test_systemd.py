"""Units of systemd, and the page of deploy/."""

import re
import shutil
import subprocess
from math import inf
from pathlib import Path

import pytest
from tests.deploy.commands import COMMANDS, DEPLOY, filled, understood

from qdgrasp_protocol.errors import Cancelled, InputError, TookOver

UNITS = sorted((DEPLOY / "systemd").glob("*.service"))
SETTINGS = DEPLOY / "systemd" / "qdgrasp.env"
BIN = "/opt/qdgrasp/bin"
INSTANCE = {"qdgrasp-worker@": "3", "qdgrasp-coordinator@": "mugs", "qdgrasp-recorder@": "mugs"}
ANALYSE = shutil.which("systemd-analyze") or ""
PAUSE = 3.0
"""Seconds that a worker may take beyond its grace."""

Settings = dict[str, list[str]]
"""Values by key, of all sections together: no key stands in two of them."""


def read(unit: Path) -> Settings:
    found: Settings = {}
    for line in unit.read_text().splitlines():
        if line and line[0] not in "#[":
            key, _, value = line.partition("=")
            found.setdefault(key, []).append(value)
    return found


def command(unit: Path, **told: str) -> list[str]:
    settings = read(unit)
    (line,) = settings["ExecStart"]
    line = line.replace("%i", INSTANCE.get(unit.stem, "")).replace("%d", "/run/credentials")
    line = re.sub(r"\$(\w+)", lambda name: told.get(name[1], ""), line)  # without braces: any number of words
    pairs = " ".join(settings.get("Environment", [])).split()
    environment = dict(pair.split("=", 1) for pair in pairs)
    return filled(re.sub(r"%[CS]", "/var/lib", line), environment | told)


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_a_unit_starts_a_command_with_options_that_it_has(unit: Path) -> None:
    words = command(unit)
    assert words[0] == f"{BIN}/{unit.stem.rstrip('@')}"
    assert str(understood(words)["security"]) == "/run/credentials"


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_a_unit_loads_the_certificates_of_its_role(unit: Path) -> None:
    role = unit.stem.removeprefix("qdgrasp-").rstrip("@")
    loaded = {line.partition(":")[0] for line in read(unit)["LoadCredential"]}
    assert {"ca.pem", f"{role}.pem", f"{role}.key"} <= loaded
    assert ("router.json5" in loaded) == (role == "router")


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_a_unit_is_stopped_politely_and_is_no_ones_door_into_the_system(unit: Path) -> None:
    settings = read(unit)
    assert settings["KillSignal"] == ["SIGTERM"]
    assert settings["SuccessExitStatus"] == ["130 143" if "coordinator" in unit.stem else "143"]
    assert settings["ProtectSystem"] == ["strict"]
    assert settings["NoNewPrivileges"] == ["yes"]
    assert settings.get("DynamicUser") == ["yes"] or settings["User"] != ["root"]


def test_the_folder_of_a_job_can_appear_within_what_its_recorder_may_write() -> None:
    unit = DEPLOY / "systemd" / "qdgrasp-recorder@.service"
    (state,) = read(unit)["StateDirectory"]
    assert understood(command(unit))["out"].parent == Path("/var/lib") / state


def test_a_router_relays_with_the_other_one_where_it_is_told_so() -> None:
    unit = DEPLOY / "systemd" / "qdgrasp-router.service"
    (line,) = re.findall(r"^#(QDGRASP_ROUTER_FLAGS=.*)$", SETTINGS.read_text(), re.M)
    name, _, flags = line.partition("=")
    assert understood(command(unit))["connect"] is None
    assert understood(command(unit, **{name: flags}))["connect"] == "tls/head2:7447"


def test_a_coordinator_is_started_again_unless_it_ended_for_good() -> None:
    unit = DEPLOY / "systemd" / "qdgrasp-coordinator@.service"
    settings = read(unit)
    assert settings["Restart"] == ["on-failure"]
    assert Cancelled.exit_code == 0
    (codes,) = settings["RestartPreventExitStatus"]
    assert {*map(int, codes.split())} == {InputError.exit_code, TookOver.exit_code}
    assert understood(command(unit))["wait"] == inf  # a router that is away at the start is no bad input


def test_a_worker_is_waited_for_longer_than_its_grace() -> None:
    unit = DEPLOY / "systemd" / "qdgrasp-worker@.service"
    settings = read(unit)
    told = dict(
        line.split("=", 1) for line in SETTINGS.read_text().splitlines() if line and not line.startswith("#")
    )
    (patience,) = map(float, settings["TimeoutStopSec"])
    assert understood(command(unit))["grace"] + PAUSE <= patience
    assert float(told["QDGRASP_GRACE"]) + PAUSE <= patience


def test_a_worker_is_ended_by_its_unit_only_above_what_it_ends_itself() -> None:
    unit = DEPLOY / "systemd" / "qdgrasp-worker@.service"
    (most,) = read(unit)["MemoryMax"]
    assert float(most.removesuffix("G")) * 1024 >= understood(command(unit))["memory"] * 1.2


def test_every_variable_of_the_environment_file_is_used() -> None:
    named = set(re.findall(r"^#?(QDGRASP_\w+)=", SETTINGS.read_text(), re.M))
    used = {name for unit in UNITS for name in re.findall(r"\$\{?(\w+)", unit.read_text())}
    assert named - used == {"QDGRASP_ASSET_PATH", "QDGRASP_DATA"}  # which the program reads itself
    assert used <= named


@pytest.mark.skipif(not ANALYSE, reason="systemd-analyze is not installed")
@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_systemd_has_nothing_to_say_against_a_unit(unit: Path, tmp_path: Path) -> None:
    for name in {command(each)[0] for each in UNITS}:
        stand_in = tmp_path / "bin" / Path(name).name
        stand_in.parent.mkdir(exist_ok=True)
        stand_in.write_text("#!/bin/sh\n")
        stand_in.chmod(0o755)
    for each in UNITS:
        text = each.read_text().replace(BIN, str(tmp_path / "bin"))
        (tmp_path / f"{each.stem}{INSTANCE.get(each.stem, '')}.service").write_text(text)
    name = f"{unit.stem}{INSTANCE.get(unit.stem, '')}.service"
    words = [ANALYSE, "verify", "--man=no", str(tmp_path / name)]
    said = subprocess.run(words, capture_output=True, text=True, check=False)
    about_us = [line for line in said.stderr.splitlines() if "qdgrasp" in line]
    assert (said.returncode, about_us) == (0, [])


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
