"""Nothing that is read can run: no module unpickles, evaluates, or unpacks without limits."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("assets", "coordinator", "protocol", "worker")
MODULES = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]
RUN_WHAT_THEY_READ = {"pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve", "yaml"}
UNPACKERS = {"codec.py", "scene.py"}
YAML = "yaml_text.py"
"""The one module that reads YAML: as events, of which it makes lists, mappings and words."""


def calls(path: Path) -> Iterator[tuple[str, ast.Call]]:
    """The calls in a module, by the last name of what is called."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            yield name, node


def imported(path: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        if isinstance(node, ast.ImportFrom):
            found.add((node.module or "").partition(".")[0])
    return found


@pytest.mark.parametrize("room", ROOMS)
def test_no_module_imports_what_runs_what_it_reads(room: str) -> None:
    modules = [path for path in MODULES if path.is_relative_to(ROOT / room)]
    assert len(modules) > 5
    assert [path for path in modules if imported(path) & RUN_WHAT_THEY_READ and path.name != YAML] == []


def test_yaml_is_parsed_and_never_loaded() -> None:
    (module,) = (path for path in MODULES if path.name == YAML)
    assert imported(module) & RUN_WHAT_THEY_READ == {"yaml"}
    names = {name for name, node in calls(module) if ast.unparse(node.func).startswith("yaml.")}
    assert "parse" in names
    assert names <= {"parse", "dump", "ScalarEvent", "MappingStartEvent", "SequenceStartEvent",
                     "MappingEndEvent", "SequenceEndEvent"}  # fmt: skip


def test_nothing_is_evaluated() -> None:
    built_in = [
        (path.name, node.func.id)
        for path in MODULES
        for _, node in calls(path)
        if isinstance(node.func, ast.Name) and node.func.id in {"eval", "exec", "compile", "__import__"}
    ]
    assert built_in == []


def test_arrays_are_loaded_without_pickles() -> None:
    loads = [
        node
        for path in MODULES
        for name, node in calls(path)
        if name == "load" and isinstance(node.func, ast.Attribute) and ast.unparse(node.func.value) == "np"
    ]
    assert len(loads) >= 2
    for node in loads:
        said = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
        assert said.get("allow_pickle") == "False"


def test_two_modules_unpack_and_both_say_how_much() -> None:
    found = [
        (path.name, node) for path in MODULES for name, node in calls(path) if name in {"unpackb", "Unpacker"}
    ]
    assert {name for name, _ in found} == UNPACKERS
    assert all(node.keywords for _, node in found)
