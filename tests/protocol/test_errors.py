"""The family of errors: all of it stands in the tree with which `errors.py` begins."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from qdgrasp_protocol import errors

ROOT = "QdgraspError"
ROOMS = [Path(__file__).parents[2] / room for room in ("protocol", "assets", "worker", "coordinator")]
STEP = 4
"""Spaces by which a child stands further in."""

Parents = dict[str, str]
"""By the name of an error, that of what it is a kind of."""


def told() -> Parents:
    """The tree at the head of the module."""
    found, line = {}, [""]
    for indent, name in re.findall(r"^( *)\* (\w+)", errors.__doc__ or "", re.MULTILINE):
        depth = len(indent) // STEP
        assert depth < len(line), f"{name} stands too far in"
        found[name] = line[depth]
        line[depth + 1 :] = [name]
    return found


def defined() -> Parents:
    """The errors that are defined in the sources, in any module."""
    classes = [one for room in ROOMS for path in room.rglob("*.py") for one in classes_in(path)]
    family = {ROOT: ""}
    while found := {name: base for name, base in classes if base in family and name not in family}:
        family |= found
    return family


def classes_in(path: Path) -> Iterator[tuple[str, str]]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ClassDef):
            yield from ((node.name, base.id) for base in node.bases if isinstance(base, ast.Name))


def test_the_tree_has_every_error_where_it_belongs() -> None:
    assert told() == defined()
