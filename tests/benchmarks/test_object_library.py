"""The library that is generated: varied, the same for a seed, and broken where it is said to be."""

import csv
from pathlib import Path

from benchmarks.object_library.generator import KINDS, make_library

from qdgrasp_coordinator.campaign.object_library import LibraryRules, read_library


def broken(out: Path) -> list[str]:
    with (out / "broken.csv").open(newline="") as file:
        return [row["id"] for row in csv.DictReader(file)]


def test_what_is_broken_on_purpose_and_nothing_else_cannot_be_used(tmp_path, monkeypatch):
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))
    found = read_library(make_library(tmp_path / "out", 100, 0), LibraryRules(skip_unusable=True))
    assert [each.object for each in found.skipped] == broken(tmp_path / "out")
    assert len(found.skipped) == 2
    assert {values["about"]["category"] for values in found.objects.values()} == set(KINDS)


def test_a_larger_library_begins_with_the_smaller_one(tmp_path):
    make_library(tmp_path / "one", 7, 3)
    make_library(tmp_path / "other", 9, 3)
    make_library(tmp_path / "third", 7, 4)
    files = {file.name: file.read_bytes() for file in (tmp_path / "one" / "meshes").iterdir()}
    again = {name: (tmp_path / "other" / "meshes" / name).read_bytes() for name in files}
    assert files == again
    assert files != {name: (tmp_path / "third" / "meshes" / name).read_bytes() for name in files}
