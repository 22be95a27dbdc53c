"""The log of what a person took out: it only grows, the last row decides, and nonsense is told."""

from datetime import UTC, datetime
from pathlib import Path

import pytest

from pivometer.errors import SessionError, UsageError
from pivometer.io.exclusions import (
    FILE_NAME,
    MOST_BYTES,
    excluded_now,
    log_exclusion,
    read_exclusions,
)

NOW = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
HEAD = "view,state,reason,time\n"


def test_an_exclusion_and_its_undoing_are_both_kept(tmp_path: Path) -> None:
    log_exclusion(tmp_path, "shaft/007", 'a hand,\n "in the way"', when=NOW)
    log_exclusion(tmp_path, "board/001", "blurred", when=NOW)
    log_exclusion(tmp_path, "shaft/007", None, when=NOW)
    log = read_exclusions(tmp_path / FILE_NAME)
    assert [(row.view, row.state, row.reason) for row in log] == [
        ("shaft/007", "excluded", 'a hand, "in the way"'),
        ("board/001", "excluded", "blurred"),
        ("shaft/007", "included", ""),
    ]
    assert {row.time for row in log} == {"2026-01-02T03:04:05+00:00"}
    assert excluded_now(log) == {"board/001": "blurred"}
    assert [path.name for path in tmp_path.iterdir()] == [FILE_NAME]


def test_no_exclusion_without_a_reason(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="without a reason"):
        log_exclusion(tmp_path, "shaft/007", " \n", when=NOW)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "other columns"),
        ("pose,why\n", "other columns"),
        (HEAD + "shaft/1,excluded,,\n", "line 2 is no exclusion with a reason"),
        (HEAD + "shaft/1,perhaps,x,\n", "line 2"),
        (HEAD + "shaft/1,excluded\n", "line 2"),
        (HEAD + ",excluded,x,\n", "line 2"),
        (HEAD + "a" * 200_000 + ",excluded,x,\n", "is no CSV"),
    ],
)
def test_a_malformed_log_is_refused(tmp_path: Path, content: str, says: str) -> None:
    (tmp_path / FILE_NAME).write_text(content, encoding="utf-8")
    with pytest.raises(SessionError, match=says):
        read_exclusions(tmp_path / FILE_NAME)


def test_an_oversized_log_is_refused_unread(tmp_path: Path) -> None:
    with (tmp_path / FILE_NAME).open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    with pytest.raises(SessionError, match="more than any log"):
        read_exclusions(tmp_path / FILE_NAME)
