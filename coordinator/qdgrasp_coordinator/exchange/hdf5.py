"""HDF5 of others: what a dataset is, is looked at before it is read, and nothing outside the file ever is."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from qdgrasp_assets.rotation import Floats
from qdgrasp_coordinator.exchange.told import LONGEST, MOST, Unusable

MOST_WORDS = 1000
"""Words in a list, at most."""
LONGEST_TEXT = 1 << 26
"""Bytes of a text, at most."""
SMALL, PACKED = 1 << 24, 200
"""Datasets of more than so many bytes may not be so many times as large as their file."""


class Datasets:
    """The datasets of an open file, by name."""

    def __init__(self, path: Path, file: Any) -> None:
        self._path, self._file = path, file

    def __contains__(self, name: str) -> bool:
        return self._find(name) is not None

    def numbers(self, name: str, shape: tuple[int, ...] = (), count: int | None = None) -> Floats:
        """A dataset (n, *shape) of numbers, where n is `count` if that is given."""
        data = self._get(name)
        found = data.shape
        sides = "".join(f", {side}" for side in shape)
        if not found or found[1:] != shape or data.dtype.kind not in "fiub" or count not in (None, found[0]):
            told = f"numbers of shape ({'n' if count is None else count}{sides})"
            raise Unusable(self._path, f"its dataset '{name}' must be {told}")
        if found[0] > MOST:
            raise Unusable(self._path, f"it has {found[0]} grasps; at most {MOST} are read")
        if data.nbytes > max(SMALL, PACKED * self._path.stat().st_size):
            raise Unusable(self._path, f"its dataset '{name}' is far larger than the file")
        numbers: Floats = data[()].astype(np.float64)
        return numbers

    def scalar(self, name: str) -> float | None:
        """A number; None: there is none of that name."""
        if name not in self:
            return None
        data = self._get(name)
        if data.shape != () or data.dtype.kind not in "fiu":
            raise Unusable(self._path, f"its dataset '{name}' must be a number")
        return float(data[()])

    def text(self, name: str) -> str | None:
        """A text; None: there is none of that name."""
        if name not in self:
            return None
        data = self._get(name)
        if data.shape != () or data.dtype.itemsize > LONGEST_TEXT:
            raise Unusable(self._path, f"its dataset '{name}' must be a text")
        return str(data.asstr()[()])

    def words(self, name: str) -> list[str]:
        """A list of words."""
        data = self._get(name)
        is_list = len(data.shape or ()) == 1 and data.shape[0] <= MOST_WORDS
        if not is_list or data.dtype.itemsize > 4 * LONGEST:
            raise Unusable(self._path, f"its dataset '{name}' must be a list of names")
        return [str(data.asstr()[place]) for place in range(data.shape[0])]

    def _get(self, name: str) -> Any:
        data = self._find(name)
        if data is None:
            raise Unusable(self._path, f"it is HDF5, but not an ACRONYM file: it has no dataset '{name}'")
        return data

    def _find(self, name: str) -> Any | None:
        """The dataset, found along links that do not leave the file; None: there is none."""
        import h5py

        node = self._file
        for part in name.split("/"):
            if not isinstance(node, h5py.Group) or not node.id.links.exists(part.encode()):
                return None
            if node.id.links.get_info(part.encode()).type != h5py.h5l.TYPE_HARD:
                raise Unusable(self._path, f"its '{name}' is a link to elsewhere, which is not followed")
            node = node[part]
        if not isinstance(node, h5py.Dataset):
            raise Unusable(self._path, f"its '{name}' is no dataset")
        if node.external or node.is_virtual:
            raise Unusable(self._path, f"its dataset '{name}' lies in another file, which is not read")
        return node


@contextmanager
def opened(path: Path) -> Iterator[Datasets]:
    """The datasets of a file while it is open.

    Raises
    ------
    Unusable
        It is damaged, also if that is found only when a dataset is read.
    """
    import h5py

    try:
        with h5py.File(path) as file:
            yield Datasets(path, file)
    except (OSError, KeyError, ValueError, TypeError, AttributeError, RuntimeError) as error:
        raise Unusable(path, f"it is a damaged HDF5 file ({error})") from None
