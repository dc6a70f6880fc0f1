"""What docs/security.md says of roles, keys and sizes is what routers are told."""

import re
from pathlib import Path

from qdgrasp_coordinator.security.meetings import allowed
from qdgrasp_coordinator.security.stage import ACTORS, KEYS
from qdgrasp_coordinator.security.traffic import TRAFFIC, Way
from qdgrasp_coordinator.security.verdicts import cells, short

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "security.md").read_text()
KIB = 1 << 10
UNITS = {"KiB": KIB, "MiB": KIB**2}


def rows(heading: str) -> list[list[str]]:
    """The cells of a table, without its heading."""
    table = PAGE.partition(heading)[2].partition("\n\n")[0]
    return [[cell.strip(" `") for cell in line.split("|")[1:-1]] for line in table.splitlines()[2:]]


def sizes(text: str) -> list[int]:
    return [int(number) * UNITS[unit] for number, unit in re.findall(r"(\d+) (KiB|MiB)", text)]


def roles(text: str) -> set[str]:
    return set(text.split(", ")) - {"-"}


def test_the_page_has_the_table_of_traffic() -> None:
    described = [
        (key, way, roles(givers), roles(takers), sizes(limits))
        for key, way, givers, takers, limits in rows("| key, under")
    ]
    assert described == [
        (
            flow.key.removeprefix("qdgrasp/v1/*/"),
            flow.way.value,
            set(flow.givers),
            set(flow.takers),
            [size for size in (flow.limit, flow.answer_limit) if size],
        )
        for flow in TRAFFIC
    ]


def test_the_page_has_the_matrix() -> None:
    seen = {meeting for way in Way for meeting in allowed(way, KEYS)}
    matrix: dict[tuple[str, str], list[str]] = {}
    for cell in cells(seen):
        matrix.setdefault((short(cell.key), cell.verb), []).append(cell.mark)
    shown = {(key, verb): marks for key, verb, *marks in rows("| key | verb | " + " | ".join(ACTORS) + " |")}
    assert shown == {row: marks for row, marks in matrix.items() if "yes" in marks}
    allowed_, measured = sum(m.count("yes") for m in matrix.values()), sum(len(m) for m in matrix.values())
    assert f"All {measured} cells are measured, {allowed_} allowed and {measured - allowed_} silent" in PAGE
