"""Files of plain numpy arrays, read without trust."""

import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qdgrasp_protocol.errors import InputError


def read_arrays(path: Path, what: str) -> dict[str, NDArray[np.generic]]:
    """The arrays in an npz file, by name; nothing in it is unpickled.

    Parameters
    ----------
    what
        What the file is to hold, in a word for errors: "poses", "reference set".

    Raises
    ------
    InputError
        The file cannot be read, or is no npz file of plain arrays.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except OSError as error:
        raise InputError(f"No {what} can be read at '{path}': {error.strerror or error}.") from None
    except (ValueError, EOFError, zipfile.BadZipFile, TypeError, AttributeError):
        raise InputError(f"'{path}' is not an npz file of plain arrays, so no {what} can be read.") from None
