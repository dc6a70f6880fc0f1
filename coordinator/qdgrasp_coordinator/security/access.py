"""The access list and the size limits of a router, in zenoh's terms.

Default deny. A router checks what comes in from a session (ingress) and what goes out to it (egress), so
each kind of traffic takes rules on both sides of the router: a publisher must also be told of subscribers,
an asker of who answers. Keys stand in the list one by one: `**` does not match chunks that begin with `@`.
"""

from collections.abc import Iterable, Sequence
from typing import Any

from qdgrasp_coordinator.security.traffic import TRAFFIC, Traffic, Way
from qdgrasp_protocol.credentials import Role
from qdgrasp_protocol.keys import meet
from qdgrasp_protocol.session import Settings

GIVEN = {Way.PUT: ["put"], Way.QUERY: ["query"], Way.TOKEN: ["liveliness_token"]}
"""What comes in from who publishes, asks or is alive; and goes out to the other side."""
TAKEN = {
    Way.PUT: ["declare_subscriber"],
    Way.QUERY: ["declare_queryable", "reply"],
    Way.TOKEN: ["declare_liveliness_subscriber", "liveliness_query"],
}
"""What comes in from who hears, answers or watches; and goes out to the other side."""


def access_list(traffic: Iterable[Traffic] = TRAFFIC) -> Settings:
    """The access list and the size limits that a router's configuration holds."""
    flows = tuple(traffic)
    rules = [
        rule for role in Role for rule in (_relayed(flows) if role is Role.ROUTER else _rules(role, flows))
    ]
    return {
        "access_control": {
            "enabled": True,
            "default_permission": "deny",
            "rules": rules,
            "subjects": [{"id": role.value, "cert_common_names": [role.common_name]} for role in Role],
            "policies": [
                {
                    "rules": [rule["id"] for rule in rules if _owner(rule) == role.value],
                    "subjects": [role.value],
                }
                for role in Role
            ],
        },
        "low_pass_filter": [limit for flow in flows for limit in _limits(flow)],
    }


def _rules(role: Role, flows: Sequence[Traffic]) -> list[dict[str, Any]]:
    """The rules of one role: what it gives and takes, and what it is told of the other side."""
    return [rule for way in Way for rule in _rules_of(role, way, [flow for flow in flows if flow.way is way])]


def _rules_of(role: Role, way: Way, flows: Sequence[Traffic]) -> list[dict[str, Any]]:
    given = [flow.key for flow in flows if role in flow.givers]
    taken = [flow.key for flow in flows if role in flow.takers]
    takers = [flow.key for flow in flows if flow.takers and any(meet(flow.key, key) for key in given)]
    sides = (
        ("gives", GIVEN[way], "ingress", given),
        ("is taken from", TAKEN[way], "egress", takers),
        ("takes", TAKEN[way], "ingress", taken),
        ("is given", GIVEN[way], "egress", taken),
    )
    return [
        _rule(f"{role} {side} ({way})", messages, [direction], keys)
        for side, messages, direction, keys in sides
        if keys
    ]


def _relayed(flows: Sequence[Traffic]) -> list[dict[str, Any]]:
    """The rules between routers: whatever one lets in, the other takes from it."""
    return [
        _rule(
            f"{Role.ROUTER} relays ({way})",
            GIVEN[way] + TAKEN[way],
            ["ingress", "egress"],
            [flow.key for flow in flows if flow.way is way],
        )
        for way in Way
    ]


def _rule(name: str, messages: list[str], directions: list[str], keys: list[str]) -> dict[str, Any]:
    return {
        "id": name,
        "messages": messages,
        "flows": directions,
        "permission": "allow",
        "key_exprs": list(dict.fromkeys(keys)),
    }


def _owner(rule: dict[str, Any]) -> str:
    return str(rule["id"]).partition(" ")[0]


def _limits(flow: Traffic) -> list[dict[str, Any]]:
    """How large a message may be on a key, as published or asked and as answered."""
    sizes = {
        Way.PUT: [("put", flow.limit)],
        Way.QUERY: [("query", flow.limit), ("reply", flow.answer_limit)],
        Way.TOKEN: [],
    }[flow.way]
    return [
        {
            "id": f"{message} {flow.key}",
            "messages": [message],
            "flows": ["ingress", "egress"],
            "key_exprs": [flow.key],
            "size_limit": size,
        }
        for message, size in sizes
    ]
