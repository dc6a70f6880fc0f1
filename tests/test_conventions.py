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


@pytest.mark.parametrize(
    ("limit", "sentence"),
    [
        ("MOST_MODULES", "rooms: 1 files; at most 0"),
        ("MOST_LINES", "rooms: 5 lines; at most 0"),
        ("MOST_IN_FOLDER", "modules in one folder; at most 0"),
    ],
)
def test_a_tree_that_outgrows_its_size_is_found(plant, monkeypatch, limit, sentence) -> None:
    monkeypatch.setattr(conventions, limit, 0)
    assert any(sentence in found.sentence for found in plant({}))
