"""What `qdgrasp gripper new` asks: each question with what is guessed as its default."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import typer

from qdgrasp_assets.hands.draft import Draft, Told, draft
from qdgrasp_assets.urdf import Urdf
from qdgrasp_protocol.errors import ImpossibleValue, QdgraspError
from qdgrasp_protocol.phrases import numbers

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Question:
    """Something to ask of a hand."""

    field: str
    """Of `Told`, and of the file."""
    words: str
    read: Callable[[str, str], Any]
    """What an answer means, by its field and its text; raises ImpossibleValue."""


def ask(robot: Urdf, urdf: str, told: Told) -> Told:
    """Ask on the terminal what is not told yet; an empty answer takes the guess."""
    for question in QUESTIONS:
        if getattr(told, question.field) is None:
            told = _answered(question, robot, draft(robot, urdf, told), told)
    return told


def _answered(question: Question, robot: Urdf, guessed: Draft, told: Told) -> Told:
    guess = _text(getattr(guessed.file, question.field))
    typer.echo(f"# {guessed.reasons[question.field]}")
    while True:
        answer = typer.prompt(question.words, default=guess)
        if answer == guess:
            return told
        try:
            answered = replace(told, **{question.field: question.read(question.field, answer)})
            draft(robot, guessed.file.urdf, answered)
        except QdgraspError as error:
            typer.echo(str(error))
        else:
            return answered


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    return ",".join(_text(each) for each in value) if isinstance(value, Iterable) else f"{value:g}"


def words(_: str, text: str) -> tuple[str, ...]:
    """Names between commas."""
    return tuple(word.strip() for word in text.split(",") if word.strip())


def text(_: str, answer: str) -> str:
    """The answer itself."""
    return answer.strip()


def vector(field: str, text: str) -> Vector:
    """Three numbers between commas.

    Raises
    ------
    ImpossibleValue
        It is something else.
    """
    x, y, z = _numbers(field, text, 3, "three numbers such as 0,0,1")
    return x, y, z


def pair(field: str, text: str) -> tuple[float, float]:
    """Two numbers between commas; errors as of `vector`."""
    least, greatest = _numbers(field, text, 2, "two numbers such as 0,0.05")
    return least, greatest


def number(field: str, text: str) -> float:
    """A number; errors as of `vector`."""
    (value,) = _numbers(field, text, 1, "a number such as 0.05")
    return value


def positions(field: str, texts: Iterable[str]) -> dict[str, float]:
    """Joint positions from `NAME=VALUE`; errors as of `vector`."""
    found = {}
    for part in (part for text in texts for part in text.split(",")):
        name, _, value = part.rpartition("=")
        if not name:
            raise ImpossibleValue(field, part, "JOINT=POSITION, in rad or m")
        found[name.strip()] = number(f"{field} {name}", value)
    return found


def _numbers(field: str, text: str, count: int, expected: str) -> list[float]:
    found = numbers(text)
    if len(found) != count or not all(map(math.isfinite, found)):
        raise ImpossibleValue(field, text, expected)
    return found


QUESTIONS = (
    Question("base_link", "Base link, on which the hand hangs", text),
    Question("approach_axis", "Approach axis, from the palm to the object, base link's frame", vector),
    Question("palm_offset", "From the base link to the palm along it [m]", number),
    Question("standoff", "Stand-off, from the palm to the surface: least,greatest [m]", pair),
    Question("finger_links", "Finger links, whose touch makes a success", words),
    Question("licence", "Licence of the hand's files", text),
)
