import pytest
from tests.worker.serving import evaluators

from qdgrasp.serving import name_of
from qdgrasp_protocol.errors import InputError


def test_an_evaluator_in_a_package_goes_by_the_name_of_its_module() -> None:
    assert name_of(evaluators.Height) == "tests.worker.serving.evaluators:Height"


def test_an_evaluator_in_a_script_goes_by_its_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluators, "__name__", "__main__")
    assert name_of(evaluators.Height) == f"{evaluators.__file__}:Height"


@pytest.mark.parametrize("evaluator", [evaluators.nested(), lambda scene: evaluators.Height(scene), 3])
def test_an_evaluator_that_no_other_process_finds_is_refused(evaluator: object) -> None:
    with pytest.raises(InputError, match="at the top of a module"):
        name_of(evaluator)  # type: ignore[arg-type]
