"""The examples run, with fewer poses and experiments than they take."""

import runpy
from pathlib import Path

import pytest
from tests.documented.pages import ROOT

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def test_there_are_examples() -> None:
    assert EXAMPLES


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda file: file.name)
def test_an_example_runs(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example = runpy.run_path(str(file))
    example["PAPER"].pop("gold")
    example["main"](tmp_path, poses=8)
    assert "RCM error, rms" in capsys.readouterr().out
