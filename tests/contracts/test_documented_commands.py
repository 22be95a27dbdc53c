"""Every command that README and docs show can be typed as it stands there."""

import re
import shlex
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def commands(page: Path) -> list[str]:
    blocks = re.findall(
        r"^```sh\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    shown = (line.partition(" #")[0].strip() for line in lines)
    return [line for line in shown if line.startswith("pivometer ")]


SHOWN = [(page.name, line) for page in PAGES for line in commands(page)]


def test_commands_are_found():
    assert len(SHOWN) > 15


@pytest.mark.parametrize(("page", "line"), SHOWN)
def test_a_command_is_understood(page, line):
    from pivometer.cli.app import _with_counts_apart, app

    command, bound, _ = app.parse_args(
        _with_counts_apart(shlex.split(line)[1:]), print_error=False, exit_on_error=False
    )
    word = shlex.split(line)[1]
    assert command is app[word].default_command
    assert bound.arguments or word in ("demo", "schema", "app")


def test_a_wrong_command_is_not_understood():
    from cyclopts import CycloptsError

    from pivometer.cli.app import app

    with pytest.raises(CycloptsError):
        app.parse_args(["verify", "a", "b", "c"], print_error=False, exit_on_error=False)


PYTHON = [
    block
    for page in PAGES
    for block in re.findall(
        r"```python\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL
    )
    if "my-session" not in block and "import" in block
]


@pytest.mark.parametrize("block", PYTHON)
def test_python_that_needs_no_session_runs(block: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(block, {})  # noqa: S102 - our own pages
    assert capsys.readouterr().out
