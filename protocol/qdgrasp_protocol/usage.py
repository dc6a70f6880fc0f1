"""What is wrong with a command line, in a sentence that says where to look."""

from collections.abc import Iterator

from typer.exceptions import TyperException

BOUND = "Input should be "
"""What a word begins with about a number that is out of bounds, or none."""
FAILED = "Value error, "
"""The same of a choice that is not one."""


def misuse(error: TyperException, name: str) -> str:
    """What a command line is refused with: what is wrong, and which help tells more.

    Parameters
    ----------
    name
        Of the program, for errors that do not know their command.
    """
    context = getattr(error, "ctx", None)
    command = name if context is None else context.command_path
    return f"{_worded(error).rstrip('.')}. See `{command} --help`."


def _worded(error: TyperException) -> str:
    words = error.format_message()
    for fault in _faults(error):
        said = fault["msg"]
        better = said.removeprefix(FAILED)
        if said.startswith(BOUND):
            better = f"it must be {said.removeprefix(BOUND)}, got '{fault['input']}'"
        words = words.replace(said, better)
    return words


def _faults(error: TyperException) -> Iterator[dict[str, str]]:
    """What the library says that looks at values; it is not loaded where there is none of its errors."""
    faults = getattr(error.__cause__, "errors", None)
    if callable(faults):
        yield from faults()
