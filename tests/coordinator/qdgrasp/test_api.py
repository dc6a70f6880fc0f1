"""What `import qdgrasp` gives, and when it is loaded."""

import ast
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from tests.worker.runtime import evaluators

import qdgrasp
from qdgrasp.evaluator_worker import evaluator_name
from qdgrasp_protocol.errors import InputError

SOURCE = ast.parse(Path(qdgrasp.__file__).read_text())


def run(code: str) -> list[str]:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    return done.stdout.split()


def test_nothing_is_loaded_before_it_is_used() -> None:
    loaded = run("import sys; before = set(sys.modules); import qdgrasp; print(*(set(sys.modules) - before))")
    assert {name.partition(".")[0] for name in loaded} <= {"qdgrasp", *sys.stdlib_module_names}
    assert "qdgrasp.evaluations" not in loaded


def test_a_run_is_read_without_a_bus_or_a_simulator() -> None:
    loaded = run("import sys, qdgrasp; qdgrasp.open; print(*sys.modules)")
    assert "numpy" in loaded
    assert not {"zenoh", "pybullet"} & set(loaded)


def test_what_a_type_checker_sees_is_what_there_is() -> None:
    seen = {
        alias.name: node.module
        for block in SOURCE.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == qdgrasp.HOMES
    assert set(qdgrasp.__all__) == {*seen, "__version__"}


@pytest.mark.parametrize("name", sorted(qdgrasp.HOMES))
def test_every_name_is_there_with_a_word_about_it(name: str) -> None:
    found = getattr(qdgrasp, name)
    assert found is getattr(qdgrasp, name)
    if callable(found) and getattr(found, "__module__", "").startswith("qdgrasp"):
        assert found.__doc__


def test_the_version_is_the_packages() -> None:
    assert qdgrasp.__version__ == version("qdgrasp")


def test_a_name_that_is_not_there_is_answered_with_those_that_are() -> None:
    with pytest.raises(AttributeError, match=r"has no attribute 'grasp'; it has Evaluations, .*optimise"):
        qdgrasp.grasp  # type: ignore[attr-defined]  # noqa: B018


def test_an_evaluator_in_a_package_goes_by_the_name_of_its_module() -> None:
    assert evaluator_name(evaluators.Height) == "tests.worker.runtime.evaluators:Height"


def test_an_evaluator_in_a_script_goes_by_its_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluators, "__name__", "__main__")
    assert evaluator_name(evaluators.Height) == f"{evaluators.__file__}:Height"


@pytest.mark.parametrize("evaluator", [evaluators.nested(), lambda scene: evaluators.Height(scene), 3])
def test_an_evaluator_that_no_other_process_finds_is_refused(evaluator: object) -> None:
    with pytest.raises(InputError, match="at the top of a module"):
        evaluator_name(evaluator)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"workers": -1}, "serve: workers must be a whole number, at least 1, got -1"),
        ({"workers": 1.5}, "serve: workers must be a whole number"),
        ({"connect": 7447}, "serve: connect must be text"),
        ({"connect": "here"}, "'here' is not an endpoint"),
        ({"job": 3}, "serve: job must be text"),
        ({"security": 3}, "serve: security must be a path"),
        ({"row_seconds": 0}, "serve: row_seconds must be seconds, at least 0.1, got 0"),
        ({"wait": "long"}, "serve: wait must be seconds, at least 0"),
        ({"wait": float("nan")}, "serve: wait must be seconds"),
    ],
)
def test_how_it_cannot_be_served_is_refused(said: dict[str, Any], why: str) -> None:
    with pytest.raises(InputError, match=why):
        qdgrasp.serve(evaluators.Height, **said)
