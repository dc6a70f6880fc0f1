"""The mesh files that a campaign grasps, read before anything is begun: all faults are told at once."""

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from qdgrasp_assets.files import named_path
from qdgrasp_assets.mesh_file import ALWAYS, NEEDED
from qdgrasp_assets.objects.stand_ins import STAND_INS
from qdgrasp_assets.scans import SCANS
from qdgrasp_assets.solid import Draft, read_draft
from qdgrasp_coordinator.campaigns.campaign import Campaign, campaign
from qdgrasp_protocol.errors import AssetError, InputError, UnusableMeshes
from qdgrasp_protocol.keys import job_name
from qdgrasp_protocol.spec import RunSpec

MASSES = "masses.csv"
"""The table of masses in a folder of meshes."""
COLUMNS = ["file", "mass"]
DIGITS = 6
"""Of a mass that follows from a density."""
HEAVIEST = 1000
"""As a spec allows [kg]."""
NO_MASS = "it has no mass: say what it weighs with --mass or --density, or in " + MASSES


@dataclass(frozen=True)
class Weighing:
    """What objects weigh that the table of masses does not name; one of the two, or none."""

    mass: float | None = None
    """Of each [kg]."""
    density: float | None = None
    """Of each [kg/m3]."""

    def of(self, draft: Draft) -> float | None:
        """The mass of a mesh [kg]; None: it is not said."""
        if self.density is None:
            return self.mass
        return float(f"{self.density * draft.mesh.volume:.{DIGITS}g}")


def of_folder(folder: Path, weighing: Weighing, scale: float | None, said: Mapping[str, Any]) -> Campaign:
    """The campaign of all meshes in a folder.

    Parameters
    ----------
    scale
        Metres to a unit of each file; None: 1.
    said
        Values or lists of keys of a spec, crossed as in a campaign's file; None: not said.

    Raises
    ------
    InputError
        As in `known_of`, or a run is asked for that cannot be.
    """
    known = known_of(folder, weighing, scale)
    cross = {key: value for key, value in said.items() if value is not None} | {"object": list(known)}
    return campaign({"cross": [cross], "objects": known}, f"campaign of {folder}")


def known_of(folder: Path, weighing: Weighing, scale: float | None) -> dict[str, dict[str, float]]:
    """What is known of every mesh in a folder, by its path: the keys `mass` and `scale` of a spec.

    Raises
    ------
    InputError
        There is no such folder, no mesh in it, or its table of masses cannot be read.
    UnusableMeshes
        Of some of them no object can be made, or what they weigh is not known.
    """
    files, masses = _meshes(folder), _masses(folder / MASSES)
    faults = _namesakes(files.values())
    faults |= dict.fromkeys(masses.keys() - files.keys(), f"{MASSES} names it, and there is no such mesh")
    known: dict[str, dict[str, float]] = {}
    for name, file in files.items():
        draft = _draft(file, scale)
        mass = masses[name] if name in masses else weighing.of(draft)
        why = _why_not(draft, mass)
        if why or mass is None:
            faults.setdefault(name, why)
        else:
            known[str(file)] = {"mass": mass} | ({} if scale is None else {"scale": scale})
    if faults:
        raise UnusableMeshes(len(files.keys() | masses.keys()), faults)
    return known


def check_meshes(specs: Iterable[RunSpec]) -> None:
    """Check that an object can be made of every mesh file that runs grasp.

    Raises
    ------
    UnusableMeshes
        Of some of them it cannot.
    """
    named = STAND_INS.keys() | SCANS.keys()
    wanted = {(spec.object, spec.scale): spec.mass for spec in specs if spec.object not in named}
    faults: dict[str, str] = {}
    for (name, scale), mass in wanted.items():
        if why := _why_not(_draft(named_path(name), scale), mass):
            faults[name] = why
    if faults:
        raise UnusableMeshes(len({name for name, _ in wanted}), faults)


def _why_not(draft: Draft, mass: float | None) -> str:
    """Why no object can be made of a mesh; empty where one can."""
    if draft.faults:
        return "; and ".join(draft.faults)
    if mass is None:
        return NO_MASS
    return (
        ""
        if 0 < mass <= HEAVIEST
        else f"its mass must be more than 0 and at most {HEAVIEST} kg, got {mass:g}"
    )


def _meshes(folder: Path) -> dict[str, Path]:
    """The meshes in a folder by their names."""
    if not folder.is_dir():
        raise InputError(f"There is no folder of meshes at '{folder}'.")
    kinds = {*ALWAYS, *NEEDED}
    found = sorted(file for file in folder.iterdir() if file.is_file() and file.suffix.lower() in kinds)
    if not found:
        raise InputError(
            f"There is no mesh in '{folder}': name a folder of files such as {', '.join(ALWAYS)}."
        )
    return {file.name: file.resolve() for file in found}


def _masses(table: Path) -> dict[str, float]:
    """The masses [kg] that a table names, by file; none where there is no table."""
    if not table.is_file():
        return {}
    try:
        with table.open(encoding="utf-8-sig", newline="") as lines:
            rows = [[cell.strip() for cell in row] for row in csv.reader(lines) if row]
        header, *rest = rows
        return {name: float(mass) for name, mass in rest} if header == COLUMNS else _refused(table)
    except (OSError, ValueError) as error:
        return _refused(table, f": {error}")


def _refused(table: Path, why: str = "") -> dict[str, float]:
    raise InputError(
        f"'{table}' is no table of masses: it begins with the line `{','.join(COLUMNS)}`, and every other "
        f"one is a mesh's file name and its mass in kg{why}."
    )


def _namesakes(files: Iterable[Path]) -> dict[str, str]:
    """Meshes whose runs would be called as those of another one."""
    first, faults = dict[str, str](), dict[str, str]()
    for file in files:
        other = first.setdefault(job_name(f"a-{file.stem}"), file.name)
        if other != file.name:
            faults[file.name] = f"its runs would be called as those of '{other}': rename one of the two"
    return faults


def _draft(file: Path, scale: float | None) -> Draft:
    """A mesh file as an object would be made of it; what cannot be read at all is a fault too."""
    try:
        return read_draft(file, scale)
    except AssetError as error:
        return Draft.unread(str(error))
