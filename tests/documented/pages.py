"""README and the pages of docs/ as what they ask a reader to type, step by step."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

_FENCE = re.compile(r"^(?P<indent> *)(?P<marks>```+|~~~+|:::+)(?P<info>.*)$")
_DIRECTIVE = re.compile(r"\{([\w:+-]+)\}")
_EXIT_CODE = re.compile(r"#.*\bexit code (\d+)")

KINDS = frozenset({"sh", "python", "toml", "yaml", "text", ""})
"""What a block may hold; one without a name draws a folder."""

CODE_DIRECTIVES = frozenset({"code", "code-block", "code-cell", "sourcecode", "literalinclude"})
"""How Sphinx spells a block of code that we would not see: such a block must be a plain one, unless
it shows a file of `examples/`, which `test_examples` runs."""


class UnreadableBlockError(Exception):
    """A block that nobody would run."""


@dataclass(frozen=True)
class Step:
    """One thing that a page shows to be typed, or kept in a file.

    Parameters
    ----------
    page, line
        Where it stands.
    kind
        ``"sh"`` for one command line, or the kind of the whole block.
    text
        What it says, without a command's remark.
    code
        The exit code that the page states for a command: in its remark, as ``# exit code 1``.
    shown
        What the page says is printed, where it does.
    """

    page: str
    line: int
    kind: str
    text: str
    code: int = 0
    shown: str | None = None

    def __str__(self) -> str:
        first = self.text.strip().partition("\n")[0]
        return f"{self.page}:{self.line} {first if self.kind == 'sh' else self.kind}"


@dataclass(frozen=True)
class Block:
    line: int
    kind: str
    lines: tuple[str, ...]


def all_pages() -> list[Path]:
    """List README and every page of docs/ but the decisions, which tell of the past."""
    docs = ROOT / "docs"
    inside = (path for path in docs.rglob("*.md") if "adr" not in path.relative_to(docs).parts)
    return [ROOT / "README.md", *sorted(inside)]


def page_name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else path.name


def blocks_of(text: str) -> Iterator[Block]:
    """Yield all fenced blocks, without the indentation of the list they stand in."""
    lines = iter(enumerate(text.splitlines(), start=1))
    before = ""
    for number, line in lines:
        opening = _FENCE.match(line)
        if opening is None:
            _refuse_indented(number, line, before)
            before = line
            continue
        directive = _DIRECTIVE.match(opening["info"].strip())
        if opening["marks"].startswith(":"):
            continue  # what stands in a colon fence is read as the page is
        inside = []
        for _, line in lines:
            if line.strip() == opening["marks"]:
                break
            inside.append(line.removeprefix(opening["indent"]))
        before = ""
        if directive is None:
            yield _block(number, opening, tuple(inside))
        elif directive[1] in CODE_DIRECTIVES and "/examples/" not in opening["info"]:
            raise UnreadableBlockError(f"line {number}: write a plain block, so that it is run")


def _block(number: int, opening: re.Match[str], inside: tuple[str, ...]) -> Block:
    kind = opening["info"].strip()
    if kind not in KINDS or opening["marks"].startswith("~"):
        raise UnreadableBlockError(f"line {number}: nobody would run a block of {kind!r}")
    return Block(number, kind, inside)


def _refuse_indented(number: int, line: str, before: str) -> None:
    """Refuse code that is indented instead of fenced: nobody would know what it is."""
    starts = line.startswith("    ") and not before.strip()
    if starts and re.match(r"(\$ |pivometer |python |pip |make |import |from |>>> )", line.strip()):
        raise UnreadableBlockError(f"line {number}: fence the code {line.strip()!r}")


def steps_of(path: Path) -> list[Step]:
    """Return all steps of a page in order, each with the output that follows it."""
    page, steps = page_name(path), list[Step]()
    for block in blocks_of(path.read_text(encoding="utf-8")):
        text = "\n".join(block.lines) + "\n"
        if block.kind == "sh":
            steps += _commands(page, block)
        elif block.kind == "text":
            steps[-1:] = [_with_output(steps, text, block.line)]
        else:
            steps.append(Step(page, block.line, block.kind, text))
    return steps


def _with_output(steps: list[Step], text: str, line: int) -> Step:
    if not steps or steps[-1].kind not in ("sh", "python") or steps[-1].shown is not None:
        raise UnreadableBlockError(f"line {line}: shows the output of nothing")
    last = steps[-1]
    return Step(last.page, last.line, last.kind, last.text, last.code, text)


def _commands(page: str, block: Block) -> Iterator[Step]:
    """Yield the command lines of a block; one that ends in a backslash goes on."""
    started, number = "", block.line
    for offset, line in enumerate(block.lines, start=1):
        if not started:
            number = block.line + offset
        whole = started + line
        if whole.endswith("\\"):
            started = whole[:-1]
            continue
        started = ""
        command = whole.partition(" #")[0].strip()
        stated = _EXIT_CODE.search(whole)
        if command and not command.startswith("#"):
            yield Step(page, number, "sh", command, int(stated[1]) if stated else 0)


def inline_commands(path: Path) -> list[str]:
    """Return the commands that stand in sentences, such as `pivometer demo`."""
    text = re.sub(
        r"^ *(```+).*?^ *\1$", "", path.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE
    )
    spans = (" ".join(span.split()) for span in re.findall(r"`([^`]+)`", text))
    return [span for span in spans if re.match(r"pivometer [a-z]+ \S", span)]
