"""Alert rules over time: which alerts there are of given series, and what they say."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tests.deploy.promql import Data, Labels, Selector, vector
from tests.deploy.promql_reader import UNITS, read

TEMPLATE = re.compile(r"\{\{\s*(\$labels\.(\w+)|\$value)(?:\s*\|\s*(\w+))?\s*\}\}")
PIECE = re.compile(r"(\d+)(?:\+(\d+))?(?:x(\d+))?")
WORDS = {"": lambda value: f"{value:.6g}", "humanizePercentage": lambda value: f"{100 * value:.4g}%"}


@dataclass(frozen=True)
class Alert:
    """One that fires."""

    labels: Labels
    words: tuple[tuple[str, str], ...]


def seconds(text: str) -> float:
    """A time such as 5m [s]."""
    return float(text[:-1]) * UNITS[text[-1]]


def values(notation: str) -> Iterator[float]:
    """The values that a notation stands for: `0+10x3 7x2` are 0 10 20 30 7 7 7."""
    for piece in notation.split():
        found = PIECE.fullmatch(piece)
        assert found, piece
        first, step, more = (float(part or 0) for part in found.groups())
        yield from (first + number * step for number in range(int(more) + 1))


def data(series: Sequence[Mapping[str, str]], interval: float) -> Data:
    """The series of a test."""
    known = {}
    for one in series:
        selector = read(one["series"])
        assert isinstance(selector, Selector)
        labels = frozenset((label, value) for label, _, value in selector.matchers)
        samples = [(number * interval, value) for number, value in enumerate(values(one["values"]))]
        known[selector.name, labels] = samples
    return Data(known)


def firing(rule: Mapping[str, Any], series: Data, until: float, step: float) -> list[Alert]:
    """The alerts of a rule that fire at a time, where it is looked at in such steps from the beginning."""
    expression, since = read(rule["expr"]), dict[Labels, float]()
    found: dict[Labels, float] = {}
    for number in range(int(until / step) + 1):
        now = number * step
        found = vector(expression.at(series, now))
        since = {labels: since.get(labels, now) for labels in found}
    return [
        Alert(labels | {*rule["labels"].items()}, told(rule["annotations"], labels, value))
        for labels, value in found.items()
        if until - since[labels] >= seconds(rule["for"])
    ]


def told(annotations: Mapping[str, str], labels: Labels, value: float) -> tuple[tuple[str, str], ...]:
    """What an alert says."""
    known = dict(labels)

    def filled(found: re.Match[str]) -> str:
        return known.get(found[2], "") if found[2] else WORDS[found[3] or ""](value)

    return tuple(sorted((name, TEMPLATE.sub(filled, words)) for name, words in annotations.items()))
