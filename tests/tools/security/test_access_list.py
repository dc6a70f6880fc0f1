"""The access list: its table of traffic, the deployed files, and what a router lets through."""

import json
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest
import zenoh
from tests.common import PATIENCE
from tests.tools.security.conftest import certificate_files

from qdgrasp_protocol import keys
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.errors import NoReply, Refused
from qdgrasp_protocol.keys import matches
from qdgrasp_protocol.session import Credentials, Role, session_settings
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.security import TRAFFIC, SecurityFolder, TrafficKind, access_list, router_configuration

DEPLOYED = Path(__file__).resolve().parents[3] / "deploy" / "zenoh"
JOB, GUEST = "probe", "guest"
NAMES = (*(role.value for role in Role if role is not Role.ROUTER), GUEST)
"""Who tries everything; the guest has a certificate of the authority, and no role."""
KEYS = tuple(dict.fromkeys(flow.key.replace("**", "job").replace("*", JOB) for flow in TRAFFIC))
WIDE = ("**", "qdgrasp/**", f"qdgrasp/v1/{JOB}/**", f"qdgrasp/v1/{JOB}/rpc/*", "**/@work/**", "**/@result/**")
"""Patterns that no role may use."""


def test_no_rule_goes_over_a_pattern_that_is_wider_than_a_kind_of_traffic() -> None:
    held = {key for rule in access_list()["access_control"]["rules"] for key in rule["key_exprs"]}
    assert held <= {flow.key for flow in TRAFFIC}
    for pattern in map(zenoh.KeyExpr, WIDE):
        assert not [key for key in held if zenoh.KeyExpr(key).includes(pattern)]


def test_every_key_of_the_protocol_stands_in_the_table() -> None:
    job = keys.Keys("mugs")
    members = [getattr(job, name, None) for name in dir(job) if not name.startswith("_")]
    named = [member("1") if callable(member) else member for member in members]
    concrete = [key for key in named if isinstance(key, str) and key.startswith("qdgrasp/v1/mugs/")]
    assert [key for key in concrete if not any(matches(flow.key, key) for flow in TRAFFIC)] == []


def test_the_deployed_configuration_is_what_the_builder_writes_and_zenoh_reads() -> None:
    path, proof = DEPLOYED / "router.json5", Credentials(Path("/etc/qdgrasp/security"), Role.ROUTER)
    assert path.read_text() == router_configuration(proof)
    config = zenoh.Config.from_file(str(path))
    for name, value in session_settings("router", credentials=proof).items():
        assert json.loads(config.get_json(name)) == value, name
    held = json.loads(config.get_json("access_control"))
    written = access_list()["access_control"]["rules"]
    assert held["enabled"]
    assert [rule["id"] for rule in held["rules"]] == [rule["id"] for rule in written]


@dataclass(frozen=True)
class Delivery:
    """A message, answer or token that went from one role to another."""

    key: str
    giver: str
    taker: str


def allowed(kind: TrafficKind) -> set[Delivery]:
    """All deliveries that the table of traffic allows."""
    return {
        Delivery(key, giver, taker)
        for key in KEYS
        for giver in set().union(*(flow.givers for flow in flows(kind, key)))
        for taker in set().union(*(flow.takers for flow in flows(kind, key)))
    }


def flows(kind: TrafficKind, key: str) -> list:
    return [flow for flow in TRAFFIC if flow.kind is kind and matches(flow.key, key)]


def tries(seen: set[Delivery], due: set[Delivery]) -> Iterator[None]:
    """Yield until all that is due was seen, and once more; then wait for what must not come."""
    deadline = time.monotonic() + PATIENCE
    while not due <= seen and time.monotonic() < deadline:
        yield
        time.sleep(0.2)
    yield
    time.sleep(1.0)  # silence is what is tested


@pytest.fixture
def sessions(secured: str, folder: Path, tmp_path: Path) -> Iterator[Callable[[], dict[str, Bus]]]:
    """Opens a session of each role and of the guest; a session would hear itself without a router."""
    proofs = {role.value: Credentials(folder, role) for role in Role}
    proofs[GUEST] = certificate_files(tmp_path / GUEST, SecurityFolder(folder).authority, GUEST)
    with ExitStack() as stack:

        def enter(name: str) -> Bus:
            return stack.enter_context(ZenohBus.connect(secured, PATIENCE, credentials=proofs[name]))

        yield lambda: {name: enter(name) for name in NAMES}


@pytest.mark.slow
def test_a_router_delivers_exactly_what_the_table_allows(sessions) -> None:
    """Every role tries every verb on every key, and on patterns that are wider than its rights."""
    givers, takers, wide = sessions(), sessions(), sessions()
    heard, asked, seen = set[Delivery](), set[Delivery](), set[Delivery]()
    listeners = [(name, bus, KEYS) for name, bus in takers.items()]
    listeners += [(f"{name}, by a wide pattern", bus, WIDE) for name, bus in wide.items()]

    with ExitStack() as stack:
        for taker, bus, patterns in listeners:
            for pattern in patterns:
                take = lambda sample, taker=taker: heard.add(  # noqa: E731
                    Delivery(sample.key, sample.payload.decode(), taker)
                )
                stack.enter_context(bus.subscribe(pattern, take))
        for _ in tries(heard, allowed(TrafficKind.PUT)):
            for giver, bus in givers.items():
                for key in (*KEYS, *WIDE):
                    bus.put(key, giver.encode(), encoding="text/plain")
    assert heard == allowed(TrafficKind.PUT)

    for taker, bus, patterns in listeners:
        with ExitStack() as stack:
            for pattern in patterns:
                stack.enter_context(bus.answer(pattern, lambda _, taker=taker: taker.encode()))
            for _ in tries(asked, {one for one in allowed(TrafficKind.QUERY) if one.taker == taker}):
                for giver, asker in givers.items():
                    for key in (*KEYS, *WIDE):
                        with suppress(NoReply, Refused):
                            asked.add(Delivery(key, giver, asker.ask(key, timeout=1.0).decode()))
    assert asked == allowed(TrafficKind.QUERY)

    for giver, bus in givers.items():
        with ExitStack() as stack:
            for key in KEYS:
                stack.enter_context(bus.token(key))
            for taker, watcher, patterns in listeners:
                for pattern in patterns:
                    note = lambda key, alive, taker=taker, giver=giver: (  # noqa: E731
                        seen.add(Delivery(key, giver, taker)) if alive and key in KEYS else None
                    )
                    stack.enter_context(watcher.watch(pattern, note))
            for _ in tries(seen, {one for one in allowed(TrafficKind.TOKEN) if one.giver == giver}):
                pass
        time.sleep(0.5)  # until these tokens are gone everywhere
    assert seen == allowed(TrafficKind.TOKEN)
