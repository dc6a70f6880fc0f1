"""The links and joints of a URDF as one tree: every way in which they are not, in words."""

import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterable, Iterator

from qdgrasp_protocol.phrases import few, quoted

MEASURES = frozenset(
    ("xyz", "rpy", "size", "scale", "radius", "length", "lower", "upper", "effort", "velocity", "value")
)
"""Attributes that hold numbers of which something is made."""
ENDLESS = frozenset(("nan", "inf", "infinity"))
MOST_NAMED = 4
"""So many names are told of each fault."""


def structure_faults(element: ET.Element) -> tuple[str, ...]:
    """What keeps the links and joints of a `<robot>` from being one tree; empty when nothing does."""
    return (*_names(element), *_ends(element), *_tree(element), *_numbers(element))


def _names(element: ET.Element) -> Iterator[str]:
    for kind in ("link", "joint"):
        names = Counter(each.get("name", "") for each in element.findall(kind))
        if names.pop("", 0):
            yield f"a {kind} has no name; give each its own"
        twice = [name for name, times in names.items() if times > 1]
        if twice:
            yield f"{listed(kind, twice)} named more than once; give each its own name"
    if element.find("link") is None:
        yield "it has no links"


def _ends(element: ET.Element) -> Iterator[str]:
    """Joints between links that are not there."""
    links = {link.get("name", "") for link in element.findall("link")}
    for joint in element.findall("joint"):
        for tag in ("parent", "child"):
            end = joint.find(tag)
            name = "" if end is None else end.get("link", "")
            if name not in links:
                told = (
                    f"names the {tag} link '{name}', which does not exist" if name else f"has no {tag} link"
                )
                yield f"the joint '{joint.get('name', '')}' {told}; correct the name or add the link"


def _tree(element: ET.Element) -> Iterator[str]:
    """Links that hang on two joints, on none, or on each other."""
    links = [link.get("name", "") for link in element.findall("link")]
    hanging = Counter(child for _, child in edges(element))
    twice = [name for name, times in hanging.items() if times > 1]
    if twice:
        yield (
            f"{listed('link', twice)} the child of two joints: it closes a loop, which neither URDF nor the "
            "simulator knows; cut the loop by leaving one of the joints out, and drive the rest alike"
        )
    roots = [name for name in links if name not in hanging]
    if len(roots) > 1:
        yield (
            f"it has {len(roots)} roots ({_few(roots)}), and a URDF has one: join them by fixed joints, "
            "or leave out what is no part of the robot"
        )
    round_about = sorted(set(links) - _reached(element, roots))
    if round_about:
        yield f"{listed('link', round_about)} carried by itself in a circle of joints; cut the circle"


def _numbers(element: ET.Element) -> Iterator[str]:
    """Numbers that are none, which `float` takes for some."""
    for each in element.iter():
        for name, value in each.attrib.items():
            if name in MEASURES and any(word.lower().lstrip("+-") in ENDLESS for word in value.split()):
                yield f'<{each.tag} {name}="{value}"> holds a number that is not finite; correct it'


def _reached(element: ET.Element, roots: Iterable[str]) -> set[str]:
    """The links that hang on the roots."""
    outward, reached = list(edges(element)), set(roots)
    while found := {child for parent, child in outward if parent in reached} - reached:
        reached |= found
    return reached


def edges(element: ET.Element) -> Iterator[tuple[str, str]]:
    """The parent and child link of each joint; empty where it names none."""
    for joint in element.findall("joint"):
        yield _end(joint, "parent"), _end(joint, "child")


def _end(joint: ET.Element, which: str) -> str:
    end = joint.find(which)
    return "" if end is None else end.get("link", "")


def listed(kind: str, names: list[str]) -> str:
    """Names with their kind and its verb: "the link 'a' is", "the links 'a', 'b' are"."""
    many = len(names) > 1
    return f"the {kind}{'s' if many else ''} {_few(names)} {'are' if many else 'is'}"


def _few(names: list[str]) -> str:
    return few(quoted(names), MOST_NAMED)
