"""The conventions are checked: each violation that is planted in a small tree is found."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from tests import conventions
from tests.conventions import Repository, Violation

PLAIN = '"""Leases of batches."""\n\n\nclass Lease:\n    """A batch that a worker holds for a time."""\n'
LONG = '"""Numbers."""\n' + "x = 1\n" * 600


@pytest.fixture
def plant(tmp_path: Path) -> Callable[[dict[str, str]], list[Violation]]:
    """Write files into a repository that keeps the conventions; returns what is found in it."""
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)  # noqa: S607  # git is where it is

    def planted(files: dict[str, str]) -> list[Violation]:
        kept = {
            "docs/glossary.md": "- **lease**: the right of one worker to evaluate a batch.\n",
            "tests/plain_words.txt": "dispatcher\n",
            "budgets.toml": "[lines]\nsource = 10\n",
            "coordinator/qdgrasp_coordinator/lease.py": PLAIN,
        }
        for path, text in (kept | files).items():
            (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / path).write_text(text)
        return list(conventions.violations(Repository(tmp_path)))

    return planted


def test_a_tree_that_keeps_them_has_no_violation(plant: Callable[[dict[str, str]], list[Violation]]) -> None:
    assert plant({}) == []


@pytest.mark.parametrize(
    ("path", "text", "sentence"),
    [
        ("worker/qdgrasp_worker/dispatcher.py", PLAIN, "class Lease is also defined in"),
        ("coordinator/qdgrasp_coordinator/search/lease.py", '"""Again."""\n', "one file name once in a room"),
        ("worker/qdgrasp_worker/lease.py", LONG, "601 lines; at most"),
        ("worker/qdgrasp_worker/belt.py", '"""A queue."""\n', "'belt' in belt is a metaphor"),
        ("worker/qdgrasp_worker/lease.py", '"""Which one it is."""\n', "begins with a question word"),
        ("worker/qdgrasp_worker/lease.py", '"""None: there is none."""\n', "is a riddle"),
        ("worker/qdgrasp_worker/lease.py", f'"""{"Lease " * 20}."""\n', "characters; at most 90"),
        ("worker/qdgrasp_worker/zeppelin.py", '"""Airships."""\n', "'zeppelin' in zeppelin is in neither"),
        (
            "coordinator/qdgrasp_coordinator/dispatcher.py",
            '"""Leasing."""\n\nfrom qdgrasp_coordinator.lease import Lease\n',
            "only qdgrasp_coordinator.dispatcher imports it",
        ),
    ],
)
def test_a_planted_violation_is_found(plant, path, text, sentence) -> None:
    assert any(sentence in found.sentence for found in plant({path: text}))


def test_a_tree_that_outgrows_its_ceilings_is_found(plant) -> None:
    found = plant({"budgets.toml": "[lines]\nsource = 4\n[other]\nmodules = 0\n"})
    assert {one.sentence for one in found} == {"source: 5; at most 4", "modules: 1; at most 0"}


def test_a_ceiling_is_raised_in_a_change_of_its_own_alone(plant, tmp_path: Path) -> None:
    def git(*words: str) -> None:
        named = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess.run(["git", "-C", str(tmp_path), *named, *words], check=True)  # noqa: S607

    plant({})
    git("add", "-A")
    git("commit", "-qm", "first")
    raised = {"budgets.toml": "[lines]\nsource = 99\n"}
    assert plant(raised) == []
    git("add", "-A")
    (found,) = plant(raised | {"coordinator/qdgrasp_coordinator/lease.py": PLAIN + "\n"})
    assert "source was raised" in found.sentence


def test_a_circle_inside_functions_is_found(plant) -> None:
    first = '"""A."""\n\ndef f() -> None:\n    import qdgrasp_worker.lease\n'
    second = '"""B."""\n\nimport qdgrasp_worker.dispatcher\n'
    texts = {"worker/qdgrasp_worker/dispatcher.py": first, "worker/qdgrasp_worker/lease.py": second}
    assert any("a circle of imports" in one.sentence for one in plant(texts))
