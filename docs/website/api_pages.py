"""The API reference, made from the docstrings of the source tree without importing it.

The packages are those of the wheel in pyproject.toml; their modules are listed at build time. `qdgrasp`
comes first, with what it exports described on its own page. Every other module has a page below its package.
"""

import re
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from textwrap import indent

import griffe
from markdown_pages import Pages
from sphinx.ext.napoleon import Config, NumpyDocstring

FACE = "qdgrasp"
STYLE = Config(napoleon_google_docstring=False, napoleon_use_ivar=True, napoleon_use_rtype=False)
LONGEST_VALUE = 60
"""Characters of a constant's value that is shown."""
CODE = re.compile(r"(``[^`]*``|`[^`]*`)")
MARKUP = re.compile(r"(?<!^)(?<!\n)\*|\*(?! )|\||(?<=\w)_(?!\w)")
"""Markup of reStructuredText that docstrings use as plain characters; bullets stay markup."""
PAGE = re.compile(r"\bdocs/([\w/-]+)\.md\b")
TYPED = re.compile(r"\S {3,}\S|^ +\* ", re.MULTILINE)
"""Text that is aligned in columns, or a tree of bullets."""


def pages(root: Path) -> Pages:
    """Return the pages of the reference, by their path in the site."""
    wheel = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]
    folders = [root / folder for folder in wheel["targets"]["wheel"]["packages"]]
    loader = griffe.GriffeLoader(
        search_paths=sorted({folder.parent for folder in folders}), allow_inspection=False
    )
    packages = [loader.load(folder.name) for folder in folders]
    packages.sort(key=lambda package: package.name != FACE)
    loader.resolve_aliases(implicit=True, external=False)
    made: Pages = {"api/index.rst": contents(packages)}
    for package in packages:
        modules = list(below(package))
        made[f"api/{package.path}.rst"] = package_page(package, modules, root)
        made |= {f"api/{module.path}.rst": module_page(module, root) for module in modules}
    return made


def below(package: griffe.Module) -> Iterator[griffe.Module]:
    """Yield the public modules of a package, also those of its folders."""
    for module in sorted(package.modules.values(), key=lambda module: module.name):
        if not module.is_alias and not module.name.startswith("_"):
            yield module
            yield from below(module)


def contents(packages: list[griffe.Module]) -> str:
    """Return the page that lists the packages."""
    listed = [f"   {package.path}" for package in packages]
    rows = [f"* :doc:`{package.path}`: {summary(package)}" for package in packages]
    text = f"Programs import from `{FACE}`; the other packages are what it is made of and may change."
    return "\n".join([heading("API"), text, "", *rows, "", ".. toctree::", "   :hidden:", "", *listed, ""])


def package_page(package: griffe.Module, modules: list[griffe.Module], root: Path) -> str:
    """Return the page of a package: what it exports, and its modules by folder."""
    lines = [heading(package.path), *module_head(package, root)]
    for name in package.exports or []:
        if str(name) in package.members and not str(name).startswith("_"):
            member = package.members[str(name)]
            lines += describe(member.final_target if member.is_alias else member, str(name))
    folders: dict[str, list[griffe.Module]] = defaultdict(list)
    for module in modules:
        if not module.is_init_module:
            folders[module.parent.path].append(module)
    for folder, inside in sorted(folders.items()):
        lines += [heading(folder if folder != package.path else "Modules", "-")]
        if folder != package.path:
            lines += [f":doc:`{folder}`: {summary(package.modules_collection[folder])}", ""]
        lines += [f"* :doc:`{module.name} <{module.path}>`: {summary(module)}" for module in inside]
        lines += [""]
    return "\n".join(lines)


def module_page(module: griffe.Module, root: Path) -> str:
    """Return the page of a module."""
    package = module.package.path
    lines = [":orphan:", "", heading(module.path), f"In :doc:`{package}`.", "", *module_head(module, root)]
    lines += [f"* :doc:`{inner.path}`: {summary(inner)}" for inner in below(module)] + [""]
    for member in public(module):
        lines += describe(member, member.name)
    return "\n".join(lines)


def module_head(module: griffe.Module, root: Path) -> list[str]:
    """Return the lines that open a page: the module, its file, its docstring."""
    file = Path(str(module.filepath)).relative_to(root)
    return [f".. py:module:: {module.path}", "", f"File ``{file}``.", "", *docstring(module), ""]


def public(owner: griffe.Module | griffe.Class) -> list[griffe.Object]:
    """Return what is described of a module or class, in the order of the source."""
    own = [member for member in owner.members.values() if not member.is_alias and not member.is_module]
    shown = [
        member
        for member in own
        if not member.name.startswith("_")
        and (member.has_docstring or not member.is_attribute or owner.is_class)
        and not (member.is_attribute and "instance-attribute" in member.labels and not member.has_docstring)
    ]
    return sorted(shown, key=lambda member: member.lineno or 0)


def describe(what: griffe.Object, name: str) -> list[str]:
    """Return the directive of an object, its members within it."""
    if what.is_class:
        head = [f".. py:class:: {name}{class_signature(what)}"]
        body = docstring(what)
        if what.bases:
            body = ["Bases: " + ", ".join(f"``{base}``" for base in what.bases), "", *body]
        for member in public(what):
            body += ["", *describe(member, member.name)]
    elif what.is_function:
        kind = "method" if what.parent.is_class else "function"
        flags = {"staticmethod", "classmethod", "async", "abstractmethod"} & set(what.labels)
        returns = f" -> {plain(what.returns)}" if what.returns is not None else ""
        parameters = (
            what.parameters if kind == "function" or "staticmethod" in flags else list(what.parameters)[1:]
        )
        head = [f".. py:{kind}:: {name}{signature(parameters)}{returns}"]
        head += [f"   :{flag}:" for flag in sorted(flags) if kind == "method" or flag == "async"]
        body = docstring(what)
    else:
        is_property = "property" in what.labels
        kind = "property" if is_property else "attribute" if what.parent.is_class else "data"
        head = [f".. py:{kind}:: {name}"]
        if what.annotation is not None:
            head += [f"   :type: {plain(what.annotation)}"]
        value = "" if is_property or "instance-attribute" in what.labels else one_line(str(what.value or ""))
        if 0 < len(value) <= LONGEST_VALUE:
            head += [f"   :value: {value}"]
        body = docstring(what)
    return [*head, "", *indent("\n".join(body), "   ").splitlines(), ""]


def class_signature(what: griffe.Class) -> str:
    """Return the parameters of a class, where it has an initialiser."""
    maker = what.members.get("__init__")
    return signature(list(maker.parameters)[1:]) if maker is not None and maker.is_function else ""


def signature(parameters: Iterable[griffe.Parameter]) -> str:
    """Return parameters in brackets as Python writes them, annotations without what is attached to them."""
    stars = {griffe.ParameterKind.var_positional: "*", griffe.ParameterKind.var_keyword: "**"}
    texts: list[str] = []
    kinds: list[griffe.ParameterKind | None] = []
    for parameter in parameters:
        kind = parameter.kind
        if kinds and kinds[-1] is griffe.ParameterKind.positional_only and kind is not kinds[-1]:
            texts.append("/")
        is_first_keyword = kind is griffe.ParameterKind.keyword_only and kind not in kinds
        if is_first_keyword and griffe.ParameterKind.var_positional not in kinds:
            texts.append("*")
        kinds.append(kind)
        text = stars.get(kind, "") + parameter.name
        if parameter.annotation is not None:
            text += f": {plain(parameter.annotation)}"
        if parameter.default is not None and kind not in stars:
            text += f" = {parameter.default}" if parameter.annotation is not None else f"={parameter.default}"
        texts.append(text)
    return one_line(f"({', '.join(texts)})")


def plain(annotation: str | griffe.Expr) -> str:
    """Return a type as text, `Annotated[T, ...]` as T."""
    if isinstance(annotation, griffe.ExprSubscript) and str(annotation.left).endswith("Annotated"):
        inner = annotation.slice
        annotation = inner.elements[0] if isinstance(inner, griffe.ExprTuple) else inner
    return one_line(str(annotation))


def docstring(what: griffe.Object) -> list[str]:
    """Return a docstring as reStructuredText, its numpy sections as fields."""
    if what.docstring is None:
        return []
    return NumpyDocstring("\n\n".join(map(paragraph, what.docstring.value.split("\n\n"))), STYLE).lines()


def paragraph(text: str) -> str:
    """Return a paragraph of a docstring as reStructuredText; columns and trees stay as they are typed."""
    if text.startswith("* ") and TYPED.search(text):
        return "::\n\n" + indent(text, "    ")
    return "".join(p if p.startswith("`") else prose(p) for p in CODE.split(text))


def prose(text: str) -> str:
    """Return text without code as reStructuredText, with links to the pages that it names."""
    return PAGE.sub(r":doc:`\g<0> </\1>`", MARKUP.sub(r"\\\g<0>", text))


def summary(what: griffe.Object) -> str:
    """Return the first paragraph of a docstring, on one line."""
    return one_line("\n".join(docstring(what)).partition("\n\n")[0])


def heading(text: str, line: str = "=") -> str:
    """Return a heading."""
    return f"{text}\n{line * len(text)}\n"


def one_line(text: str) -> str:
    """Return a text without line breaks."""
    return " ".join(text.split())
