"""The access list agrees with the table of traffic and docs/security.md."""

import json
import re
from pathlib import Path

import pytest
import zenoh

from qdgrasp_protocol import keys
from qdgrasp_protocol.keys import matches
from qdgrasp_protocol.messages import MAX_PAYLOAD
from qdgrasp_protocol.session import Credentials, Role, session_settings
from qdgrasp_tools.security import access_probe
from qdgrasp_tools.security.access_list import TRAFFIC, TrafficKind, access_list, role_configuration
from qdgrasp_tools.security.access_probe import PROBE_KEYS, PROBE_NAMES, allowed_givers, allowed_takers
from qdgrasp_tools.security.access_report import access_matrix, short_key

ROOT = Path(__file__).resolve().parents[3]
DEPLOYED = ROOT / "deploy" / "zenoh"


def rules(role: str) -> list[dict]:
    found = access_list()["access_control"]
    names = {rule for policy in found["policies"] if policy["subjects"] == [role] for rule in policy["rules"]}
    return [rule for rule in found["rules"] if rule["id"] in names]


def test_what_is_not_in_the_list_is_denied() -> None:
    found = access_list()["access_control"]
    assert found["enabled"] is True
    assert found["default_permission"] == "deny"
    assert {rule["permission"] for rule in found["rules"]} == {"allow"}
    assert {name for subject in found["subjects"] for name in subject["cert_common_names"]} == {
        role.common_name for role in Role
    }


def test_nobody_but_the_coordinator_hands_out_work_or_takes_results() -> None:
    for key, giver, taker in (
        ("qdgrasp/v1/mugs/@work/w", "coordinator", "worker"),
        ("qdgrasp/v1/mugs/@ctl/w", "coordinator", "worker"),
        ("qdgrasp/v1/mugs/@result/w", "worker", "coordinator"),
        ("qdgrasp/v1/mugs/@outcome/1", "coordinator", "recorder"),
        ("qdgrasp/v1/mugs/@recorded", "recorder", "coordinator"),
    ):
        sides = allowed_givers(TrafficKind.PUT, key), allowed_takers(TrafficKind.PUT, key)
        assert sides == ({giver}, {taker})
    assert allowed_givers(TrafficKind.QUERY, "qdgrasp/v1/mugs/rpc/control") == {"admin"}
    assert allowed_givers(TrafficKind.TOKEN, "qdgrasp/v1/mugs/live/coord/1") == {"coordinator"}


def test_a_monitor_says_nothing() -> None:
    assert not any(
        role == "monitor" and flow.kind is not TrafficKind.QUERY for flow in TRAFFIC for role in flow.givers
    )
    sides = [rule for rule in rules("monitor") if "ingress" in rule["flows"]]
    sent = {message for rule in sides for message in rule["messages"]}
    assert not sent & {"put", "delete", "reply", "declare_queryable", "liveliness_token"}


def test_nobody_may_delete() -> None:
    assert not [rule for rule in access_list()["access_control"]["rules"] if "delete" in rule["messages"]]


def test_no_rule_goes_over_a_pattern_that_is_wider_than_a_kind_of_traffic() -> None:
    held = {key for rule in access_list()["access_control"]["rules"] for key in rule["key_exprs"]}
    assert held <= {flow.key for flow in TRAFFIC}
    for pattern in access_probe.WIDE_PATTERNS:
        expression = zenoh.KeyExpr(pattern)
        assert not [key for key in held if zenoh.KeyExpr(key).includes(expression)]


def test_every_key_of_the_protocol_stands_in_the_table() -> None:
    job = keys.Keys("mugs")
    members = [getattr(job, name, None) for name in dir(job) if not name.startswith("_")]
    named = [member("1") if callable(member) else member for member in members]
    concrete = [key for key in named if isinstance(key, str) and key.startswith("qdgrasp/v1/mugs/")]
    assert len(concrete) >= 13
    assert [key for key in concrete if not any(matches(flow.key, key) for flow in TRAFFIC)] == []


def test_everything_that_carries_bytes_has_a_limit() -> None:
    limits = {
        (entry["messages"][0], key): entry["size_limit"]
        for entry in access_list()["low_pass_filter"]
        for key in entry["key_exprs"]
    }
    for flow in TRAFFIC:
        if flow.kind is TrafficKind.PUT:
            assert 0 < limits["put", flow.key] <= MAX_PAYLOAD
        if flow.kind is TrafficKind.QUERY:
            assert 0 < limits["query", flow.key] <= MAX_PAYLOAD
            assert 0 < limits["reply", flow.key] <= MAX_PAYLOAD


def test_the_matrix_covers_each_role_and_each_kind_of_traffic() -> None:
    assert set(PROBE_NAMES) == {role.value for role in Role} - {"router"} | {"guest"}
    assert all(any(matches(flow.key, key) for key in PROBE_KEYS) for flow in TRAFFIC)
    parts = [part for key in PROBE_KEYS for part in key.split("/")]
    assert not any(map(str.isdigit, parts))  # no worker takes it for an epoch


@pytest.mark.parametrize("role", Role)
def test_the_deployed_configurations_are_what_the_builder_writes(role: Role) -> None:
    path = DEPLOYED / f"{role}.json5"
    assert path.read_text() == role_configuration(Credentials(Path("/etc/qdgrasp/security"), role), "head")


@pytest.mark.parametrize("role", Role)
def test_zenoh_reads_the_deployed_configurations_as_they_are_meant(role: Role) -> None:
    config = zenoh.Config.from_file(str(DEPLOYED / f"{role}.json5"))
    mode = "router" if role is Role.ROUTER else "client"
    for name, value in session_settings(
        mode, credentials=Credentials(Path("/etc/qdgrasp/security"), role)
    ).items():
        assert json.loads(config.get_json(name)) == value, name
    held = json.loads(config.get_json("access_control"))
    assert held["enabled"] is (role is Role.ROUTER)
    if role is Role.ROUTER:
        written = access_list()
        ids = [rule["id"] for rule in written["access_control"]["rules"]]
        assert [rule["id"] for rule in held["rules"]] == ids
        assert len(json.loads(config.get_json("low_pass_filter"))) == len(written["low_pass_filter"])


def test_who_administers_sees_no_signs_of_life_and_neither_opens_runs_nor_reads_logs() -> None:
    """It asks how jobs are and tells them what to do; monitors watch."""
    denied = ("/live/", "/rec/open", "/rec/log")
    assert not [
        key for rule in rules("admin") for key in rule["key_exprs"] if any(map(key.__contains__, denied))
    ]
    assert [key for rule in rules("monitor") for key in rule["key_exprs"] if "/live/" in key]
    assert not [key for rule in rules("recorder") for key in rule["key_exprs"] if "/live/coord" in key]


PAGE = (Path(__file__).resolve().parents[3] / "docs" / "security.md").read_text()
KIB = 1 << 10
UNITS = {"KiB": KIB, "MiB": KIB**2}


def rows(heading: str) -> list[list[str]]:
    """The cells of a table, without its heading."""
    table = PAGE.partition(heading)[2].partition("\n\n")[0]
    return [[cell.strip(" `") for cell in line.split("|")[1:-1]] for line in table.splitlines()[2:]]


def sizes(text: str) -> list[int]:
    return [int(number) * UNITS[unit] for number, unit in re.findall(r"(\d+) (KiB|MiB)", text)]


def roles(text: str) -> set[str]:
    return set(text.split(", ")) - {"-"}


def test_the_page_has_the_table_of_traffic() -> None:
    described = [
        (key, way, roles(givers), roles(takers), sizes(limits))
        for key, way, givers, takers, limits in rows("| key, under")
    ]
    assert described == [
        (
            flow.key.removeprefix("qdgrasp/v1/*/"),
            flow.kind.value,
            set(flow.givers),
            set(flow.takers),
            [size for size in (flow.limit, flow.answer_limit) if size],
        )
        for flow in TRAFFIC
    ]


def test_the_page_has_the_matrix() -> None:
    seen = {meeting for way in TrafficKind for meeting in access_probe.allowed_deliveries(way, PROBE_KEYS)}
    matrix: dict[tuple[str, str], list[str]] = {}
    for cell in access_matrix(seen):
        matrix.setdefault((short_key(cell.key), cell.verb), []).append(cell.mark)
    shown = {
        (key, verb): marks for key, verb, *marks in rows("| key | verb | " + " | ".join(PROBE_NAMES) + " |")
    }
    assert shown == {row: marks for row, marks in matrix.items() if "yes" in marks}
    allowed_, measured = sum(m.count("yes") for m in matrix.values()), sum(len(m) for m in matrix.values())
    assert f"All {measured} cells are measured, {allowed_} allowed and {measured - allowed_} silent" in PAGE
