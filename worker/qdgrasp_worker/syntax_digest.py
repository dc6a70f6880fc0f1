"""The digest of code by its syntax tree, independent of the places and names of definitions.

1. The functions, classes and constants of this package count that the entries reach by name, in any module.
2. Each counts as its syntax tree without docstrings, without the types of arguments, results and variables,
   and without the errors that are raised. A name that this package defines is replaced by the digest of its
   definition, any other imported name by its full name, such as `numpy.sin`.
3. The digest is the sha256 over all of them, sorted.

So definitions may move between modules and be renamed, while each change of their computation counts. Names
of fields, methods, arguments and variables count too: the things that they refer to are not known.
"""

import ast
import hashlib
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

OURS = "qdgrasp"  # Prefix of the names of this package's modules
REFERENCE = re.compile(r"<([\w.]+):(\w+)>")  # Reference to another definition until that has a digest


class Key(NamedTuple):
    """Name of a definition."""

    module: str
    name: str


class Module(NamedTuple):
    """The definitions and imports of a module."""

    definitions: Mapping[str, list[tuple[int, ast.stmt]]]
    """Statements that define each of its names, with the name's place among several."""
    imports: Mapping[str, str]
    """Full name that each imported name stands for, such as `numpy.typing.NDArray`."""
    others: list[ast.stmt]
    """Statements that define nothing: they are not counted."""


class Definition(NamedTuple):
    """The counted part of a definition."""

    text: str
    """Its tree, with references to others as in `REFERENCE`."""
    unknown: frozenset[str]
    """Names in it that are neither defined nor imported: Python's own."""

    @property
    def references(self) -> Iterator[Key]:
        """The definitions that it refers to."""
        return (Key(*found) for found in REFERENCE.findall(self.text))


def syntax_digest(*entries: Callable[..., object] | Key) -> str:
    """The sha256 over these classes and functions and all that they reach, 64 hex digits.

    A `Key` names one whose module is not imported.
    """
    return _sha256("".join(sorted(digests(reached(*entries)).values())))


def reached(*entries: Callable[..., object] | Key) -> dict[Key, Definition]:
    """The definitions that these classes and functions reach by name, themselves among them."""
    found: dict[Key, Definition] = {}
    waiting = [
        entry if isinstance(entry, Key) else Key(entry.__module__, entry.__qualname__) for entry in entries
    ]
    while waiting:
        key = waiting.pop()
        if key not in found:
            found[key] = _definition(key)
            waiting += found[key].references
    return found


def digests(definitions: Mapping[Key, Definition]) -> dict[Key, str]:
    """A digest of each definition, which includes those of all definitions that it refers to.

    Definitions may refer to each other in a circle. So all digests begin equal, and those of one round are
    made of those of the round before, until a further round distinguishes no more of them.
    """
    found, kinds = dict.fromkeys(definitions, ""), 0
    while len(set(found.values())) > kinds:
        kinds, before = len(set(found.values())), found
        found = {key: _sha256(_resolved(one.text, before)) for key, one in definitions.items()}
    return found


def _resolved(text: str, known: Mapping[Key, str]) -> str:
    return REFERENCE.sub(lambda match: known[Key(*match.groups())], text)


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def read(name: str) -> Module:
    """The module of that name, in this package."""
    spec = find_spec(name)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(name)
    tree = ast.parse(Path(spec.origin).read_bytes())
    definitions: dict[str, list[tuple[int, ast.stmt]]] = {}
    others = []
    for statement in tree.body:
        names = list(_defined(statement))
        for place, each in enumerate(names):
            definitions.setdefault(each, []).append((place, statement))
        if not names:
            others.append(statement)
    return Module(definitions, dict(_imported(tree)), others)


def _defined(statement: ast.stmt) -> Iterator[str]:
    match statement:
        case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
            yield name
        case ast.Assign() | ast.AnnAssign():
            yield from _stored(statement)


def _stored(tree: ast.AST) -> Iterator[str]:
    """The names that are given a value somewhere in a tree."""
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name, ctx=ast.Store() | ast.Del()) | ast.arg(arg=name):
                yield name
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                yield name
            case (
                ast.ExceptHandler(name=str(name))
                | ast.MatchAs(name=str(name))
                | ast.MatchStar(name=str(name))
            ):
                yield name


def _imported(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """The names that a module imports, anywhere in it, with their full names."""
    for node in ast.walk(tree):
        match node:
            case ast.Import(names=names):
                yield from ((one.asname, one.name) for one in names if one.asname)
                yield from (
                    (root, root) for one in names if not one.asname for root in [one.name.split(".")[0]]
                )
            case ast.ImportFrom(module=str(module), names=names):
                yield from ((one.asname or one.name, f"{module}.{one.name}") for one in names)


def _meant(module: str, name: str) -> Key | str | None:
    """The definition or full name that a name in a module stands for; None: unknown."""
    written = read(module)
    if name in written.definitions:
        return Key(module, name)
    if (full := written.imports.get(name)) is None:
        return None
    home, _, there = full.rpartition(".")
    if not home.startswith(OURS):
        return full
    return _meant(home, there) or full  # else it is a module of ours


def _definition(key: Key) -> Definition:
    texts, unknown = [], set[str]()
    for place, statement in read(key.module).definitions[key.name]:
        text, strange = _counted(key.module, statement)
        texts.append(f"{place} {text}")
        unknown |= strange
    return Definition("\n".join(texts), frozenset(unknown))


@cache
def _counted(module: str, statement: ast.stmt) -> tuple[str, set[str]]:
    """The counted part of a statement, which is changed in place, and its unknown names."""
    reader = _Reader(module)
    tree = reader.visit(statement)
    if isinstance(tree, ast.FunctionDef | ast.ClassDef):
        tree.name = ""
    return _dump(tree), reader.unknown


EMPTY = {"show_empty": True} if sys.version_info >= (3, 13) else {}  # Later Pythons leave empty lists out


def _dump(tree: ast.AST) -> str:
    """A tree as text, as Python 3.11 gives it: later ones have a field for types' parameters."""
    for node in ast.walk(tree):
        if getattr(node, "type_params", None) == []:
            vars(node).pop("type_params")
    return ast.dump(tree, **EMPTY)


class _Reader(ast.NodeTransformer):
    def __init__(self, module: str) -> None:
        self.unknown: set[str] = set()
        self._module = module
        self._local: list[set[str]] = []
        self._in_class = False

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        """The types of a class's fields count: they decide which values are read into them."""
        outside, self._in_class = self._in_class, True
        self.generic_visit(node)
        self._in_class = outside
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        """Names of a function's own hide those of the module."""
        node.returns = None
        node.decorator_list = [self.visit(one) for one in node.decorator_list]
        outside, self._in_class = self._in_class, False
        self._local.append({name for part in (node.args, *node.body) for name in _stored(part)})
        node.args = self.visit(node.args)
        node.body = [visited for one in node.body if (visited := self.visit(one))]
        self._local.pop()
        self._in_class = outside
        return node

    def visit_Lambda(self, node: ast.Lambda) -> ast.AST:
        """Names of a lambda's own hide those of the module."""
        self._local.append(set(_stored(node)))
        self.generic_visit(node)
        self._local.pop()
        return node

    def visit_arg(self, node: ast.arg) -> ast.AST:
        """The type of an argument does not count."""
        node.annotation = None
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        """The type of a field counts; that of a variable does not."""
        if not self._in_class:
            node.annotation = ast.Constant(None)
        return self.generic_visit(node)

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        """Leave out docstrings, which are expressions of text alone."""
        is_text = isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        return None if is_text else self.generic_visit(node)

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        """Leave errors out: neither their kind nor their sentence is a result."""
        return ast.Raise()

    def visit_Import(self, node: ast.Import) -> None:
        """Leave out imports: a name counts where it is used."""

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        """Leave out imports: a name counts where it is used."""

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        """Replace a name in a module of ours by its definition."""
        if isinstance(node.value, ast.Name) and not self._is_local(node.value.id):
            module = _meant(self._module, node.value.id)
            if isinstance(module, str) and module.startswith(OURS):
                return self._named(_meant(module, node.attr), node.attr)
        return self.generic_visit(node)

    def visit_Name(self, node: ast.Name) -> ast.AST:
        """Replace a name by its definition, unless a function or class has its own of it."""
        is_field = self._in_class and isinstance(node.ctx, ast.Store)
        if is_field or self._is_local(node.id):
            return node
        return self._named(_meant(self._module, node.id), node.id)

    def _named(self, meant: Key | str | None, name: str) -> ast.AST:
        if meant is None:
            self.unknown.add(name)
        found = ast.Name(f"<{meant.module}:{meant.name}>" if isinstance(meant, Key) else meant or name)
        vars(found).pop("ctx", None)  # which Python 3.13 adds
        return found

    def _is_local(self, name: str) -> bool:
        return any(name in names for names in self._local)
