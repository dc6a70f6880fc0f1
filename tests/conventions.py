"""Check the conventions of the source tree: names, sizes, first lines, terms (CONTRIBUTING.md).

`python -m tests.conventions` prints each violation as `file:line: sentence` and ends with 1 if there is one;
`python -m tests.conventions --counts` prints the size of every room instead.
"""

import argparse
import ast
import re
import subprocess
import sys
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import click
import typer
from tests.deploy.commands import COMMANDS

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("protocol", "assets", "worker", "coordinator")

MOST_IN_FOLDER = 18
MOST_IN_MODULE = 500
MOST_IN_FIRST_LINE = 90
LEAST_OF_ONE_NEIGHBOUR = 100
"""Lines: a shorter module whose only importer stands in the same folder belongs into that importer."""

QUESTION_WORDS = ("what", "which", "who", "whose", "whoever", "whom", "how", "where", "whether", "why")
RIDDLES = (r"\bis none\b", r"\bare none\b", r"\bnobody\b", r"\bsomebody\b", r"\bwhoever\b", r"^hear\b")
ALLEGORY = frozenset((
    "agenda", "appointment", "belt", "board", "books", "chronicle", "crew", "desk", "docket", "doors",
    "errand", "errands", "exhibit", "exhibits", "eye", "film", "gate", "holding", "lane", "lanes",
    "ledger", "legend", "librarian", "lot", "lots", "mate", "moment", "opener", "orders", "reception",
    "register", "roster", "rota", "scenery", "scribe", "skin", "slot", "spare", "stage", "stretch",
    "swath", "tally", "ticket", "told", "turn", "upshot", "vitals", "witness", "workshop"
))  # fmt: skip
"""Words of a place of work that must be imagined; not to be in the name of a module or a class."""


@dataclass(frozen=True)
class Violation:
    """One departure from the conventions.

    Attributes
    ----------
    path
        The file, from the root of the repository.
    line
        The line in it; 1 for the file as a whole.
    sentence
        The rule that is broken, and by how much.
    """

    path: str
    line: int
    sentence: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.sentence}"


class Module:
    """One Python file of the repository, parsed."""

    def __init__(self, root: Path, path: str) -> None:
        self.path = path
        self.text = (root / path).read_text()
        self.lines = self.text.count("\n")
        name = path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        room, _, rest = name.partition(".")
        self.name = rest if room in ROOMS else name
        self.folder = path.rpartition("/")[0]

    @cached_property
    def tree(self) -> ast.Module:
        """The syntax tree."""
        return ast.parse(self.text)

    @property
    def is_source(self) -> bool:
        """Whether it is part of the package, not a test or an example."""
        return self.path.split("/")[0] in ROOMS

    @property
    def is_init(self) -> bool:
        """Whether it stands for its folder."""
        return self.path.endswith("__init__.py")

    @property
    def is_main(self) -> bool:
        """Whether `python -m` starts its folder with it; it may call an entry point of a neighbour."""
        return self.path.endswith("__main__.py")

    @property
    def is_started(self) -> bool:
        """Whether a process starts with it."""
        return '__name__ == "__main__"' in self.text or self.is_main

    def imported(self) -> Iterator[str]:
        """Name every module that may be imported here, functions included."""
        for node in ast.walk(self.tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                yield node.module
                yield from (f"{node.module}.{alias.name}" for alias in node.names)
            elif isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)


class Repository:
    """The files of the repository that git knows or that are new and not ignored."""

    def __init__(self, root: Path = ROOT) -> None:
        self.root = root
        listed = self.git("ls-files", "--cached", "--others", "--exclude-standard")
        self.files = [file for file in sorted(set(listed.splitlines())) if (root / file).is_file()]
        self.modules = [Module(root, file) for file in self.files if file.endswith(".py")]
        self.source = [module for module in self.modules if module.is_source]
        self.tests = [module for module in self.modules if module.path.startswith("tests/")]
        self.scripts = [
            file
            for file in self.files
            if file.endswith(".js") and file.startswith(ROOMS) and "/vendor/" not in file
        ]

    def git(self, *words: str) -> str:
        """Return the output of a command of git; empty where it fails, as for a commit that is not there."""
        command = ["git", *words]
        return subprocess.run(command, cwd=self.root, capture_output=True, text=True, check=False).stdout


ROOM_FOLDERS = {
    "protocol": "protocol/",
    "assets": "assets/",
    "worker": "worker/",
    "coordinator": "coordinator/qdgrasp_coordinator/",
    "tools": "coordinator/qdgrasp_tools/",
    "qdgrasp": "coordinator/qdgrasp/",
    "tests": "tests/",
    "benchmarks": "benchmarks/",
}
BUDGETS = "budgets.toml"
PAGES = r"(docs/.*|README|CHANGELOG|CONTRIBUTING)\.md"


def counts(repository: Repository) -> dict[str, dict[str, float]]:
    """Return the sizes that `budgets.toml` has ceilings for, by its tables and names."""
    lines: dict[str, float] = {
        name: sum(module.lines for module in repository.modules if module.path.startswith(folder))
        for name, folder in ROOM_FOLDERS.items()
    }
    lines["source"] = sum(module.lines for module in repository.source)
    lines["page"] = sum((repository.root / file).read_text().count("\n") for file in repository.scripts)
    pages = [
        file
        for file in repository.files
        if re.fullmatch(r"(docs/.*|README|CHANGELOG|CONTRIBUTING).*\.md", file)
    ]
    other = {
        "modules": len(repository.source),
        "test_share": round(lines["tests"] / max(1, lines["source"]), 3),
        "words": sum(len((repository.root / page).read_text(encoding="utf-8").split()) for page in pages),
        "run_options": len(_options("run")),
        "commands": _command_count(),
    }
    return {"lines": lines, "other": other}


def _options(name: str) -> list[click.Parameter]:
    """Return the options of a command of `qdgrasp`, without arguments and those that every command has."""
    command = typer.main.get_command(COMMANDS["qdgrasp"]).commands[name]  # type: ignore[attr-defined]
    return [
        one
        for one in command.params
        if one.param_type_name == "option" and one.name not in ("version", "help")
    ]


def _command_count() -> int:
    """Return the number of commands: those of `qdgrasp` without groups, and the other programs."""

    def leaves(command: click.Command) -> int:
        parts = getattr(command, "commands", None)
        return sum(map(leaves, parts.values())) if parts else 1

    return sum(leaves(typer.main.get_command(app)) for app in COMMANDS.values())


def too_large(repository: Repository) -> Iterator[Violation]:
    """Find sizes above their ceilings, ceilings that were raised, and folders that hold too much."""
    text = (repository.root / BUDGETS).read_text(encoding="utf-8")
    ceilings, found = tomllib.loads(text), counts(repository)
    for table, limits in ceilings.items():
        for name, most in limits.items():
            if found[table][name] > most:
                yield Violation(BUDGETS, 1, f"{name}: {found[table][name]:g}; at most {most:g}")
    for before, after in (("HEAD", None), ("HEAD~1", "HEAD")):
        changed = set(repository.git("diff", "--name-only", before, *([after] if after else [])).split())
        old = tomllib.loads(repository.git("show", f"{before}:{BUDGETS}"))
        new = tomllib.loads(repository.git("show", f"{after}:{BUDGETS}")) if after else ceilings
        for table, limits in old.items():
            for name, most in limits.items():
                if new.get(table, {}).get(name, sys.maxsize) > most and changed != {BUDGETS}:
                    yield Violation(BUDGETS, 1, f"{name} was raised, in a change of other files")
    for folder, number in Counter(module.folder for module in repository.modules).items():
        if number > MOST_IN_FOLDER:
            yield Violation(folder, 1, f"{number} modules in one folder; at most {MOST_IN_FOLDER}")


def circles(repository: Repository) -> Iterator[Violation]:
    """Find a circle of modules that import each other, imports inside functions included."""
    known = {module.name: module for module in repository.source}
    graph = {
        name: {
            other
            for other in module.imported()
            if other in known and other != name and not known[other].is_init
        }
        for name, module in known.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        yield Violation(known[error.args[1][0]].path, 1, f"a circle of imports: {' -> '.join(error.args[1])}")


def too_long(repository: Repository) -> Iterator[Violation]:
    """Find modules that are too long, and short ones that one neighbour alone imports."""
    importers: dict[str, set[str]] = defaultdict(set)
    source = {module.name: module for module in repository.source}
    for module in repository.source:
        for name in module.imported():
            if name in source and name != module.name:
                importers[name].add(module.name)
    for module in repository.source:
        if module.lines > MOST_IN_MODULE:
            yield Violation(module.path, 1, f"{module.lines} lines; at most {MOST_IN_MODULE}")
        if module.is_init or module.lines > LEAST_OF_ONE_NEIGHBOUR or module.is_started:
            continue
        if len(importers[module.name]) == 1:
            (only,) = importers[module.name]
            if source[only].folder == module.folder and not (source[only].is_init or source[only].is_main):
                sentence = f"only {only} imports it, and it has {module.lines} lines: it belongs in there"
                yield Violation(module.path, 1, sentence)


def repeated_names(repository: Repository) -> Iterator[Violation]:
    """Find class names that stand for two classes, and file names that occur twice in a room."""
    first: dict[str, str] = {}
    for module in repository.source:
        for node in ast.walk(module.tree):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                if node.name in first:
                    sentence = f"class {node.name} is also defined in {first[node.name]}"
                    yield Violation(module.path, node.lineno, sentence)
                first.setdefault(node.name, module.path)
    seen: dict[tuple[str, str], str] = {}
    for module in repository.source:
        key = module.name.split(".")[0], Path(module.path).name
        if module.is_init or key[1] == "__main__.py":
            continue
        if key in seen:
            yield Violation(module.path, 1, f"there is {seen[key]} already: one file name once in a room")
        seen.setdefault(key, module.path)


def riddles(repository: Repository) -> Iterator[Violation]:
    """Find docstrings whose first line is too long, a question or a riddle."""
    for module in repository.source:
        for node in ast.walk(module.tree):
            if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            line = (ast.get_docstring(node) or "").split("\n")[0]
            at = getattr(node, "lineno", 1)
            if len(line) > MOST_IN_FIRST_LINE:
                sentence = f"first line of {len(line)} characters; at most {MOST_IN_FIRST_LINE}"
                yield Violation(module.path, at, sentence)
            words = re.findall(r"[a-z']+", line.lower())
            if words and words[0] in QUESTION_WORDS:
                yield Violation(module.path, at, f"the first line begins with a question word: {line!r}")
            if any(re.search(riddle, line.lower()) for riddle in RIDDLES):
                yield Violation(module.path, at, f"the first line is a riddle: {line!r}")


def unknown_terms(repository: Repository) -> Iterator[Violation]:
    """Find words in names of modules and classes that neither glossary nor the list of plain words has."""
    glossary = (repository.root / "docs" / "glossary.md").read_text().lower()
    plain = (repository.root / "tests" / "plain_words.txt").read_text().split()
    known = set(re.findall(r"[a-z0-9]+", glossary)) | set(plain)
    for module in repository.source:
        names = [(1, Path(module.path).stem)] if not module.is_init else [(1, Path(module.folder).name)]
        names += [
            (node.lineno, node.name) for node in ast.walk(module.tree) if isinstance(node, ast.ClassDef)
        ]
        for line, name in names:
            for word in _words(name):
                if word in ALLEGORY:
                    yield Violation(module.path, line, f"'{word}' in {name} is a metaphor (docs/glossary.md)")
                elif not _forms(word) & known:
                    sentence = f"'{word}' in {name} is in neither docs/glossary.md nor tests/plain_words.txt"
                    yield Violation(module.path, line, sentence)


def _words(name: str) -> list[str]:
    """Split a name in snake or camel case into lower-case words."""
    return [part.lower() for part in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)]


def _forms(word: str) -> set[str]:
    """Return a word as it is and in the singular."""
    forms = {word, word.removesuffix("s"), word.removesuffix("es")}
    return forms | {word.removesuffix("ies") + "y"} if word.endswith("ies") else forms


CHECKS = (too_large, circles, too_long, repeated_names, riddles, unknown_terms)


def violations(repository: Repository) -> Iterable[Violation]:
    """Apply every check."""
    for check in CHECKS:
        yield from check(repository)


def main(arguments: list[str] | None = None) -> int:
    """Print violations, or the counts; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--counts", action="store_true", help="print files and lines of every room")
    options = parser.parse_args(arguments)
    repository = Repository()
    if options.counts:
        for table in counts(repository).values():
            for name, size in table.items():
                sys.stdout.write(f"{name:12} {size:8g}\n")
        return 0
    found = list(violations(repository))
    last = f"{len(found)} violations of the conventions" if found else "The conventions are kept."
    sys.stdout.write("\n".join([*map(str, found), last, ""]))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
