"""The axis of a tracked instrument: found where it slides, refused where it only pivots."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pivometer.cli import main
from pivometer.errors import DegenerateGeometryError, TooFewPosesError
from pivometer.rcm import InstrumentAxis, estimate_axis, solve, with_recording

RCM_MM = np.array([-800.0, -85.0, -2100.0])
AXIS = InstrumentAxis([3.0, -5.0, 20.0], [0.1, 0.2, 0.97])


def recording(random, count=120, *, noise=0.0, slide=60.0, turn=0.3, about=None):
    """Poses of an instrument that slides along its axis through the RCM, and turns there."""
    vectors = turn * random.standard_normal((count, 3))
    R = Rotation.from_rotvec(vectors if about is None else vectors[:, :1] * about).as_matrix()
    depths = slide * random.uniform(-1, 1, (count, 1))
    inside = AXIS.point_mm + depths * AXIS.direction
    origins = RCM_MM - (R @ inside[..., None])[..., 0]
    return R, origins + noise * random.standard_normal((count, 3))


def angle_deg(found):
    return np.degrees(np.linalg.norm(np.cross(found.direction, AXIS.direction)))


def test_without_noise_it_is_exact():
    R, origins = recording(np.random.default_rng(1))
    found = estimate_axis(R, origins)
    assert angle_deg(found) < 1e-6
    assert found.slide_mm == pytest.approx(60 / np.sqrt(3), rel=0.1)
    across = np.cross(found.point_mm - AXIS.point_mm, AXIS.direction)
    assert np.linalg.norm(across) < 1e-6
    assert solve(*found.lines(R, origins)).minimax.max_mm < 1e-6


def test_stated_uncertainties_are_the_scatter():
    """Of the direction and of the RCM, over 150 recordings."""
    random, trials = np.random.default_rng(2), 150
    angles, errors = [], []
    for _ in range(trials):
        R, origins = recording(random, noise=0.3)
        axis = estimate_axis(R, origins)
        angles.append(angle_deg(axis) ** 2 / (2 * axis.direction_u_deg**2))
        rcm, findings = with_recording(solve(*axis.lines(R, origins)), axis, R, origins)
        error = rcm.least_squares.point_mm - RCM_MM
        errors.append(error @ np.linalg.solve(rcm.least_squares.covariance_mm2, error) / 3)
        assert findings == ()
    # Means of squares with 2 and 3 degrees of freedom scatter by √(2/ν/150): four times that. The
    # covariance rests on 120 blocks, so the mean of its inverse is 120/(120 − 4) of 1.
    assert abs(np.mean(angles) - 1) < 4 * np.sqrt(1 / trials) + 0.04
    assert abs(np.mean(errors) - 1) < 4 * np.sqrt(2 / 3 / trials) + 0.04


@pytest.mark.parametrize("noise", [0.0, 0.1, 3.0])
def test_an_instrument_that_only_pivots_tells_no_axis(noise):
    R, origins = recording(np.random.default_rng(3), noise=noise, slide=0.0)
    with pytest.raises(DegenerateGeometryError, match="axis of the instrument is not determined"):
        estimate_axis(R, origins)


def test_one_axis_of_turning_and_few_poses_are_refused():
    random = np.random.default_rng(4)
    with pytest.raises(DegenerateGeometryError, match="hardly turned, or turned about one axis"):
        estimate_axis(*recording(random, turn=0.0))
    with pytest.raises(TooFewPosesError):
        estimate_axis(*recording(random, 7))


def test_a_roll_about_its_own_axis_is_no_cone(tmp_path: Path, capsys) -> None:
    R, origins = recording(np.random.default_rng(5), noise=0.1, about=AXIS.direction)
    towards = ",".join(map(str, AXIS.direction))
    assert main(["pivot", str(write(tmp_path, R, origins)), f"--axis={towards}"]) == 3
    assert "parallel" in capsys.readouterr().err


def write(tmp_path: Path, R, origins) -> Path:
    matrices = np.tile(np.eye(4), (len(R), 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = R, origins
    path = tmp_path / "poses.csv"
    np.savetxt(path, matrices.reshape(-1, 16), delimiter=",", fmt="%.12f")
    return path


def test_known_and_estimated_axes_lead_to_the_same_rcm(tmp_path: Path, capsys) -> None:
    path = write(tmp_path, *recording(np.random.default_rng(6), noise=0.1))
    points = []
    for name, options in {
        "known": [
            "--axis=" + ",".join(map(str, AXIS.direction)),
            "--axis-point=" + ",".join(map(str, AXIS.point_mm)),
        ],
        "found": ["--axis", "estimate"],
    }.items():
        assert main(["pivot", str(path), *options, "--output", str(tmp_path / name)]) == 0
        content = json.loads((tmp_path / name / "rcm.json").read_text(encoding="utf-8"))
        points.append(content["rcm"]["least_squares"]["point_mm"])
        np.testing.assert_allclose(points[-1], RCM_MM, atol=0.2)
        assert abs(np.dot(content["axis"]["direction"], AXIS.direction)) > 0.9999
    assert "Instrument's axis through" in capsys.readouterr().out
    assert points[0] != points[1]


def test_a_file_in_metres_is_suspected_and_can_be_read(tmp_path: Path, capsys) -> None:
    R, origins = recording(np.random.default_rng(9), noise=0.1)
    path = str(write(tmp_path, R, origins / 1000))
    tips, axes = [], []
    for options in ([], ["--unit-mm", "1000"]):
        assert main(["pivot", path, "--axis", "estimate", *options, "--output", str(tmp_path)]) == 0
        axes.append("may be in metres" in capsys.readouterr().out)
        assert main(["pivot", path, *options]) == 0
        tips.append("may be in metres" in capsys.readouterr().out)
    assert tips == axes == [True, False]
    rcm = json.loads((tmp_path / "rcm.json").read_text(encoding="utf-8"))["rcm"]
    np.testing.assert_allclose(rcm["least_squares"]["point_mm"], RCM_MM, atol=0.2)
    assert main(["pivot", path, "--unit-mm", "0"]) == 2


def test_alike_frames_widen_the_stated_uncertainty() -> None:
    random = np.random.default_rng(7)
    R, origins = recording(random, 60)
    R, origins = np.repeat(R, 20, axis=0), np.repeat(origins, 20, axis=0)
    origins = origins + np.repeat(0.5 * random.standard_normal((60, 3)), 20, axis=0)
    naive = solve(*AXIS.lines(R, origins))
    rcm, (finding,) = with_recording(naive, AXIS, R, origins)
    assert "two halves" in finding.text
    wider = np.trace(rcm.least_squares.covariance_mm2) / np.trace(
        naive.least_squares.covariance_mm2
    )
    assert 8 < wider < 40  # 20 frames tell as much as one


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--axis", "0,0"], "--axis is '0,0', not three numbers"),
        (["--axis", "0,0,nan"], "not three numbers"),
        (["--axis", "0,0,0"], "not three numbers"),
        (["--axis", "up"], "--axis is 'up'"),
        (["--axis-point", "0,0,1"], "--axis-point is a point on a known axis"),
    ],
)
def test_wrong_options_are_told(options, told, tmp_path: Path, capsys) -> None:
    path = write(tmp_path, *recording(np.random.default_rng(8), 9))
    assert main(["pivot", str(path), *options]) == 2
    assert told in capsys.readouterr().err
