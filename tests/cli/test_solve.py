"""`pivometer solve`, from a file to the answer."""

import json
from pathlib import Path

import numpy as np
import pytest

from pivometer import solve
from pivometer.cli import main
from pivometer.geometry.line import unit


def write(path: Path, spread: float) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(3)
    axes = unit([0, 0, 1] + spread * random.uniform(-1, 1, (25, 3)))
    points = [10, 20, 30] + 0.1 * random.standard_normal((25, 3)) + 50 * axes
    np.savetxt(path, np.hstack([points, axes]), delimiter=",", fmt="%.17g")
    return points, axes


def test_prints_both_points_and_writes_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    expected = solve(*write(tmp_path / "lines.csv", 0.5))
    assert main(["solve", str(tmp_path / "lines.csv"), "--output", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    for value in (expected.minimax.max_mm, expected.least_squares.rms_mm):
        assert f"{value:.3f}" in told
    content = json.loads((tmp_path / "out" / "rcm.json").read_text(encoding="utf-8"))
    assert content["schema"] == "pivometer/rcm/1"
    assert content["rcm"]["least_squares"]["point_mm"] == expected.least_squares.point_mm.tolist()
    assert len(content["lines"]) == len(content["rcm"]["minimax"]["distances_mm"]) == 25
    assert content["findings"] == []
    assert content["least_distance"]["mean_mm"] <= min(
        np.mean(content["rcm"][name]["distances_mm"]) for name in ("minimax", "least_squares")
    )
    assert len(content["trimmed"]["left_out"]) == 6


def test_an_outlying_line_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points, axes = write(tmp_path / "lines.csv", 0.5)
    points[7] += [3, 0, 0]
    np.savetxt(tmp_path / "lines.csv", np.hstack([points, axes]), delimiter=",", fmt="%.17g")
    assert main(["solve", str(tmp_path / "lines.csv")]) == 0
    assert "warning: 1 of 25 poses (8) misses the RCM by far more" in capsys.readouterr().out


def test_a_needle_of_a_cone_gets_no_answer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "lines.csv", 0.01)
    assert main(["solve", str(tmp_path / "lines.csv"), "--output", str(tmp_path / "out")]) == 3
    told = capsys.readouterr()
    assert "fills a cone of only" in told.err
    assert told.out == ""
    assert not (tmp_path / "out").exists()
