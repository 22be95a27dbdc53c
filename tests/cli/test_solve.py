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
    assert content["rcm"]["least_distance"]["mean_mm"] <= min(
        np.mean(content["rcm"][name]["distances_mm"]) for name in ("minimax", "least_squares")
    )
    assert len(content["rcm"]["trimmed"]["left_out"]) == 6


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


def test_lines_with_covariances_get_a_weighted_point(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points, axes = write(tmp_path / "lines.csv", 0.5)
    points[3:9, 0] += 0.8  # known badly along x, and said so
    names = [f"{kind}_{axis}" for kind in ("point", "direction") for axis in "xyz"]
    names += [f"cov_{pair}_mm2" for pair in ("xx", "xy", "xz", "yy", "yz", "zz")]
    known = np.tile([0.01, 0, 0, 0.01, 0, 0.01], (25, 1))
    known[3:9, 0] = 1.0
    table = np.hstack([points, axes, known])
    file = tmp_path / "lines.csv"
    np.savetxt(file, table, delimiter=",", fmt="%.17g", header=",".join(names), comments="")
    assert main(["solve", str(file), "--output", str(tmp_path / "out")]) == 0
    assert "weighted" in capsys.readouterr().out
    rcm = json.loads((tmp_path / "out" / "rcm.json").read_text(encoding="utf-8"))["rcm"]
    off = {name: abs(rcm[name]["point_mm"][0] - 10) for name in ("weighted", "least_squares")}
    assert off["weighted"] < off["least_squares"] / 2
    assert max(rcm["weighted"]["shares"][3:9]) < 1 / 25


@pytest.mark.parametrize(
    ("names", "row", "told"),
    [
        ("cov_xx_mm2,cov_yy_mm2", "1,1", "line 1: has a covariance without cov_xy_mm2"),
        (
            "cov_xx,cov_xy,cov_xz,cov_yy,cov_yz,cov_zz",
            "1,2,0,1,0,1",
            "line 2: its covariance has a negative eigenvalue",
        ),
        (
            "cov_xx,cov_xy,cov_xz,cov_yy,cov_yz,cov_zz",
            "1,nan,0,1,0,1",
            "line 2, column 8: 'nan' is not a finite number",
        ),
    ],
)
def test_a_wrong_covariance_is_told(
    names: str, row: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "lines.csv"
    file.write_text(f"px,py,pz,dx,dy,dz,{names}\n" + f"0,0,0,0,0,1,{row}\n" * 3, encoding="utf-8")
    assert main(["solve", str(file)]) == 2
    assert told in capsys.readouterr().err
