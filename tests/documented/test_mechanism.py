"""A page that says something else than what happens makes a test fail."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.documented.pages import UnreadableBlockError, inline_commands, steps_of
from tests.documented.printed import difference
from tests.documented.running import PageRun, StepFailedError

Follow = Callable[[str], None]


@pytest.fixture
def follow(tmp_path: Path) -> Follow:
    """Return what follows a page with a text to its end."""

    def followed(text: str) -> None:
        page = tmp_path / "page.md"
        page.write_text(text, encoding="utf-8")
        run = PageRun(steps_of(page), tmp_path / "folder", lambda *_: None)
        for step in run.steps:
            run.follow(step)

    return followed


def sh(*lines: str) -> str:
    return "\n".join(["```sh", *lines, "```", ""])


def shows(*lines: str) -> str:
    return "\n".join(["```text", *lines, "```", ""])


LINES = """\
```python
from pathlib import Path

rows = ["0,0,0,0,0,1", "1,0,0,0,0.3,1", "0,1,0,0.3,0,1", "0,0,9,-0.3,0.2,1"]
names = "point_x_mm,point_y_mm,point_z_mm,direction_x,direction_y,direction_z"
Path("lines.csv").write_text("\\n".join([names, *rows, ""]))
```
"""


def test_what_is_true_passes(follow: Follow) -> None:
    solved = shows("4 lines of lines.csv fill a cone of 35°.", "…")
    follow(LINES + sh("pivometer solve lines.csv  # the RCM") + solved)
    follow(sh("pip install pivometer", "pivometer solve \\", "  none.csv  # exit code 2"))


TREE = """\
```
my-session/
  session.toml
  board/left/000.png    board/right/000.png
  board/left/notes.txt
```
"""


@pytest.mark.parametrize(
    ("page", "told"),
    [
        (sh("pivometer solve none.csv"), "exit code 2, the page says 0"),
        (sh("pivometer sovle none.csv"), "exit code 2, the page says 0"),
        (LINES + sh("pivometer solve lines.csv  # exit code 5"), "exit code 0, the page says 5"),
        (LINES + sh("pivometer solve lines.csv") + shows("5 lines", "…"), "shows “5”"),
        (sh("pivometer app a b c"), "exit code 2"),
        ("```python\nprint(1)\n```\n" + shows("2"), "the page shows “2”"),
        ("```yaml\n- run: pivometer solve none.csv\n```\n", "exit code 2"),
        ("```yaml\n- rum: pivometer --version\n```\n", "neither run nor use"),
        (TREE, "ignores"),
    ],
)
def test_what_is_not_true_fails(page: str, told: str, follow: Follow) -> None:
    with pytest.raises(StepFailedError, match=told):
        follow(page)


@pytest.mark.parametrize(
    ("page", "fault"),
    [
        ("```python\nimport pivometer\npivometer.solv\n```\n", AttributeError),
        ("```python\nfirst = 1\n```\n```python\nsecond\n```\n", NameError),
        ("```toml\n[bord]\n```\n", Exception),
        ("```yaml\n- run: [\n```\n", Exception),
        (sh("curl example.org"), UnreadableBlockError),
        (sh("pivometer solve lines.csv > out"), UnreadableBlockError),
        ("```bash\npivometer demo\n```\n", UnreadableBlockError),
        ("~~~sh\npivometer demo\n~~~\n", UnreadableBlockError),
        ("So:\n\n    pivometer demo\n", UnreadableBlockError),
        ("```{code-block} sh\npivometer demo\n```\n", UnreadableBlockError),
        (shows("of nothing"), UnreadableBlockError),
    ],
)
def test_what_cannot_be_run_fails(page: str, fault: type[Exception], follow: Follow) -> None:
    with pytest.raises(fault):
        follow(page)


def test_a_block_sees_what_those_before_it_made_even_if_one_failed(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(LINES + sh("pivometer solve none.csv", "pivometer solve lines.csv"))
    steps = steps_of(page)
    run = PageRun(steps, tmp_path / "folder", lambda *_: None)
    assert "4 lines" in run.printed_by(steps[2])  # asked for first
    with pytest.raises(StepFailedError, match=r"none.csv: exit code 2"):
        run.printed_by(steps[1])
    shutil.rmtree(tmp_path / "folder")
    assert "4 lines" in run.printed_by(steps[2])  # and not run twice


def test_blocks_of_lists_and_remarks_are_read(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "1. so\n\n   ```sh\n   # first\n   pivometer plan --a \\\n     --b   # exit code 4: no\n"
        "   ```\n"
        "\n   ```text\n   out\n     more\n   ```\n\nand `pivometer plan\n--wanted-mm 1`\n",
        encoding="utf-8",
    )
    (step,) = steps_of(page)
    assert (step.line, step.code, step.shown) == (5, 4, "out\n  more\n")
    assert step.text.split() == ["pivometer", "plan", "--a", "--b"]
    assert inline_commands(page) == ["pivometer plan --wanted-mm 1"]


def test_words_must_be_there_in_their_order() -> None:
    printed = "max 3.970 mm\n ─────── \n rms 2.867 mm\nwarning: none\n"
    assert difference("max 3.971 mm\n───\nrms 2.867 mm warning: none", printed) is None
    assert difference("max …\nwarning: none", printed) is None
    assert difference("… 2.867 mm …", printed) is None
    assert "“3.972”" in str(difference("max 3.972 mm …", printed))
    assert "“3.97”" in str(difference("max 3.97 mm …", printed))
    assert difference("rms …", printed)
    assert difference("… rms 2.867 mm", printed)
    assert difference("… 2.867 … 3.970 …", printed)
    assert difference("max 3.970 mm", printed)
    assert difference("", printed)
