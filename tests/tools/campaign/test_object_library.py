"""Libraries of objects: manifests, folders in folders, what is left out, and what is remembered."""

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
import trimesh
from pyarrow import parquet
from typer.testing import CliRunner

from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_protocol.build_messages import MeshPreparation
from qdgrasp_protocol.errors import InputError, UnknownKey, UnusableMeshes
from qdgrasp_protocol.keys import NAME
from qdgrasp_protocol.spec import ObjectRecord
from qdgrasp_tools.campaign.campaign_file import Campaign, campaign_of_meshes, read_campaign
from qdgrasp_tools.campaign.campaign_folder import begin_campaign
from qdgrasp_tools.campaign.object_library import LibraryRules, is_manifest, read_library
from qdgrasp_tools.campaign.summaries import campaign_summary
from qdgrasp_tools.cli.main import app

BLOCK = (0.02, 0.03, 0.05)
VALUES = {"gripper": ["panda"], "evaluations": 50}
SKIPPING = LibraryRules(skip_unusable=True)
ROWS: list[dict[str, Any]] = [
    {"file": "a/part.stl", "id": "acme/part one", "unit": "mm", "density": 1000, "category": "bracket",
     "licence": "CC-BY-4.0", "source": "acme 1.2", "split": "test", "friction": 0.7},
    {"file": "b/part.stl", "mass": 0.25, "simplify": 100, "hull": True},
]  # fmt: skip


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def library(tmp_path: Path) -> Path:
    """A folder with two meshes of one name in folders of it, the first in millimetres."""
    folder = tmp_path / "library"
    for name, size in (("a", 1000), ("b", 1)):
        (folder / name).mkdir(parents=True)
        trimesh.creation.box(BLOCK).apply_scale(size).export(folder / name / "part.stl")
    return folder


def write_manifest(path: Path, rows: list[dict[str, Any]] = ROWS) -> Path:
    if path.suffix == ".parquet":
        names = list(dict.fromkeys(key for row in rows for key in row))
        parquet.write_table(pa.table({name: [row.get(name) for row in rows] for name in names}), path)
    else:
        with path.open("w", newline="") as file:
            table = csv.DictWriter(file, list(dict.fromkeys(key for row in rows for key in row)))
            table.writeheader()
            table.writerows(rows)
    return path


def break_mesh(path: Path) -> None:
    block = trimesh.creation.box(BLOCK)
    trimesh.Trimesh(block.vertices, block.faces[1:], process=False).export(path)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_manifest_says_the_same_in_any_format(library, suffix):
    manifest = write_manifest(library / f"objects{suffix}")
    assert is_manifest(manifest)
    one, other = campaign_of_meshes(manifest, LibraryRules(), VALUES).runs.values()
    assert (one.object, one.scale, one.mass) == (str(library / "a/part.stl"), 0.001, pytest.approx(0.03))
    assert (one.friction, one.mesh) == (0.7, None)
    assert one.about == ObjectRecord(
        id="acme/part one", category="bracket", licence="CC-BY-4.0", source="acme 1.2", split="test"
    )
    assert (other.mass, other.scale, other.about) == (0.25, None, ObjectRecord(id="b/part"))
    assert other.mesh == MeshPreparation(simplify=100, hull=True)


def test_runs_are_called_after_the_ids_and_the_campaigns_file_asks_for_the_same(library, tmp_path):
    asked = campaign_of_meshes(write_manifest(library / "objects.csv"), LibraryRules(), VALUES)
    assert list(asked.runs) == [
        "panda-acme-part-one-portfolio-s0-physical",
        "panda-b-part-portfolio-s0-physical",
    ]
    assert all(NAME.fullmatch(name) for name in asked.runs)
    file = tmp_path / "campaign.toml"
    file.write_text(asked.toml)
    assert read_campaign(file).runs == asked.runs


BAD_ROWS = [
    ({"file": "lost.stl", "mass": 1}, "No mesh file at"),
    ({"file": "a/part.stl", "mass": 1}, "is 20 x 30 x 50 m large"),
    ({"file": "b/part.stl"}, "it has no mass"),
    ({"file": "b/part.stl", "mass": "heavy"}, "Expected `float | null`, got `str` - at `$.mass`"),
    ({"file": "b/part.stl", "mass": 1, "density": 2}, "says mass and density"),
    ({"file": "b/part.stl", "mass": 1, "unit": "ell"}, "unit"),
    (
        {"file": "b/part.stl", "mass": 1, "simplify": "1.5"},
        "Expected `int | null`, got `str` - at `$.mesh.simplify`",
    ),
    ({"file": "b/part.stl", "mass": 1, "hull": "perhaps"}, "Expected `bool`, got `str` - at `$.mesh.hull`"),
    ({"file": "b/part.stl", "mass": 1, "friction": -1}, "friction must be a number greater than 0"),
    ({"file": "b/part.stl", "mass": 5000}, "at most 1000 kg"),
]


@pytest.mark.parametrize(("row", "words"), BAD_ROWS)
def test_a_row_that_cannot_be_used_is_named_or_left_out(library, row, words):
    good = {"file": "b/../b/part2.stl", "mass": 0.1}
    shutil.copy(library / "b" / "part.stl", library / "b" / "part2.stl")
    manifest = write_manifest(library / "objects.csv", [row | {"id": "bad"}, good])
    with pytest.raises(UnusableMeshes, match=r"1 of 2 meshes") as refused:
        read_library(manifest, LibraryRules())
    assert words in str(refused.value)
    found = read_library(manifest, SKIPPING)
    assert list(found.objects) == [str(library / "b" / "part2.stl")]
    (skipped,) = found.skipped
    assert (skipped.object, words in skipped.reason) == ("bad", True)


@pytest.mark.parametrize(
    ("name", "content", "error", "words"),
    [
        ("o.csv", "file,weight\nb/part.stl,1\n", UnknownKey, "unknown key 'weight'"),
        ("o.csv", "file,mass\n", InputError, "names no object"),
        ("o.csv", "", InputError, "names no object"),
        ("o.csv", f'file\n"{"a" * 140_000}', InputError, "field larger than field limit"),
        ("o.csv", "id,mass\none,1\n", InputError, "says no file in row 1"),
        ("o.csv", "file\nb/part.stl,1\n", InputError, "row 2 has 2 cells"),
        ("o.csv", b"file\n\xff\xfe\n", InputError, "cannot be read"),
        ("o.parquet", b"PAR1 and no more", InputError, "cannot be read"),
        ("lost.csv", None, InputError, "cannot be read as a table: No such file"),
    ],
)
def test_a_manifest_that_is_none_is_one_sentence(library, name, content, error, words):
    if content is not None:
        (library / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(error, match=words):
        read_library(library / name, SKIPPING)


def test_two_rows_of_one_file_or_one_name_are_refused(library):
    same_file, same_name = library / "file.csv", library / "name.csv"
    write_manifest(same_file, [*ROWS, {"file": "b/part.stl", "id": "c", "mass": 1}])
    with pytest.raises(UnusableMeshes, match="its file is that of 'b/part' too"):
        read_library(same_file, LibraryRules())
    shutil.copy(library / "b" / "part.stl", library / "c.stl")
    write_manifest(same_name, [*ROWS, {"file": "c.stl", "id": "b part", "mass": 1}])
    with pytest.raises(InputError, match="run 'panda-b-part-portfolio-s0-physical' twice"):
        campaign_of_meshes(same_name, LibraryRules(), VALUES)


def asked_for(manifest: Path) -> Campaign:
    return campaign_of_meshes(manifest, SKIPPING, VALUES)


def test_what_is_left_out_is_reported_in_the_folder_and_counted(library, tmp_path):
    break_mesh(library / "b" / "broken.stl")
    rows = [*ROWS, {"file": "b/broken.stl", "mass": 1}, {"file": "lost.stl", "id": "lost", "mass": 1}]
    asked, folder = asked_for(write_manifest(library / "o.csv", rows)), tmp_path / "campaign"
    assert "2 objects left out that cannot be used" in asked.words
    begin_campaign(folder, asked)
    with (folder / "skipped.csv").open(newline="") as file:
        broken, lost = csv.DictReader(file)
    assert (broken["object"], broken["file"]) == ("b/broken", str(library / "b" / "broken.stl"))
    assert broken["reason"].startswith("it is not closed")
    assert "remesh or hull" in broken["reason"]
    assert lost["object"] == "lost"
    assert "lost.stl': it does not exist" in lost["reason"]
    found = campaign_summary(JobFolder(folder))
    assert (found.runs, found.runs_done, found.objects, found.skipped) == (2, 0, 2, 2)
    assert json.loads(CliRunner().invoke(app, ["info", str(folder), "--json"]).stdout)["skipped"] == 2
    shutil.copy(library / "a" / "part.stl", library / "b" / "broken.stl")
    rows[2]["scale"] = 0.001
    begin_campaign(folder, asked_for(write_manifest(library / "o.csv", rows)))  # mended: it grows
    assert (campaign_summary(JobFolder(folder)).runs, campaign_summary(JobFolder(folder)).skipped) == (3, 1)
    begin_campaign(folder, read_campaign(folder / "campaign.toml"))  # which examines no library
    assert campaign_summary(JobFolder(folder)).skipped == 1
