"""Reads questions in Prometheus' language, as far as rules and dashboard need it, and refuses all others."""

import re

from tests.deploy.promql import (
    AGGREGATIONS,
    COMPARISONS,
    EACH,
    FOREMOST,
    MATCHES,
    OVER_TIME,
    Aggregation,
    Each,
    Expression,
    Foremost,
    Number,
    Operation,
    OverTime,
    Selector,
)

UNITS = {"s": 1, "m": 60, "h": 3600, "d": 86_400}
TOKEN = re.compile(
    r"\s*(?:(?P<number>\d+(?:\.\d+)?)|(?P<name>[a-zA-Z_:][a-zA-Z0-9_:]*)|(?P<text>\"(?:[^\"\\]|\\.)*\")"
    r"|(?P<sign>==|!=|>=|<=|=~|!~|[-+*/(){}\[\],<>=]))"
)
DURATION = re.compile(r"\s*(\d+)([smhd])\]")
LOOSEST_FIRST = ((*("and", "unless"),), tuple(COMPARISONS), ("+", "-"), ("*", "/"))


class Reader:
    """Reads a question, token by token."""

    def __init__(self, text: str) -> None:
        self._text, self._place = text, 0

    def whole(self) -> Expression:
        found = self._binary(0)
        if self._peek():
            raise ValueError(f"{self._text!r} goes on with {self._text[self._place :]!r}")
        return found

    def _peek(self) -> str:
        found = TOKEN.match(self._text, self._place)
        if found is None and self._text[self._place :].strip():
            raise ValueError(f"{self._text[self._place :]!r} cannot be read")
        return found[found.lastgroup or 0] if found else ""

    def _take(self, *expected: str) -> str:
        token, found = self._peek(), TOKEN.match(self._text, self._place)
        if not found or (expected and token not in expected):
            raise ValueError(f"expected one of {expected} at {self._text[self._place :]!r}")
        self._place = found.end()
        return token

    def _binary(self, level: int) -> Expression:
        if level == len(LOOSEST_FIRST):
            return self._primary()
        left = self._binary(level + 1)
        while (sign := self._peek()) in LOOSEST_FIRST[level]:
            self._take()
            on = self._names("on")
            left = Operation(sign, on, instant(left), instant(self._binary(level + 1)))
        return left

    def _names(self, word: str) -> tuple[str, ...] | None:
        """The labels behind `by` or `on`; None where that word is not there."""
        if self._peek() != word:
            return None
        self._take(word)
        self._take("(")
        names = [self._take()]
        while self._take(",", ")") == ",":
            names.append(self._take())
        return tuple(names)

    def _primary(self) -> Expression:
        first = self._take()
        if first[:1] == "(":
            inner = self._binary(0)
            self._take(")")
            return inner
        if first[:1].isdigit():
            return Number(float(first))
        if first in AGGREGATIONS or first in FOREMOST:
            return self._aggregation(first)
        return self._call(first) if self._peek() == "(" else self._selector(first)

    def _aggregation(self, name: str) -> Expression:
        by = self._names("by")
        arguments = self._arguments()
        by = by or self._names("by") or ()
        if name in FOREMOST:
            most, inner = arguments
            assert isinstance(most, Number)
            return Foremost(int(most.value), FOREMOST[name], instant(inner))
        (inner,) = arguments
        return Aggregation(AGGREGATIONS[name], by, instant(inner))

    def _call(self, name: str) -> Expression:
        arguments = self._arguments()
        if name in OVER_TIME:
            (inner,) = arguments
            if not (isinstance(inner, Selector) and inner.window):
                raise ValueError(f"{name} wants to know over which time, such as [5m]: {self._text!r}")
            return OverTime(OVER_TIME[name], inner)
        if name not in EACH:
            raise ValueError(f"there is no function {name!r} here")
        return Each(EACH[name], instant(arguments[0]), tuple(arguments[1:]))

    def _arguments(self) -> list[Expression]:
        self._take("(")
        found = [self._binary(0)]
        while self._take(",", ")") == ",":
            found.append(self._binary(0))
        return found

    def _selector(self, name: str) -> Selector:
        if not re.fullmatch(r"[a-zA-Z_:]\w*", name):
            raise ValueError(f"{name!r} is no metric")
        matchers = []
        if self._peek() == "{":
            self._take()
            while self._peek() != "}":
                label, how, value = self._take(), self._take(*MATCHES), self._take()
                re.compile(value[1:-1])
                matchers.append((label, how, value[1:-1]))
                if self._peek() != "}":
                    self._take(",")
            self._take("}")
        return Selector(name, tuple(matchers), self._window())

    def _window(self) -> float | None:
        if self._peek() != "[":
            return None
        self._take("[")
        found = DURATION.match(self._text, self._place)
        if found is None:
            raise ValueError(f"{self._text[self._place :]!r} begins with no time")
        self._place = found.end()
        return float(found[1]) * UNITS[found[2]]


def instant(inner: Expression) -> Expression:
    """The same, where it has one value at a time."""
    if isinstance(inner, Selector) and inner.window:
        raise ValueError(f"{inner.name} has many values: what of them?")
    return inner


def read(text: str) -> Expression:
    """A question to Prometheus.

    Raises
    ------
    ValueError
        It is none, or more than is understood here.
    """
    return instant(Reader(text).whole())
