"""Access lists and size limits of routers, made from one table of traffic.

The table says which role gives and takes which kind of message. A zenoh configuration for each role follows
from it: for `zenohd`, `qdgrasp-router` and zenoh's own tools.
"""

from collections.abc import Iterator, Set
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from qdgrasp_protocol import session
from qdgrasp_protocol.keys import AnyJob, patterns_intersect
from qdgrasp_protocol.messages import MAX_PAYLOAD
from qdgrasp_protocol.session import PORT, Credentials, Endpoint, Role, session_settings

JOBS = AnyJob()
KIB, MIB = 1 << 10, 1 << 20
COORDINATOR, RECORDER, WORKER = Role.COORDINATOR, Role.RECORDER, Role.WORKER
MONITORING = frozenset({Role.MONITOR, Role.ADMIN})


class TrafficKind(StrEnum):
    """The kind of exchange on a key."""

    PUT = "put"  # One side publishes, the other subscribes
    QUERY = "query"  # One side asks, the other answers
    TOKEN = "token"  # noqa: S105  # One side is alive, the other watches


PUT, QUERY, TOKEN = TrafficKind


@dataclass(frozen=True)
class Traffic:
    """One kind of traffic."""

    kind: TrafficKind
    key: str  # A pattern over the keys of all jobs
    givers: Set[Role]  # Roles that publish, ask, or are alive
    takers: Set[Role]  # Roles that subscribe, answer, or watch
    limit: int = 0  # The most bytes of a message or question
    answer_limit: int = 0  # The most bytes of an answer


TRAFFIC = (
    Traffic(PUT, JOBS.work("*"), {COORDINATOR}, {WORKER}, 4 * MIB),
    Traffic(PUT, JOBS.ctl("*"), {COORDINATOR}, {WORKER}, 256 * KIB),
    Traffic(PUT, JOBS.result(), {WORKER}, {COORDINATOR}, MAX_PAYLOAD),
    Traffic(PUT, JOBS.outcome(), {COORDINATOR}, {RECORDER}, 8 * MIB),
    Traffic(PUT, JOBS.recorded, {RECORDER}, {COORDINATOR}, 4 * KIB),
    Traffic(PUT, JOBS.stat("worker/*"), {WORKER}, {COORDINATOR}, 64 * KIB),
    Traffic(PUT, JOBS.stat("job"), {COORDINATOR}, set(), 256 * KIB),
    Traffic(PUT, JOBS.stat("run/*"), {COORDINATOR}, set(), 256 * KIB),
    Traffic(PUT, JOBS.stat("team/*"), {COORDINATOR}, set(), 256 * KIB),
    Traffic(PUT, JOBS.stat(), set(), MONITORING, 256 * KIB),
    Traffic(PUT, JOBS.meta, {COORDINATOR}, MONITORING, 256 * KIB),
    Traffic(PUT, JOBS.event(), {COORDINATOR}, MONITORING, 16 * KIB),
    Traffic(QUERY, JOBS.stat(), MONITORING, {COORDINATOR}, 4 * KIB, MIB),
    Traffic(QUERY, JOBS.meta, MONITORING, {COORDINATOR}, 4 * KIB, MIB),
    Traffic(QUERY, JOBS.recent, MONITORING, {COORDINATOR}, 4 * KIB, MIB),
    Traffic(QUERY, JOBS.entries, MONITORING, {RECORDER}, 4 * KIB, MIB),
    Traffic(QUERY, JOBS.objects, MONITORING, {RECORDER}, 4 * KIB, MIB),
    Traffic(QUERY, JOBS.finds, MONITORING, {RECORDER}, 4 * KIB, 2 * MIB),
    Traffic(QUERY, JOBS.recorded_asset(), MONITORING, {RECORDER}, 4 * KIB, MIB),
    Traffic(QUERY, JOBS.join, {WORKER}, {COORDINATOR}, 256 * KIB, 256 * KIB),
    Traffic(QUERY, JOBS.control, {Role.ADMIN}, {COORDINATOR}, 4 * KIB, 16 * KIB),
    Traffic(QUERY, JOBS.asset(), {WORKER, RECORDER}, {COORDINATOR}, 4 * KIB, MIB),
    Traffic(QUERY, JOBS.open, {COORDINATOR}, {RECORDER}, MAX_PAYLOAD, 256 * KIB),
    Traffic(QUERY, JOBS.log, {COORDINATOR}, {RECORDER}, 4 * KIB, 8 * MIB),
    Traffic(TOKEN, JOBS.coordinator_token(), {COORDINATOR}, {COORDINATOR, WORKER, Role.MONITOR}),
    Traffic(TOKEN, JOBS.worker_token(), {WORKER}, {COORDINATOR, Role.MONITOR}),
    Traffic(TOKEN, JOBS.recorder_token(), {RECORDER}, {COORDINATOR, Role.MONITOR}),
)
"""All traffic (docs/bus.md, keys)."""
GIVEN = {PUT: ["put"], QUERY: ["query"], TOKEN: ["liveliness_token"]}
"""Zenoh messages of the giving side: ingress from it, egress to the takers."""
TAKEN = {
    PUT: ["declare_subscriber"],
    QUERY: ["declare_queryable", "reply"],
    TOKEN: ["declare_liveliness_subscriber", "liveliness_query"],
}
"""Zenoh messages of the taking side: ingress from it, egress to the givers."""


def access_list() -> session.ZenohSettings:
    """Return the access list and the size limits of a router's configuration."""
    rules = {role: list(_rules(role)) for role in Role}
    return {
        "access_control": {
            "enabled": True,
            "default_permission": "deny",
            "rules": [rule for of_role in rules.values() for rule in of_role],
            "subjects": [{"id": role.value, "cert_common_names": [role.common_name]} for role in Role],
            "policies": [
                {"rules": [rule["id"] for rule in of_role], "subjects": [role.value]}
                for role, of_role in rules.items()
            ],
        },
        "low_pass_filter": [limit for flow in TRAFFIC for limit in _limits(flow)],
    }


def _rules(role: Role) -> Iterator[dict[str, Any]]:
    """Yield the rules of one role: what it sends, and what it gets from the other side."""
    for kind in TrafficKind:
        flows = [flow for flow in TRAFFIC if flow.kind is kind]
        if role is Role.ROUTER:  # a router takes from another one all that this lets in
            both, keys = ["ingress", "egress"], [flow.key for flow in flows]
            yield _rule(f"{role} relays ({kind})", GIVEN[kind] + TAKEN[kind], both, keys)
            continue
        given = [flow.key for flow in flows if role in flow.givers]
        taken = [flow.key for flow in flows if role in flow.takers]
        heard = [flow.key for flow in flows if flow.takers]
        takers = [key for key in heard if any(patterns_intersect(key, each) for each in given)]
        sides = (
            ("gives", GIVEN[kind], "ingress", given),
            ("is taken from", TAKEN[kind], "egress", takers),
            ("takes", TAKEN[kind], "ingress", taken),
            ("is given", GIVEN[kind], "egress", taken),
        )
        for side, messages, direction, keys in sides:
            if keys:
                yield _rule(f"{role} {side} ({kind})", messages, [direction], keys)


def _rule(name: str, messages: list[str], directions: list[str], keys: list[str]) -> dict[str, Any]:
    return {
        "id": name,
        "messages": messages,
        "flows": directions,
        "permission": "allow",
        "key_exprs": list(dict.fromkeys(keys)),
    }


def _limits(flow: Traffic) -> list[dict[str, Any]]:
    sizes = {GIVEN[flow.kind][0]: flow.limit, "reply": flow.answer_limit}
    return [
        {
            "id": f"{message} {flow.key}",
            "messages": [message],
            "flows": ["ingress", "egress"],
            "key_exprs": [flow.key],
            "size_limit": size,
        }
        for message, size in sizes.items()
        if size
    ]


LISTEN_EVERYWHERE = "0.0.0.0"  # noqa: S104  # links are encrypted, and both sides show certificates
ROUTER_TEMPLATE = """\
A router of qdgrasp: `zenohd -c router.json5` or `qdgrasp-router --security DIR` reads it.
Written by `qdgrasp security init`: mutual TLS, and whatever is not allowed here is denied.
"""
CLIENT_TEMPLATE = """\
A session with the rights of the {role}, for zenoh's own tools: `z_sub -c {role}.json5 -k KEY`.
Written by `qdgrasp security init`; the commands of qdgrasp need only `--security DIR`.
"""


def role_configuration(credentials: Credentials, host: str) -> str:
    """Return the configuration file of a role; clients reach the router at `host`."""
    if credentials.role is Role.ROUTER:
        here = Endpoint.parse(f"tls/{LISTEN_EVERYWHERE}:{PORT}")
        chosen = session_settings("router", listen=[here], credentials=credentials)
        return session.to_json5(chosen | access_list(), ROUTER_TEMPLATE)
    there = Endpoint.parse(f"tls/{f'[{host}]' if ':' in host else host}:{PORT}")
    chosen = session_settings("client", connect=[there], credentials=credentials, seconds=10.0)
    return session.to_json5(chosen, CLIENT_TEMPLATE.format(role=credentials.role))
