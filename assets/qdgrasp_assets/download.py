"""Downloads that go on where they broke off: HTTP ranges, a limit on bytes, a limit on silence."""

import http.client
import re
import ssl
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from qdgrasp_protocol.errors import AssetError

ATTEMPTS = 5
"""Connections in a row that may bring nothing before a download is given up."""
PATIENCE = 30.0  # s without a byte
LARGEST = 1 << 29  # bytes; the archives of scans have tens of megabytes
CHUNK = 1 << 16
RANGE = re.compile(r"bytes (?:(\d+)-\d+|\*)/(\d+)")

Progress = Callable[[int, int | None], None]
"""Called with the bytes that are there and those that there will be, None where that is not said."""


class Broken(Exception):
    """A connection that ended before the file did; another may go on."""


NETWORK = (
    Broken,
    urllib.error.URLError,
    http.client.HTTPException,
    ssl.SSLError,
    TimeoutError,
    ConnectionError,
)
"""What the way to a server may do; any other error is one of the disk here."""


def download(
    url: str, file: Path, progress: Progress = lambda _here, _all: None, patience: float = PATIENCE
) -> None:
    """Bring what is at `url` into `file`, going on with what an earlier download left beside it.

    The bytes that came are kept in `file` with `.part` at its end until all of them are there.

    Parameters
    ----------
    url
        An http or https address.
    progress
        Is told how far it is.
    patience
        How long a server may send nothing [s].

    Raises
    ------
    AssetError
        There is no such file, the server cannot be reached, or it breaks off or stalls again and again.
    OSError
        The file cannot be written.
    """
    if not url.startswith(("http://", "https://")):
        raise AssetError(f"Scans are fetched from an http or https address, got '{url}'.")
    part = file.with_name(file.name + ".part")
    part.parent.mkdir(parents=True, exist_ok=True)
    fruitless = 0
    while True:
        before = _size(part)
        try:
            _go_on(url, part, progress, patience)
            break
        except NETWORK as error:
            fruitless = 0 if _size(part) > before else fruitless + 1
            if fruitless == ATTEMPTS or not _may_pass(error):
                raise _given_up(url, part, error) from None
    _mark(part).unlink(missing_ok=True)
    part.replace(file)


def _go_on(url: str, part: Path, progress: Progress, patience: float) -> None:
    """One connection: bring what `part` lacks."""
    with _opened(url, part, patience) as response:
        start, total = _extent(response, _size(part))
        if total is not None and total > LARGEST:
            raise AssetError(f"'{url}' has {total} bytes, more than the {LARGEST} that a scan may have.")
        if start and start == total:
            return
        _remember(part, response.headers.get("ETag"))
        with part.open("r+b" if start else "wb") as file:
            file.seek(start)
            here = start
            while chunk := _read(response):
                file.write(chunk)
                here += len(chunk)
                if here > (LARGEST if total is None else total):
                    file.truncate(start)
                    raise AssetError(f"'{url}' sends more bytes than the {total or LARGEST} expected.")
                progress(here, total)
    if total is not None and here < total:
        raise Broken(f"the server ended after {here} of {total} bytes")


@contextmanager
def _opened(url: str, part: Path, patience: float) -> Iterator[Any]:
    """The answer to a request for what `part` lacks; a range that the file does not have is an answer too."""
    headers = {"User-Agent": "qdgrasp", "Accept-Encoding": "identity"}
    if _size(part):
        headers["Range"] = f"bytes={_size(part)}-"
        if mark := _remembered(part):
            headers["If-Range"] = mark
    request = urllib.request.Request(url, headers=headers)  # noqa: S310  # `download` takes http and https
    try:
        with urllib.request.urlopen(request, timeout=patience) as response:  # noqa: S310  # as above
            yield response
    except urllib.error.HTTPError as error:
        if error.code != http.HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
            raise
        with error:
            _check_whole(error, part)
            yield error


def _check_whole(error: urllib.error.HTTPError, part: Path) -> None:
    """A server that has no more bytes than `part`: either that is all of them, or it is another file."""
    said = RANGE.fullmatch(error.headers.get("Content-Range", ""))
    if said is None or int(said[2]) != _size(part):
        _forget(part)
        raise Broken("the server has another file than before")


def _extent(response: Any, here: int) -> tuple[int, int | None]:
    """At which byte an answer begins, and how many the whole file has."""
    said = RANGE.fullmatch(response.headers.get("Content-Range", ""))
    if response.status == http.HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
        return here, here
    if response.status == http.HTTPStatus.PARTIAL_CONTENT:
        if said is None or said[1] is None or int(said[1]) != here:
            raise Broken("the server sent another range than it was asked for")
        return here, int(said[2])
    length = response.headers.get("Content-Length", "")
    return 0, int(length) if length.isdigit() else None


def _read(response: Any) -> bytes:
    try:
        return bytes(response.read1(CHUNK))
    except http.client.IncompleteRead as short:
        return bytes(short.partial)


def _may_pass(error: Exception) -> bool:
    """Whether another connection may do better."""
    if isinstance(error, urllib.error.HTTPError):
        return error.code >= http.HTTPStatus.INTERNAL_SERVER_ERROR
    if isinstance(error, urllib.error.URLError):
        return isinstance(error.reason, TimeoutError | ConnectionResetError)
    return True


def _given_up(url: str, part: Path, error: Exception) -> AssetError:
    if isinstance(error, urllib.error.HTTPError):
        return AssetError(f"'{url}' cannot be fetched: the server answers {error.code} {error.reason}.")
    reason = error.reason if isinstance(error, urllib.error.URLError) else error
    kept = f" {_size(part)} bytes are kept; the same command goes on from there." if _size(part) else ""
    return AssetError(
        f"'{url}' cannot be fetched: {reason or type(error).__name__}; is there a network, and a way to that "
        f"address?{kept}"
    )


def _size(part: Path) -> int:
    return part.stat().st_size if part.is_file() else 0


def _mark(part: Path) -> Path:
    """Where the server's name for the version that `part` is of is kept."""
    return part.with_name(part.name + ".etag")


def _remember(part: Path, etag: str | None) -> None:
    if etag and not etag.startswith("W/"):
        _mark(part).write_text(etag, encoding="utf-8")
    else:
        _mark(part).unlink(missing_ok=True)


def _remembered(part: Path) -> str | None:
    return _mark(part).read_text(encoding="utf-8") if _mark(part).is_file() else None


def _forget(part: Path) -> None:
    for file in (part, _mark(part)):
        file.unlink(missing_ok=True)
