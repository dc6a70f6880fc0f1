"""Text that others wrote, as it may go to a terminal or a log."""


def printable(text: str, most: int | None = None) -> str:
    r"""The text on one line, with escapes (`\x1b`, `\n`) for what is no printable character.

    Parameters
    ----------
    most
        So many characters are kept; None: all.
    """
    shown = "".join(one if one.isprintable() else ascii(one)[1:-1] for one in text)
    return shown[:most]
