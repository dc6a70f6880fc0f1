"""Where a page is to be served."""

from qdgrasp_protocol.errors import ImpossibleValue


def web_place(text: str) -> tuple[str, int]:
    """The host and the port in `127.0.0.1:8080` or `[::1]:8080`.

    Raises
    ------
    ImpossibleValue
        The text is not of that form.
    """
    host, _, port = text.rpartition(":")
    if not (host and port.isdecimal() and int(port) < 1 << 16):
        raise ImpossibleValue("--web", text, "HOST:PORT, such as 127.0.0.1:8080")
    return host.removeprefix("[").removesuffix("]"), int(port)
