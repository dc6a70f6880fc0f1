"""Numbers as shortest decimals, and YAML: written word by word, read without trust."""

import json
import re
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qdgrasp_tools.export.frames import Frame
from qdgrasp_tools.export.grasp_set import Grasps
from qdgrasp_tools.export.imported_grasps import LONGEST, UnreadableGrasps

DecimalLines = list[list[str]]  # Numbers of a table as text, line by line


def table_decimals(table: NDArray[np.floating]) -> DecimalLines:
    """Write a table (n, k) as decimals, line by line."""
    flat, width = shortest_decimals(table.ravel()), table.shape[1]
    return (
        [flat[start : start + width] for start in range(0, len(flat), width)] if width else [[]] * len(table)
    )


def shortest_decimals(numbers: NDArray[np.floating]) -> list[str]:
    """Write numbers (n,) as the shortest decimals that give them back, in their precision.

    Always with a point and never with an exponent: `1e-05` is a word, not a number, to readers of YAML 1.1.
    """
    words: list[str]
    if find_spec("pyarrow"):  # the same words, in less time
        import pyarrow as pa

        words = pa.array(np.ascontiguousarray(numbers)).cast(pa.string()).to_pylist()
    else:
        words = [str(number) for number in numbers]
    return [word if "." in word and "e" not in word else _without_exponent(word) for word in words]


def grasp_decimals(
    grasps: Grasps, frame: Frame
) -> Iterator[tuple[int, str, tuple[list[str], list[str]], tuple[list[str], list[str]]]]:
    """Yield number, confidence, grasp and pregrasp of each grasp as decimals.

    The grasp is the settled pose and the joints after closing, the pregrasp the commanded pose and the joints
    before it.
    """
    confidences = [words for (words,) in table_decimals(grasps.confidence[:, None])]
    pairs = (grasps.settled_poses(frame), grasps.joints), (grasps.poses(frame), grasps.pregrasp)
    grasp, pregrasp = (
        zip(table_decimals(poses), table_decimals(joints), strict=True) for poses, joints in pairs
    )
    return zip(grasps.numbers.tolist(), confidences, grasp, pregrasp, strict=True)


def _without_exponent(word: str) -> str:
    """Rewrite a word that has an exponent, or no point."""
    if "e" in word:
        return np.format_float_positional(float(word), trim="0")
    return f"{word}.0" if word[-1].isdecimal() else word  # nan and inf


PLAIN_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_.-]*")
RESERVED_WORDS = {"true", "false", "yes", "no", "on", "off", "null", "y", "n"}
DEEPEST = 16  # Levels of lists and mappings in a file that is read
LARGEST_YAML = 1 << 28  # Bytes of a file that is read

Tree = str | list["Tree"] | dict[str, "Tree"]  # Content of a file; every number is still a word


def yaml_word(name: str) -> str:
    """Write a word as YAML has it, quoted where it must be."""
    is_plain = PLAIN_WORD.fullmatch(name) and name.lower() not in RESERVED_WORDS
    return name if is_plain else json.dumps(name, ensure_ascii=False)


def yaml_block(values: dict[str, Any]) -> str:
    """Write a mapping as YAML; lists of numbers in one line, texts of several lines as such."""
    import yaml

    class Dumper(yaml.SafeDumper):
        """Dumps lists of numbers in one line, and texts of several lines as blocks."""

    def sequence(dumper: yaml.SafeDumper, values: Any) -> yaml.SequenceNode:
        is_plain = not any(isinstance(value, dict | str) for value in values)
        return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=is_plain)

    def text(dumper: yaml.SafeDumper, value: str) -> yaml.ScalarNode:
        style = "|" if "\n" in value else None
        return dumper.represent_scalar("tag:yaml.org,2002:str", value, style=style)

    Dumper.add_representer(str, text)
    Dumper.add_representer(list, sequence)
    Dumper.add_representer(tuple, sequence)
    written = yaml.dump(
        values, Dumper=Dumper, sort_keys=False, allow_unicode=True, width=1 << 20, default_flow_style=False
    )
    return str(written)


def read_yaml(path: Path) -> Tree:
    """Read a YAML file of one document; every number stays a word.

    Aliases are refused, since a small file of them can stand for a huge one, and so are tags: nothing in it
    is ever made into an object.
    """
    import yaml

    try:
        if path.stat().st_size > LARGEST_YAML:
            raise UnreadableGrasps(path, f"it is larger than {LARGEST_YAML >> 20} MiB")
        with path.open("rb") as file:
            return _build_tree(path, yaml.parse(file, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)))
    except OSError as error:
        raise UnreadableGrasps(path, error.strerror or str(error)) from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        problem = str(getattr(error, "problem", None) or error)
        if "nesting depth" in problem:  # libyaml has a bound of its own
            raise _nested_too_deep(path) from None
        mark = getattr(error, "problem_mark", None)
        where = f"line {mark.line + 1}: " if mark else ""
        raise UnreadableGrasps(path, f"it is not YAML ({where}{problem})") from None


def _nested_too_deep(path: Path) -> UnreadableGrasps:
    return UnreadableGrasps(path, f"it is nested more than {DEEPEST} levels deep")


def _build_tree(path: Path, events: Iterator[Any]) -> Tree:
    import yaml

    values = (yaml.ScalarEvent, yaml.MappingStartEvent, yaml.SequenceStartEvent)
    whole: list[Tree] = []
    open_: list[tuple[Tree, list[str]]] = [(whole, [])]
    for event in events:
        kind = type(event)  # by far the most are scalars, and there are millions of them
        if kind is yaml.AliasEvent or (kind in values and (event.anchor or event.tag)):
            raise UnreadableGrasps(
                path, f"line {event.start_mark.line + 1}: anchors, aliases and tags are not read"
            )
        if kind is yaml.ScalarEvent:
            _add_value(path, open_[-1], event.value, event)
        elif kind is yaml.MappingStartEvent or kind is yaml.SequenceStartEvent:
            made: Tree = {} if kind is yaml.MappingStartEvent else []
            _add_value(path, open_[-1], made, event)
            open_.append((made, []))
            if len(open_) > DEEPEST:
                raise _nested_too_deep(path)
        elif kind is yaml.MappingEndEvent or kind is yaml.SequenceEndEvent:
            open_.pop()
    if len(whole) != 1:
        raise UnreadableGrasps(path, f"it must be one YAML document, and is {len(whole)}")
    return whole[0]


def _add_value(path: Path, parent: tuple[Tree, list[str]], value: Tree, event: Any) -> None:
    """Add a value where it belongs; in a mapping every other one is a key."""
    holder, key = parent
    if isinstance(holder, list):
        holder.append(value)
    elif not key and isinstance(value, str):
        if len(value) > LONGEST:
            raise UnreadableGrasps(
                path, f"line {event.start_mark.line + 1}: a name is longer than {LONGEST} letters"
            )
        key.append(value)
    elif not key:
        raise UnreadableGrasps(path, f"line {event.start_mark.line + 1}: a key must be a word")
    elif key[0] in holder:
        raise UnreadableGrasps(path, f"line {event.start_mark.line + 1}: '{key[0]}' stands there twice")
    else:
        holder[key.pop()] = value  # type: ignore[index]  # the holder of keys is a mapping
