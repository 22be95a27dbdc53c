"""What the code says of itself, written into the pages when the site is built.

A page has a line ``<!-- generated: NAME ARGUMENTS -->``; the function NAME of this module writes
what stands there in the site. Where the repository is hosted, the page shows its own words only.
"""

import ast
import dataclasses
import importlib
import inspect
import io
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

from python_names import types_of
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

_MARK = re.compile(r"^<!-- generated: (.+?) -->$", re.MULTILINE)


def _fill_in(_: Sphinx, __: str, text: list[str]) -> None:
    """Replace every mark of a page by what it stands for."""
    text[0] = _MARK.sub(lambda mark: _written(*mark[1].split()), text[0])


def _written(name: str, *arguments: str) -> str:
    return "\n".join(_WRITERS[name](*arguments))


# --- The command line ---


def commands() -> Iterator[str]:
    """List every command with what it does."""
    yield from ("| command | what it does |", "|---|---|")
    for name, command in _commands().items():
        yield f"| [`pivometer {name}`](#pivometer-{name}) | {_first_sentence(command.help)} |"


def exit_codes() -> Iterator[str]:
    """Tell what each exit code means: of every command, and where one has its own."""
    from pivometer.cli import faults
    from pivometer.cli.app import app

    general = _codes_in(app.help_epilogue) | {
        faults.INTERNAL: "a fault of Pivometer's own",
        faults.INTERRUPTED: "interrupted: nothing was written",
    }
    columns = {"every other command": general}
    for name, command in _commands().items():
        if own := _codes_in(command.help_prologue):
            columns[f"`{name}`"] = own
    yield "| code | " + " | ".join(columns) + " |"
    yield "|---|" + "---|" * len(columns)
    for code in sorted({code for codes in columns.values() for code in codes}):
        fallback = {code: general[code]} if code in (faults.INTERNAL, faults.INTERRUPTED) else {}
        cells = [(fallback | codes).get(code, "") for codes in columns.values()]
        yield f"| {code} | " + " | ".join(cells) + " |"


def command_helps() -> Iterator[str]:
    """Show what ``pivometer COMMAND --help`` prints, command by command."""
    from rich.console import Console

    from pivometer.cli.app import app

    for name in _commands():
        shown = io.StringIO()
        app.help_print([name], console=Console(file=shown, width=80, color_system=None))
        yield from (f"## `pivometer {name}`", "", "```text")
        yield from (line.rstrip() for line in shown.getvalue().strip().splitlines())
        yield from ("```", "")


def _commands() -> Mapping[str, Any]:
    """Return the commands in the order of the front page."""
    from pivometer.cli.app import app

    return {name: app[name] for name in app if not name.startswith("-")}


def _codes_in(text: str | None) -> dict[int, str]:
    """Return the codes of a line ``Exit codes: 0 pass, 1 over, …``."""
    found = re.search(r"Exit codes: (.*?)\.\s*$", text or "", re.DOTALL)
    entries = re.split(r", (?=\d)", " ".join(found[1].split())) if found else []
    return {int(code): what for code, _, what in (entry.partition(" ") for entry in entries)}


# --- Files ---


def session_toml() -> Iterator[str]:
    """List the tables and keys of ``session.toml``."""
    from pivometer.calibration.board import Board
    from pivometer.io.settings import FREE_TABLES, KEYS, TABLES

    defaults = {
        f"board.{field.name}": field.default
        for field in dataclasses.fields(Board)
        if field.default not in (dataclasses.MISSING, None)
    }
    for table, meaning in {**TABLES, "": ""}.items():
        yield from (f"### `[{table}]`" if table else "### Outside of any table", "")
        yield from (f"{_capital(meaning)}." if table else "These stand above the first table.", "")
        keys = {name: key for name, key in KEYS.items() if name.rpartition(".")[0] == table}
        if table in FREE_TABLES:
            yield from ("Any keys and values; they stand in the report and in `result.json`.", "")
            continue
        yield from ("| key | what it says | what it takes | if left out |", "|---|---|---|---|")
        for name, key in keys.items():
            absent = "**required**" if key.required else _shown(defaults.get(name))
            short = name.rpartition(".")[2]
            yield f"| `{short}` | {key.meaning} | {_code_quotes(key.wants)} | {absent} |"
        yield ""


def result_json() -> Iterator[str]:
    """Describe ``result.json`` by its JSON Schema, part by part."""
    from pivometer.io.schema import schema

    described = schema()
    yield from ("## The whole", "", *_properties(described), "")
    for name, part in sorted(described["$defs"].items()):
        if "properties" in part:
            yield from (f"## {name}", "", _plain(part["description"]), "", *_properties(part), "")


def _properties(part: Mapping[str, Any]) -> Iterator[str]:
    yield from ("| name | type | what it is |", "|---|---|---|")
    for name, value in part["properties"].items():
        optional = "" if name in part.get("required", ()) else " *(may be absent)*"
        meaning = _plain(value.get("description", ""))
        yield f"| `{name}` | {_type(value)} | {meaning}{optional} |"


def _type(value: Mapping[str, Any]) -> str:
    """Write a JSON Schema type in a few words."""
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return "numbers" if name == "numbers" else f"[{name}](#{name.lower()})"
    if "anyOf" in value:
        return " or ".join(_type(member) for member in value["anyOf"])
    if "const" in value or "enum" in value:
        return " or ".join(f"`{_json(one)}`" for one in value.get("enum", [value.get("const")]))
    if value.get("type") == "array":
        size = f"{value['minItems']} × " if "minItems" in value else "list of "
        return size + _type(value["items"])
    if "additionalProperties" in value:
        return f"name → {_type(value['additionalProperties'])}"
    kinds = value.get("type", "anything")
    return " or ".join(kinds) if isinstance(kinds, list) else str(kinds)


def error_tree() -> Iterator[str]:
    """Draw the tree of errors as `pivometer.errors` has it."""
    from pivometer import errors

    tree = (errors.__doc__ or "").partition("::\n\n")[2].partition("\n\n")[0]
    yield from ("```text", textwrap.dedent(tree), "```")


# --- Python ---


def public_names() -> Iterator[str]:
    """Describe the names that ``import pivometer`` offers."""
    import pivometer

    names = [name for name in pivometer.__all__ if not name.startswith("__")]
    yield from _described([("pivometer", name) for name in names])


def api(*modules: str) -> Iterator[str]:
    """Describe the public names of some modules, and what those hold and take."""
    for name in modules:
        module = importlib.import_module(name)
        if len(modules) > 1:
            yield from (f"## `{name}`", "", f"{_plain(_first_sentence(module.__doc__))}.", "")
        yield from _described([(name, one) for one in _public(module)])
    package = ".".join(modules[0].split(".")[:2])
    if held := [one for one in _held_types() if f"{one[0]}.".startswith(f"{package}.")]:
        yield from ("## What these hold and take", "", *_described(held))


@cache
def _held_types() -> tuple[tuple[str, str], ...]:
    """Return the types that what is described on any page holds or takes, as (module, name)."""
    import pivometer

    roots = [getattr(pivometer, name) for name in pivometer.__all__]
    for page in _pages_with_marks():
        for mark in _MARK.findall(page.read_text(encoding="utf-8")):
            for name in mark.split()[1:]:
                module = importlib.import_module(name)
                roots += [getattr(module, one) for one in _public(module)]
    found, new = list(roots), list(roots)
    while new:
        named = {one for thing in new for one in types_of(thing)}
        new = [one for one in named if not any(one is known for known in found)]
        found += new
    return tuple(sorted((one.__module__, one.__name__) for one in found[len(roots) :]))


def _described(names: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Write a table of names with their first sentences, and an entry for each below it."""
    homes = [(_home(module, name), name) for module, name in names]
    yield from ("| name | what it is |", "|---|---|")
    for (module, name), (home, _) in zip(names, homes, strict=True):
        sentence = _first_sentence(_documentation(importlib.import_module(module), name))
        yield f"| {{py:obj}}`~{home}.{name}` | {_plain(sentence)} |"
    yield from ("", "```{eval-rst}")
    for (module, name), (home, _) in zip(names, homes, strict=True):
        if module == "pivometer" or home != "pivometer":
            thing = getattr(importlib.import_module(home), name)
            yield from (f".. currentmodule:: {home}", "")
            yield from (f".. {_directive(thing)}:: {home}.{name}", "")
    yield from ("```", "")


def _home(module: str, name: str) -> str:
    """Return where a name is described: in `pivometer` if it is offered there, else in `module`.

    Constants carry no docstring: they are described in the module whose text follows them.
    """
    import pivometer

    imported = importlib.import_module(module)
    thing = getattr(imported, name)
    if name in pivometer.__all__ and getattr(pivometer, name) is thing:
        return "pivometer"
    if _directive(thing) == "autodata" and name not in _documented(imported):
        for node in ast.parse(inspect.getsource(imported)).body:
            if isinstance(node, ast.ImportFrom) and name in {alias.name for alias in node.names}:
                return str(node.module)
    return module


def _public(module: ModuleType) -> Iterator[str]:
    """Yield `__all__`, or the functions and classes of the module without a leading underscore."""
    if hasattr(module, "__all__"):
        yield from module.__all__
        return
    for node in ast.parse(inspect.getsource(module)).body:
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name) if name[0] != "_":
                yield name


def _documented(module: ModuleType) -> Mapping[str, str]:
    """Return the texts that follow the public constants of a module."""
    body = ast.parse(inspect.getsource(module)).body
    texts: dict[str, str] = {}
    for node, after in pairwise(body):
        match node, after:
            case ast.Assign() | ast.AnnAssign(), ast.Expr(value=ast.Constant(value=str(text))):
                texts[ast.unparse(_target(node))] = text
    return {name: text for name, text in texts.items() if not name.startswith("_")}


def _target(node: ast.Assign | ast.AnnAssign) -> ast.expr:
    return node.target if isinstance(node, ast.AnnAssign) else node.targets[0]


def _documentation(module: ModuleType, name: str) -> str:
    thing = getattr(module, name)
    if _directive(thing) != "autodata":
        return thing.__doc__ or ""
    return _documented(importlib.import_module(_home(module.__name__, name))).get(name, "")


def _directive(thing: object) -> str:
    if inspect.isclass(thing):
        return "autoexception" if issubclass(thing, BaseException) else "autoclass"
    return "autofunction" if inspect.isroutine(thing) else "autodata"


# --- Words ---


def _first_sentence(text: str | None) -> str:
    """Return the first sentence of a docstring; abbreviations and numbers do not end it."""
    paragraph = " ".join((text or "").strip().partition("\n\n")[0].split())
    return re.split(r"(?<!eqs)(?<!eq)(?<!al)\. (?=[A-Z`])", paragraph)[0].rstrip(".")


def _plain(text: str) -> str:
    """Return a docstring's words as Markdown fit for a table."""
    text = re.sub(r"``(.+?)``|`(.+?)`", lambda code: f"`{code[1] or code[2]}`", text)
    return " ".join(text.split()).replace("|", "\\|").replace("$", "\\$")


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _code_quotes(text: str) -> str:
    """Show what is typed as code: quoted words and lists."""
    return re.sub(r'(\w+ = )?\[[^\]]*\]|"[^"]+"', r"`\g<0>`", text)


def _json(value: object) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value)


def _shown(value: object) -> str:
    return "" if value is None else f"`{_json(value)}`"


_WRITERS: dict[str, Callable[..., Iterator[str]]] = {
    "api": api,
    "command-helps": command_helps,
    "commands": commands,
    "error-tree": error_tree,
    "exit-codes": exit_codes,
    "public-names": public_names,
    "result-json": result_json,
    "session-toml": session_toml,
}


def setup(app: Sphinx) -> dict[str, Any]:
    """Fill in the pages as they are read; all of them anew, for the code may have changed."""
    app.connect("source-read", _fill_in)
    app.connect("env-get-outdated", _outdated)
    app.setup_extension("sphinx.ext.autodoc")
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _outdated(_: Sphinx, env: BuildEnvironment, *__: set[str]) -> list[str]:
    return [env.path2doc(page) or "" for page in _pages_with_marks()]


def _pages_with_marks() -> list[Path]:
    docs = Path(__file__).resolve().parents[1]
    return [page for page in docs.rglob("*.md") if _MARK.search(page.read_text(encoding="utf-8"))]
