"""The access list and the size limits of a router, in zenoh's terms.

Default deny. A router checks what comes in from a session (ingress) and what goes out to it (egress), so
each kind of traffic takes rules on both sides of the router: a publisher must also be told of subscribers,
an asker of who answers. Keys stand in the list one by one: `**` does not match chunks that begin with `@`.
"""

from collections.abc import Iterable
from typing import Any

from qdgrasp_coordinator.security.traffic import TRAFFIC, Traffic, Way
from qdgrasp_protocol.credentials import Role
from qdgrasp_protocol.session import Settings

GIVING = {
    Way.PUT: {"ingress": ["put"], "egress": ["declare_subscriber"]},
    Way.QUERY: {"ingress": ["query"], "egress": ["declare_queryable", "reply"]},
    Way.TOKEN: {"ingress": ["liveliness_token"]},
}
"""What goes in from, and out to, who publishes, asks or is alive."""
TAKING = {
    Way.PUT: {"ingress": ["declare_subscriber"], "egress": ["put"]},
    Way.QUERY: {"ingress": ["declare_queryable", "reply"], "egress": ["query"]},
    Way.TOKEN: {
        "ingress": ["declare_liveliness_subscriber", "liveliness_query"],
        "egress": ["liveliness_token"],
    },
}
"""What goes in from, and out to, who hears, answers or watches."""
RELAYED = {
    Way.PUT: ["put", "declare_subscriber"],
    Way.QUERY: ["query", "reply", "declare_queryable"],
    Way.TOKEN: ["liveliness_token", "liveliness_query", "declare_liveliness_subscriber"],
}
"""What two routers tell each other, in and out."""


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


def _rules(role: Role, flows: tuple[Traffic, ...]) -> list[dict[str, Any]]:
    """The rules of one role."""
    keys: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for flow in flows:
        sides = [GIVING[flow.way]] * (role in flow.givers) + [TAKING[flow.way]] * (role in flow.takers)
        for side in sides:
            for direction, messages in side.items():
                keys.setdefault((direction, tuple(messages)), []).append(flow.key)
    return [
        _rule(f"{role} {direction} {' '.join(messages)}", list(messages), [direction], found)
        for (direction, messages), found in keys.items()
    ]


def _relayed(flows: tuple[Traffic, ...]) -> list[dict[str, Any]]:
    """The rules between routers: whatever one lets in, the other takes from it."""
    return [
        _rule(
            f"{Role.ROUTER} {way}",
            messages,
            ["ingress", "egress"],
            [flow.key for flow in flows if flow.way is way],
        )
        for way, messages in RELAYED.items()
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
