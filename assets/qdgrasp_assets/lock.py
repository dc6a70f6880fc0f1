"""The lock: sizes and hashes of the archives that scans come in, as this package and this user know them."""

import os
import tempfile
import tomllib
from pathlib import Path

import msgspec
import tomli_w
from msgspec import Struct

from qdgrasp_assets.files import data_folder
from qdgrasp_protocol.errors import AssetError

OURS = Path(__file__).parent / "lock.toml"


class Pin(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """What one archive is known to be; None where that is not known."""

    size: int | None = None
    """[bytes]."""
    sha256: str | None = None
    mesh_sha256: str | None = None
    """Of the mesh file in the archive."""

    def difference(self, other: "Pin") -> str | None:
        """What differs in `other`, in words; only what both know is compared."""
        for field, words in (
            ("size", "{} bytes"),
            ("sha256", "sha256 {}"),
            ("mesh_sha256", "mesh sha256 {}"),
        ):
            known, came = getattr(self, field), getattr(other, field)
            if None not in (known, came) and known != came:
                return f"expected {words.format(known)}, got {words.format(came)}"
        return None


NOTHING_KNOWN = Pin()


def users_lock() -> Path:
    """The user's lock file, which `keep` writes."""
    return data_folder() / "lock.toml"


def pin(archive: str) -> Pin:
    """What is known of an archive: by this package, else from an earlier fetch of this user.

    Raises
    ------
    AssetError
        The user's lock file cannot be read.
    """
    return next(
        (pins[archive] for pins in (_read(OURS), _read(users_lock())) if archive in pins), NOTHING_KNOWN
    )


def keep(archive: str, found: Pin) -> Path:
    """Write what an archive was found to be to the user's lock file; return that file."""
    path = users_lock()
    pins = {**_read(path), archive: found}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, tomli_w.dumps(msgspec.to_builtins(pins)).encode())
    return path


def write_whole(path: Path, content: bytes) -> None:
    """Write a file such that it is seen with all of its content or not at all."""
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
        try:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
            Path(file.name).replace(path)
        except BaseException:
            Path(file.name).unlink(missing_ok=True)
            raise


def _read(path: Path) -> dict[str, Pin]:
    try:
        return msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), dict[str, Pin])
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (OSError, ValueError) as error:
        raise AssetError(f"The lock file '{path}' cannot be read: {error}; mend or remove it.") from None
