"""Types and names in the Python reference: as the source writes them, each linked to its entry.

Docstrings give shapes and units, annotations the types; here they meet. Names in backticks, in
docstrings and in the Markdown pages, become links where they name something that is described.
"""

import ast
import dataclasses
import importlib
import inspect
import re
import textwrap
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Literal, get_args, get_origin

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util.nodes import make_refnode

_HEADING = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)


# --- Types, from annotations into docstrings ---


def _write_types(_: Sphinx, what: str, __: str, thing: Any, ___: object, lines: list[str]) -> None:
    """Add the annotated types to the Parameters, and to Returns where it has none."""
    if what not in ("class", "exception", "function", "method") or not lines:
        return
    types = {name: _linked(text) for name, text in _annotations(thing).items()}
    section = ""
    for number, line in enumerate(lines):
        if lines[number + 1 : number + 2] == ["-" * len(line)] and line:
            section = line
        elif section == "Parameters":
            lines[number] = _typed(line, types)
        elif section == "Returns" and lines[number - 1] == "-" * len("Returns"):
            lines[number] = types["return"] if types["return"].startswith(":") else line
    returned = types.get("return", "None")
    if what in ("function", "method") and returned != "None" and "Returns" not in lines:
        at = _before_end(lines)
        lines[at:at] = ["", "Returns", "-------", returned, ""]


def _typed(line: str, types: Mapping[str, str]) -> str:
    """Return a line ``a, b`` of a Parameters section as ``a, b : type``."""
    names = line.split(", ")
    if line != line.strip() or not all(name in types for name in names):
        return line
    kinds = dict.fromkeys(types[name] for name in names)
    return f"{line} : {' or '.join(kinds)}"


def _linked(text: str) -> str:
    """Write our own types as references, by their last name, and choices as they are typed."""
    text = re.sub(r"'([^']*)'", r'``"\1"``', text)
    return re.sub(r"pivometer\.[\w.]+", r":py:class:`~\g<0>`", text)


def _before_end(lines: Sequence[str]) -> int:
    """Return where a Returns section belongs: before the sections that follow it."""
    later = ("Raises", "References", "Examples", "Notes", "See Also", "Warns")
    for index, line in enumerate(lines):
        if line in later and lines[index + 1 : index + 2] == ["-" * len(line)]:
            return index
    return len(lines)


def _without_fields(
    _: Sphinx, what: str, __: str, thing: Any, *___: object
) -> tuple[str, None] | None:
    """Drop the signature of a dataclass: its parameters are listed below it all the same."""
    return ("", None) if what == "class" and dataclasses.is_dataclass(thing) else None


def _annotations(thing: Any) -> dict[str, str]:
    """Return the annotations of a function's parameters or a class's fields, as types to print."""
    thing = inspect.unwrap(thing) if callable(thing) else thing
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(thing))).body[0]
    except (OSError, TypeError):
        return {}
    names = vars(importlib.import_module(thing.__module__))
    if isinstance(tree, ast.ClassDef):
        inherited = [
            _annotations(base) for base in thing.__bases__ if base.__module__[:4] == "pivo"
        ]
        own = {
            node.target.id: _printed(node.annotation, names) + (", optional" if node.value else "")
            for node in tree.body
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
        }
        made = next((n for n in tree.body if getattr(n, "name", "") == "__init__"), None)
        return {
            k: v for one in (*inherited, _of_function(made, names), own) for k, v in one.items()
        }
    return _of_function(tree, names)


def _of_function(tree: ast.AST | None, names: Mapping[str, Any]) -> dict[str, str]:
    if not isinstance(tree, ast.FunctionDef):
        return {}
    given = [*tree.args.posonlyargs, *tree.args.args, *tree.args.kwonlyargs]
    types = {one.arg: _printed(one.annotation, names) for one in given if one.annotation}
    return types | ({"return": _printed(tree.returns, names)} if tree.returns else {})


def _printed(annotation: ast.expr, names: Mapping[str, Any]) -> str:
    """Return an annotation in its own words, choices written out and our types by full name."""
    return _Printed(names).visit_to_text(annotation).replace("np.bool_", "np.bool")


def types_of(thing: Any) -> set[Any]:
    """Return the types of ours that a function takes and returns, or a class and its methods."""
    words = list(_annotations(thing).values())
    if inspect.isclass(thing):
        for name, member in vars(thing).items():
            if not name.startswith("_"):
                inner = getattr(member, "fget", None) or getattr(member, "__func__", member)
                words += _annotations(inner).values() if inspect.isfunction(inner) else []
    found = {_import(name) for text in words for name in re.findall(r"pivometer\.[\w.]+", text)}
    return {one for one in found if inspect.isclass(one)}


_NUMPY = ("ArrayLike", "Floats", "Ids", "Image")
"""Aliases whose names say more than what they stand for."""


class _Printed(ast.NodeTransformer):
    def __init__(self, names: Mapping[str, Any]) -> None:
        self.names = names

    def visit_to_text(self, annotation: ast.expr) -> str:
        if isinstance(annotation, ast.Constant) and isinstance(annotation.value, str):
            annotation = ast.parse(annotation.value, mode="eval").body
        return ast.unparse(self.visit(annotation))

    def visit_Name(self, node: ast.Name) -> ast.expr:
        meant = self.names.get(node.id)
        if inspect.isclass(meant) and meant.__module__.startswith("pivometer"):
            return ast.Name(id=f"{meant.__module__}.{meant.__qualname__}")
        if get_origin(meant) is Literal:
            return ast.Name(id=" | ".join(map(repr, get_args(meant))))
        if get_origin(meant) is not None and node.id not in _NUMPY and get_args(meant):
            written = re.sub(r"(collections\.abc|typing|pathlib)\.", "", str(meant))
            return ast.Name(id=written)
        return node

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        base = ast.unparse(node.value)
        if base == "Literal":
            return ast.Name(id=ast.unparse(node.slice).strip("()").replace(", ", " | "))
        if base == "Annotated" and isinstance(node.slice, ast.Tuple):
            return self.visit(node.slice.elts[0])
        return self.generic_visit(node)


# --- Names, from words to entries ---


def _find(env: BuildEnvironment, name: str) -> str | None:
    """Return the entry that describes `name`, in full or without ``pivometer.``."""
    described = env.domains.python_domain.objects
    for whole in (name, f"pivometer.{name}"):
        if whole in described:
            return whole
        thing = _import(whole) if whole.startswith("pivometer.") else None
        if entry := _entries_by_home(env).get(_home(thing)):
            return entry
    return None


def _entries_by_home(env: BuildEnvironment) -> dict[tuple[str, str], str]:
    described = env.domains.python_domain.objects
    return _entries(frozenset(name for name, entry in described.items() if not entry.aliased))


@cache
def _entries(described: frozenset[str]) -> dict[tuple[str, str], str]:
    """Return the entry of each object by where it is defined, whatever name it is offered under."""
    found = {_home(_import(name)): name for name in described}
    return {home: name for home, name in found.items() if all(home)}


def _home(thing: Any) -> tuple[str, str]:
    """Return the module and the name under which an object was defined; empty for values."""
    if not (inspect.isclass(thing) or inspect.isroutine(thing)):
        return "", ""
    return thing.__module__ or "", thing.__qualname__


def _import(name: str) -> Any:
    """Import ``pivometer.module.Class.method``; `None` where there is no such thing."""
    parts = name.split(".")
    for size in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(parts[:size]))
        except ImportError:
            continue
        try:
            for part in parts[size:]:
                thing = getattr(thing, part)
        except AttributeError:
            return None
        return thing
    return None


def _link(
    app: Sphinx, env: BuildEnvironment, node: addnodes.pending_xref, shown: nodes.Element
) -> nodes.Element | None:
    """Resolve what the Python domain did not: our names by where they are described.

    Names of others (numpy, pathlib) and of parameters stay words; names of ours that nothing
    describes are left to Sphinx, which warns.
    """
    if node["refdomain"] != "py":
        return None
    target = node["reftarget"]
    if entry := _find(env, target):
        found = env.domains.python_domain.objects[entry]
        return make_refnode(app.builder, node["refdoc"], found.docname, found.node_id, shown, entry)
    return None if target.startswith("pivometer.") else shown


class _LinkLiterals(SphinxPostTransform):
    """Make links of literals in the Markdown pages that name something described."""

    default_priority = 500

    def run(self, **_: Any) -> None:
        for literal in list(self.document.findall(nodes.literal)):
            name = literal.astext().removesuffix("()")
            if "." not in name or not re.fullmatch(r"\w+(\.\w+)+", name):
                continue
            if isinstance(literal.parent, nodes.reference | addnodes.pending_xref):
                continue
            if entry := _find(self.env, name):
                found = self.env.domains.python_domain.objects[entry]
                shown = literal.deepcopy()
                literal.replace_self(
                    make_refnode(
                        self.app.builder,
                        self.env.docname,
                        found.docname,
                        found.node_id,
                        shown,
                        entry,
                    )
                )


# --- Listings, back to entries ---


def _lead_back(app: Sphinx, page: str, _: str, context: dict[str, Any], __: object) -> None:
    """Correct the links from a listing: Sphinx takes all its names for offered by one module."""
    if not page.startswith("_modules/pivometer"):
        return
    entries = _entries_by_home(app.env)
    module = page.removeprefix("_modules/").replace("/", ".")

    def corrected(link: re.Match[str]) -> str:
        parts = link[2].split(".")
        names = [".".join(parts[start:]) for start in range(len(parts))]
        found = next(
            (entries[module, name] for name in names if (module, name) in entries), link[2]
        )
        return f'<a class="viewcode-back" href="{link[1]}#{found}"'

    back = r'<a class="viewcode-back" href="([^"#]*)#([^"]*)"'
    context["body"] = re.sub(back, corrected, context["body"])


def setup(app: Sphinx) -> dict[str, Any]:
    """Come before napoleon, which turns sections into fields."""
    app.connect("autodoc-process-docstring", _write_types, priority=100)
    app.connect("autodoc-process-signature", _without_fields)
    app.connect("missing-reference", _link)
    app.connect("html-page-context", _lead_back)
    app.add_post_transform(_LinkLiterals)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
