"""A gripper's file as text: its lines, each kind under the reason why it is so."""

import json
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from msgspec import UNSET, Struct, structs

from qdgrasp_assets.hands.draft import Draft

WIDTH = 108
HEAD = """\
What `qdgrasp gripper new` guessed of '{urdf}': look at each line, and change what is not so.
What the keys mean: docs/grippers.md.
After a change: qdgrasp gripper check {name} --picture pictures"""
PLAIN = ("licence", "base_link", "approach_axis", "palm_offset", "standoff", "finger_links")
UNITS = {
    "palm_offset": "[m]",
    "standoff": "[m]",
}


def toml(draft: Draft, name: str) -> str:
    """The text of a gripper's TOML file that will be called `name`."""
    file, reasons = draft.file, draft.reasons
    lines = [*_comment(HEAD.format(urdf=file.urdf, name=name)), f"urdf = {_value(file.urdf)}"]
    for key in PLAIN:
        lines += ["", *_comment(_reason(key, reasons)), f"{key} = {_value(getattr(file, key))}"]
    if file.jaw is not None:
        lines += ["", *_comment(reasons["jaw"]), "[jaw]", *_table(file.jaw)]
    for joint, table in file.joints.items():
        lines += [
            "",
            *_comment(reasons.get(f"joints.{joint}", "")),
            f"[joints.{_key(joint)}]",
            *_table(table),
        ]
    for number, synergy in enumerate(file.synergies):
        lines += ["", *(() if number else _comment(reasons["synergies"])), "[[synergies]]", *_table(synergy)]
    for number, (joint, free) in enumerate(file.free_joints.items()):
        lines += ["", *(() if number else _comment(reasons["free_joints"]))]
        lines += [f"[free_joints.{_key(joint)}]", *_table(free)]
    return "\n".join(lines) + "\n"


def _reason(key: str, reasons: Mapping[str, str]) -> str:
    return " ".join(word for word in (reasons[key], UNITS.get(key)) if word)


def _comment(text: str) -> Iterator[str]:
    for line in text.splitlines():
        yield from (f"# {part}" for part in textwrap.wrap(line, WIDTH))


def _table(table: Struct) -> Iterator[str]:
    """The lines of a table, those left out that are as they are by default."""
    for field in structs.fields(table):
        value = getattr(table, field.name)
        if field.default is UNSET or value != field.default:
            yield f"{field.name} = {_value(value)}"


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Iterable):
        return _list([_value(each) for each in value])
    return repr(round(float(value), 6) + 0.0)


def _list(values: list[str]) -> str:
    short = f"[{', '.join(values)}]"
    return short if len(short) < WIDTH else "".join(["[\n", *(f"  {value},\n" for value in values), "]"])


def _key(name: str) -> str:
    """A key as TOML writes it."""
    is_bare = all(letter.isascii() and (letter.isalnum() or letter in "-_") for letter in name)
    return name if is_bare and name else json.dumps(name, ensure_ascii=False)
