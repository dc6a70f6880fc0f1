"""The digest of code depends on its effect."""

import ast
import builtins
import sys
from collections.abc import Callable
from importlib import import_module
from itertools import count
from pathlib import Path

import pytest

from qdgrasp_worker.engines.bullet import quiet
from qdgrasp_worker.episode import Episode
from qdgrasp_worker.evaluation_protocols import PROTOCOLS
from qdgrasp_worker.platform import EVALUATION
from qdgrasp_worker.priors.surface_priors import ConePrior
from qdgrasp_worker.runtime.simulator_main import SimulatorMain
from qdgrasp_worker.syntax_digest import Key, reached, read, syntax_digest

MAIN = '''"""What is evaluated."""

import numpy as np

from PKG.shapes import SCALE, Ball, moved


def evaluate(x: float) -> float:
    """A number."""
    ball = Ball(x, 2.0)
    if x < 0:
        raise ValueError("negative")
    return np.sin(moved(ball.radius)) * SCALE
'''
SHAPES = '''"""Shapes."""

from dataclasses import dataclass
from math import cos

SCALE, SHIFT = 3.0, 4.0


@dataclass
class Ball:
    """A ball."""

    radius: float
    mass: float


def moved(x: float) -> float:
    # by a step
    return _turned(x) - SHIFT


def _turned(x: float) -> float:
    return cos(x)


def unused() -> int:
    return 1
'''
NUMBERS = count()
Digest = Callable[[str, str], str]


@pytest.fixture
def digest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Digest:
    """The digest of `evaluate` in the first of two modules."""
    monkeypatch.syspath_prepend(tmp_path)

    def found(main: str, shapes: str) -> str:
        package = f"qdgrasp_sample_{next(NUMBERS)}"
        for name, text in (("__init__", ""), ("main", main), ("shapes", shapes)):
            path = tmp_path / package / f"{name}.py"
            path.parent.mkdir(exist_ok=True)
            path.write_text(text.replace("PKG", package))
        entry = import_module(f"{package}.main").evaluate
        for name in [name for name in sys.modules if name.startswith(f"{package}.")]:
            monkeypatch.delitem(sys.modules, name)
        return syntax_digest(entry)

    return found


def changed(*changes: tuple[str, str]) -> list[str]:
    """The two modules with other words in them; each of these is there."""
    texts = [MAIN, SHAPES]
    for old, new in changes:
        assert any(old in text for text in texts)
        texts = [text.replace(old, new) for text in texts]
    return texts


@pytest.mark.parametrize(
    "changes",
    [
        [("A number.", "Another word for it.")],
        [("x: float", "x: int | float")],
        [("negative", "less than none"), ("ValueError", "ArithmeticError")],
        [("import numpy as np", "import numpy as num"), ("np.sin", "num.sin")],
        [("import cos", "import cos as cosine"), ("cos(x)", "cosine(x)")],
        [("    # by a step\n", "")],
        [("_turned", "rotated"), ("moved", "shifted")],
        [("Ball", "Sphere")],
        [("SCALE", "FACTOR")],
        [("return 1", "return 2")],
    ],
)
def test_words_do_not_count_and_neither_does_what_is_not_reached(changes, digest) -> None:
    assert digest(*changed(*changes)) == digest(MAIN, SHAPES)


def test_every_python_reads_code_alike(digest: Digest) -> None:
    """From 3.12 on trees have a field more, from 3.13 on empty ones are left out where they are written."""
    assert digest(MAIN, SHAPES)[:16] == "2d6f57e52d57e23a"


def test_it_does_not_count_where_a_definition_stands(digest: Digest) -> None:
    main, shapes = changed(("from PKG.shapes import SCALE, Ball, moved\n", ""))
    merged = shapes + main.replace("import numpy as np\n", "")
    assert digest("import numpy as np\n" + merged, "") == digest(MAIN, SHAPES)
    assert digest("from PKG.shapes import evaluate", "import numpy as np\n" + merged) == digest(MAIN, SHAPES)


@pytest.mark.parametrize(
    "change",
    [
        ("3.0, 4.0", "3.0, 5.0"),
        ("SCALE, SHIFT = 3.0, 4.0", "SHIFT, SCALE = 3.0, 4.0"),
        ("- SHIFT", "+ SHIFT"),
        ("- SHIFT", "- SCALE"),
        ("np.sin", "np.tan"),
        ("from math import cos", "from numpy import cos"),
        ("x < 0", "x <= 0"),
        ("2.0", "2.5"),
        ("radius: float\n    mass: float", "mass: float\n    radius: float"),
        ("radius: float", "radius: int"),
        ("moved(ball", "_turned(ball"),
    ],
)
def test_what_is_computed_counts(change: tuple[str, str], digest: Digest) -> None:
    main, shapes = changed(change)
    imports = MAIN.replace("Ball, moved", "Ball, _turned, moved"), SHAPES
    assert digest(main.replace("Ball, moved", "Ball, _turned, moved"), shapes) != digest(*imports)


def test_definitions_that_differ_only_in_what_they_reach_are_told_apart(digest: Digest) -> None:
    text = "def evaluate(): return a() - b()\n\ndef a(): return c()\n\ndef b(): return d()\n\n"
    text += "def c(): return 1\n\ndef d(): return 2\n\n"
    assert digest(text, "") != digest(text.replace("a() - b()", "b() - a()"), "")


def test_what_a_function_calls_its_own_is_no_definition(digest: Digest) -> None:
    text = "def evaluate(size): return size\n\ndef size(): return "
    assert digest(text + "1", "") == digest(text + "2", "")


def test_definitions_may_reach_each_other(digest: Digest) -> None:
    text = "def evaluate(n): return other(n)\n\ndef other(n): return n and evaluate(n - 1)\n\n"
    assert digest(text, "") == digest(text.replace("other", "another"), "")
    assert digest(text, "") != digest(text.replace("n - 1", "n - 2"), "")


def test_an_evaluation_reaches_what_evaluates_and_not_what_serves_it() -> None:
    found = reached(*EVALUATION)
    assert {Key(each.__module__, each.__name__) for each in (Episode, ConePrior)} <= found.keys()
    assert any(PROTOCOLS is vars(import_module(key.module)).get(key.name) for key in found)
    assert Key(SimulatorMain.__module__, SimulatorMain.__name__) not in found


def test_every_name_that_an_evaluation_uses_is_known() -> None:
    strange = {(key, name) for key, one in reached(*EVALUATION).items() for name in one.unknown}
    assert {each for each in strange if not hasattr(builtins, each[1])} == set()


def test_modules_that_evaluate_only_define_and_import() -> None:
    for module in {key.module for key in reached(*EVALUATION)}:
        for statement in read(module).others:
            if isinstance(statement, ast.With):  # Bullet prints when it is loaded
                assert ast.unparse(statement.items[0]) == f"{quiet.__name__}()"
            parts = statement.body if isinstance(statement, ast.With | ast.If) else [statement]
            assert all(isinstance(one, ast.Import | ast.ImportFrom | ast.Expr) for one in parts)
