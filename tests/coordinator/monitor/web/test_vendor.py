import hashlib
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[4]
PACKAGE = ROOT / "coordinator" / "qdgrasp_coordinator"
STATIC = PACKAGE / "monitor" / "web" / "static"
VENDOR = STATIC / "vendor"
NOTICES = (ROOT / "THIRD_PARTY_NOTICES.md").read_text(encoding="utf-8")


def files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_the_scripts_of_others_are_those_in_the_notices() -> None:
    noticed = dict(re.findall(r"^\| `([\w./]+)` \| `([0-9a-f]{64})` \|$", NOTICES, re.MULTILINE))
    there = {name: hashlib.sha256((VENDOR / name).read_bytes()).hexdigest() for name in files(VENDOR)}
    assert there
    assert there == noticed


@pytest.mark.parametrize(
    ("package", "script", "stated"),
    [("three", "three.core.min.js", '="{1}"'), ("uPlot", "uPlot.iife.min.js", "(v{0}.{1}.{2})")],
)
def test_the_versions_in_the_notices_are_those_that_the_scripts_state(
    package: str, script: str, stated: str
) -> None:
    noticed = re.search(rf"^\| \[{package}\]\S* \| (\S+) \|", NOTICES, re.MULTILINE)
    assert noticed
    text = (VENDOR / package.lower() / script).read_text(encoding="utf-8")
    assert stated.format(*noticed[1].split(".")) in text


def test_the_wheel_holds_the_page_with_the_scripts_of_others_and_their_licences(tmp_path: Path) -> None:
    pytest.importorskip("hatchling", reason="needs hatchling, which builds the wheel")
    build = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    packed = set(zipfile.ZipFile(wheel).namelist())
    for folder in (STATIC, STATIC.with_name("pages")):
        home = folder.relative_to(PACKAGE.parent).as_posix()
        assert {f"{home}/{name}" for name in files(folder)} <= packed
    licences = {
        name.partition("/vendor/")[2] for name in packed if "/licenses/" in name and "/vendor/" in name
    }
    assert licences == {"three/LICENSE", "uplot/LICENSE"}
