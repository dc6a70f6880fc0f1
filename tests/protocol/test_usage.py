"""What is said of command lines that cannot be."""

from enum import StrEnum
from typing import Annotated

import pytest
import typer
from typer.exceptions import TyperException

from qdgrasp_protocol.usage import misuse


class Part(StrEnum):
    ALL = "all"
    SOME = "some"


app = typer.Typer()
inner = typer.Typer(no_args_is_help=True)
app.add_typer(inner, name="hand")


@app.command()
def show(
    grasp: Annotated[int, typer.Option(min=0)],
    offset: Annotated[float, typer.Option(min=0)] = 0.0,
    part: Part = Part.ALL,
) -> None:
    """Be there."""


@inner.command()
def new(name: str) -> None:
    """Be there too."""


@inner.command()
def other() -> None:
    """Be a second one."""


def said(*words: str) -> str:
    with pytest.raises(TyperException) as raised:
        app(words, prog_name="program", standalone_mode=False)
    return misuse(raised.value, "program")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            ("show", "--grasp", "-1"),
            "Invalid value for '--grasp': it must be greater than or equal to 0, got '-1'. "
            "See `program show --help`.",
        ),
        (
            ("show", "--grasp", "1", "--offset", "nan"),
            "Invalid value for '--offset': it must be greater than or equal to 0, got 'nan'. "
            "See `program show --help`.",
        ),
        (
            ("show", "--grasp", "1", "--part", "foo"),
            "Invalid value for '--part': 'foo' is not one of 'all', 'some'. See `program show --help`.",
        ),
        (("show",), "Missing option '--grasp'. See `program show --help`."),
        (("hand", "new"), "Missing argument 'name'. See `program hand new --help`."),
        (("hand", "foo"), "No such command 'foo'. See `program hand --help`."),
        (("foo",), "No such command 'foo'. See `program --help`."),
    ],
)
def test_a_sentence_says_what_is_wrong_and_which_help_tells_more(
    words: tuple[str, ...], sentence: str
) -> None:
    assert said(*words) == sentence


def test_a_number_that_is_none_is_told_with_what_came() -> None:
    words = said("show", "--grasp", "many")
    assert "it must be a valid integer" in words
    assert words.endswith("got 'many'. See `program show --help`.")


def test_an_error_that_knows_no_command_names_the_program() -> None:
    assert misuse(typer.BadParameter("--out is missing: name a file."), "program") == (
        "Invalid value: --out is missing: name a file. See `program --help`."
    )
