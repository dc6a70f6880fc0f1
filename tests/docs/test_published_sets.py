"""The figures of the reference sets on the page of results, recomputed from their files."""

import numpy as np
import pandas
from numpy.typing import NDArray
from tests.docs.test_published_numbers import RESULTS, lines_with, part, spread, words_of


def chao2(reached: NDArray[np.bool_]) -> tuple[int, float]:
    """The cells that some of the runs found, and the estimated number of all, of (runs, cells)."""
    times, n = reached.sum(axis=0), len(reached)
    seen, once, twice = (int(np.sum(chosen)) for chosen in (times > 0, times == 1, times == 2))
    return seen, seen + (n - 1) / n * once**2 / (2 * twice)


def test_reference_sets_are_those_of_the_files_beside_the_table() -> None:
    section, folder = part("Reference sets of our own"), RESULTS / "reference-sets"
    sizes, shares = lines_with(section, "cells that hold"), lines_with(section, "complete, %")
    listed = pandas.read_csv(folder / "runs.csv", keep_default_na=False)
    assert len(sizes) == len(shares) == len([*folder.glob("*.npz")]) > 0
    for line, covered in zip(sizes, shares, strict=True):
        name = f"{line['hand']}-{line['object']}-{line['protocol'].replace(' ', '-')}"
        with np.load(folder / f"{name}.npz") as file:
            (key,) = (key.removesuffix(".cm") for key in file if key.endswith(".cm"))
            best, names = file[f"{key}.by_run"], [str(run) for run in file[f"{key}.runs"]]
        assert line["runs"] == str(len(names))
        holding = best == 3  # 1 + the greatest fitness of a set
        (seen, total), (held, of_held) = chao2(best > 0), chao2(holding)
        assert (line["cells"], line["cells that hold"]) == (str(seen), str(held))
        assert line["estimated cells"].startswith(f"{total:.0f} (")
        assert line["estimated to hold"].startswith(f"{of_held:.0f} (")
        counted, all_of_it = (
            (holding, of_held) if line["protocol"].startswith("physical") else (best > 0, total)
        )
        assert covered["complete, %"] == f"{100 * counted.any(axis=0).sum() / all_of_it:.0f}"
        mine = listed[(listed["run"].isin(names)) & (listed["object"] == line["object"])]
        assert sorted(mine["run"]) == sorted(names)
        found: dict[str, list[float]] = {}
        for method, settings, run in zip(mine["method"], mine["settings"], mine["run"], strict=True):
            its_own = counted[names.index(run)]
            others = np.delete(counted, names.index(run), axis=0).any(axis=0)
            found.setdefault(words_of(method, settings), []).append(100 * its_own[others].mean())
        assert {name: spread(np.array(values), 1) for name, values in found.items()} == {
            name: cell.strip("*") for name, cell in list(covered.items())[4:] if cell
        }
        assert next(name for name, cell in covered.items() if "**" in cell) == max(
            found, key=lambda name: np.median(found[name])
        )
