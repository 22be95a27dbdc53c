"""Pivot calibration: exact without noise, refused where undetermined, honest about like frames."""

from pathlib import Path

import numpy as np
import pytest
from scipy import signal
from scipy.spatial.transform import Rotation

from pivometer.cli import main
from pivometer.errors import DegenerateGeometryError, ShapeError, TooFewPosesError, UsageError
from pivometer.io.poses import read_poses
from pivometer.rcm import calibrate_pivot, pivot_findings

PIVOT, TIP = np.array([-800.0, -85.0, -2100.0]), np.array([-14.0, 395.0, -7.5])


def recording(random, count, *, tilt=0.5, noise=0.0, alike=0.0, axis=None):
    """Smooth wandering rotations about the tip, and misses of a first-order autoregression."""
    wander = np.cumsum(random.standard_normal((count, 3)), axis=0)
    wander = tilt * (wander - wander.mean(axis=0)) / wander.std(axis=0)
    R = Rotation.from_rotvec(wander if axis is None else wander[:, :1] * axis).as_matrix()
    driven = random.standard_normal((count + 500, 3))
    misses = signal.lfilter([np.sqrt(1 - alike**2)], [1, -alike], driven, axis=0)[500:]
    return R, PIVOT - R @ TIP + noise * misses


def test_without_noise_it_is_exact():
    found = calibrate_pivot(*recording(np.random.default_rng(1), 30))
    np.testing.assert_allclose(found.pivot_mm, PIVOT, atol=1e-9)
    np.testing.assert_allclose(found.tip_mm, TIP, atol=1e-9)
    assert found.max_mm < 1e-9


@pytest.mark.parametrize("alike", [0.0, 0.9])
def test_stated_covariance_is_the_scatter(alike):
    """Over 300 recordings of one path, with fresh misses."""
    count, trials = 600, 300
    R, ideal = recording(np.random.default_rng(2), count)
    random = np.random.default_rng(3)
    errors, stated = [], []
    for _ in range(trials):
        driven = random.standard_normal((count + 500, 3))
        misses = signal.lfilter([np.sqrt(1 - alike**2)], [1, -alike], driven, axis=0)[500:]
        found = calibrate_pivot(R, ideal + misses)
        errors.append(np.concatenate([found.pivot_mm - PIVOT, found.tip_mm - TIP]))
        stated.append(found.covariance_mm2.diagonal())
        assert abs(found.lag_one - alike) < 0.15
    ratio = np.mean(stated, axis=0) / np.mean(np.square(errors), axis=0)
    # The scatter of 300 is known to √(2/300) = 8 %; four times that is 33 %. Ignoring that frames
    # are alike would state 5 % of the variance.
    assert np.abs(ratio - 1).max() < 4 * np.sqrt(2 / trials)


@pytest.mark.parametrize(
    ("tilt", "axis"), [(0.0, None), (0.01, None), (0.5, np.array([0, 0.6, 0.8]))]
)
def test_a_static_or_one_axis_recording_is_refused(tilt, axis):
    R, origins = recording(np.random.default_rng(4), 200, tilt=tilt, axis=axis, noise=0.1)
    with pytest.raises(DegenerateGeometryError, match="turned only as in a cone of"):
        calibrate_pivot(R, origins)


def test_findings():
    random = np.random.default_rng(5)
    assert pivot_findings(calibrate_pivot(*recording(random, 300, noise=0.1))) == ()
    narrow, alike = pivot_findings(
        calibrate_pivot(*recording(random, 900, tilt=0.05, noise=0.1, alike=0.95))
    )
    assert narrow.text.startswith("the instrument turned only as in a cone of 1")
    assert alike.text.startswith("successive misses are alike (autocorrelation 0.9")


def test_too_few_or_unequal_poses_are_refused():
    R, origins = recording(np.random.default_rng(6), 20)
    with pytest.raises(TooFewPosesError):
        calibrate_pivot(R[:7], origins[:7])
    with pytest.raises(ShapeError, match="20 rotations for 19"):
        calibrate_pivot(R, origins[:19])


def test_a_real_recording_is_not_worth_its_frames(
    shared_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its halves differ by 4.0 mm, though naive standard errors are 0.25 mm."""
    path = shared_data / "ucl_pivot" / "poses.csv"
    poses = read_poses(path)
    found = calibrate_pivot(poses.rotations, poses.translations_mm)
    # scikit-surgerycalibration's algebraic one-step: rms 1.838 mm a component
    assert found.rms_mm / np.sqrt(3) == pytest.approx(1.838, abs=0.001)
    assert 0.97 < found.lag_one < 0.99
    u = np.sqrt(found.covariance_mm2.diagonal())
    # Block bootstrap: 0.7–1.05 with blocks that hold 57 % of the variance, so 0.93–1.39 in all, and
    # 9 % more for the six numbers fitted to what 12 independent poses tell.
    assert ((u > 0.9) & (u < 1.6)).all()
    halves = [
        calibrate_pivot(poses.rotations[half], poses.translations_mm[half]).pivot_mm
        for half in (slice(0, 575), slice(575, None))
    ]
    # Halves differ by twice the uncertainty of the whole, in each of three components.
    expected = 2 * np.sqrt(np.trace(found.covariance_mm2[:3, :3]))
    assert 0.5 * expected < np.linalg.norm(halves[1] - halves[0]) < 1.5 * expected
    assert main(["pivot", str(path)]) == 0
    told = capsys.readouterr().out
    assert "1151 poses tell as much as 12 independent ones" in told
    assert found.halves_mm == pytest.approx(np.linalg.norm(halves[1] - halves[0]), rel=1e-6)
    assert "its two halves are 4.0 mm apart" in told
    assert main(["pivot", str(path), "--axis", "estimate"]) == 3  # it only pivots
    assert "the axis of the instrument is not determined" in capsys.readouterr().err


def write(tmp_path: Path, lines: list[str]) -> Path:
    path = tmp_path / "poses.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def row(R, t) -> str:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = R, t
    return ",".join(map(repr, map(float, matrix.ravel())))


def test_poses_come_back_from_a_file(tmp_path: Path) -> None:
    R, origins = recording(np.random.default_rng(7), 12)
    rows = [row(*pose) for pose in zip(R, origins, strict=True)]
    titles = ",".join(f"t{i}{j}" for i in range(4) for j in range(4))
    plain = read_poses(write(tmp_path, rows))
    headed = read_poses(write(tmp_path, ["time," + titles, *(f"9,{line}" for line in rows)]))
    for poses in (plain, headed):
        np.testing.assert_array_equal(poses.rotations, R)
        np.testing.assert_array_equal(poses.translations_mm, origins)
    assert main(["pivot", str(tmp_path / "poses.csv"), "--output", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "pivot.json").is_file()


@pytest.mark.parametrize(
    ("lines", "what"),
    [
        ([], "holds no poses"),
        (["1,2,3"], "line 1: has no heading and 3 columns, not 16"),
        (["t00,t01", "1,2"], "line 1: has no column t02"),
        ([row(np.eye(3), [1, 2, 3]), row(2 * np.eye(3), [1, 2, 3])], "line 2: is no rotation"),
        ([row(-np.eye(3), [1, 2, 3])], "line 1: is no rotation"),
        ([row(np.eye(3), [1, 2, np.nan])], "line 1: holds fewer finite numbers"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(lines: list[str], what: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError) as told:
        read_poses(write(tmp_path, lines))
    assert told.value.what.startswith(what)
