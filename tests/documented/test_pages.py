"""Everything that README and docs/ show to be typed runs, in the order of the page."""

from __future__ import annotations

import shlex
from collections.abc import Mapping

import pytest
from tests.documented.pages import Step, all_pages, inline_commands, page_name, steps_of
from tests.documented.running import NOT_RUN, PageRun, reason_not_to_run

from pivometer.cli.app import _with_counts_apart, app

STEPS = [step for path in all_pages() for step in steps_of(path)]
RUN = [step for step in STEPS if step.kind != "sh" or reason_not_to_run(step.text) is None]


@pytest.mark.parametrize("step", RUN, ids=str)
def test_a_step_does_what_the_page_says(step: Step, followed: Mapping[str, PageRun]) -> None:
    followed[step.page].follow(step)


def test_there_is_much_to_run() -> None:
    kinds = [step.kind for step in RUN]
    assert kinds.count("sh") > 25
    assert {"sh", "python", "toml", "yaml", ""} <= {*kinds}


@pytest.mark.parametrize("start", NOT_RUN)
def test_an_exception_is_still_needed(start: str) -> None:
    assert any(step.text.startswith(start) for step in STEPS)


INLINE = sorted({(page_name(path), line) for path in all_pages() for line in inline_commands(path)})


@pytest.mark.parametrize(("page", "line"), INLINE)
def test_a_command_in_a_sentence_is_understood(page: str, line: str) -> None:
    words = shlex.split(line)[1:]
    command, _, _ = app.parse_args(
        _with_counts_apart(words), print_error=False, exit_on_error=False
    )
    assert command is app[words[0]].default_command
