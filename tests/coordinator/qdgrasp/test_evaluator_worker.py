from typing import Any

import pytest
from tests.worker.runtime import evaluators

import qdgrasp
from qdgrasp.evaluator_worker import evaluator_name
from qdgrasp_protocol.errors import InputError


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
