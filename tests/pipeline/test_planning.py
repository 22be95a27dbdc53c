"""Plans: a rig that is not built yet, the smallest number of poses, and what limits."""

from dataclasses import replace

import numpy as np
import pytest

from pivometer.calibration import Board, Calibration
from pivometer.errors import UsageError
from pivometer.measurement import ImportedRig
from pivometer.pipeline import foreseen_calibration, plan, two_cameras
from pivometer.uncertainty.foresight import Shaft

SHAFT = Shaft(10.0, (20.0, 140.0))
BOARD = Board("checkerboard", (9, 7), 15.0)


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    rig = two_cameras(focal_px=1000, image_size=(640, 480), distance_mm=480, baseline_mm=525)
    return foreseen_calibration(rig, BOARD, board_views=12)


def test_cameras_stand_where_two_of_three_measures_say():
    given = {"focal_px": 900.0, "image_size": (1280, 1024)}
    by_angle = two_cameras(**given, distance_mm=400, convergence_deg=60)
    by_both = two_cameras(**given, baseline_mm=400, convergence_deg=60)
    by_length = two_cameras(**given, distance_mm=400, baseline_mm=400)
    for rig in (by_angle, by_both, by_length):
        np.testing.assert_allclose(rig.baselines_mm, [400])
        middle = rig.reference_from_camera[1].inverse() @ [0, 0, 400]
        np.testing.assert_allclose(middle, [0, 0, 400], atol=1e-9)
    for wrong in ({"distance_mm": 400}, {"distance_mm": 400, "baseline_mm": 801}):
        with pytest.raises(UsageError):
            two_cameras(**given, **wrong)


def test_the_smallest_number_of_poses_reaches_what_is_wanted_and_one_less_does_not(calibration):
    def largest(count):
        made = plan(calibration, SHAFT, poses=count, robot_rms_mm=1.0)
        return made.foresight.uncertainty.expanded_mm.max()

    planned = plan(calibration, SHAFT, poses=10, robot_rms_mm=1.0, wanted_mm=1.5)
    assert planned.limit == "poses"
    fewest = planned.fewest.poses
    assert largest(fewest) <= 1.5 < largest(fewest - 1)


def test_where_the_calibration_limits_no_number_of_poses_helps(calibration):
    planned = plan(calibration, SHAFT, poses=10, wanted_mm=0.01)
    assert (planned.limit, planned.fewest) == ("calibration", None)


def test_a_foreseen_calibration_recovers_the_rig(calibration):
    rig = two_cameras(focal_px=1000, image_size=(640, 480), distance_mm=480, baseline_mm=525)
    off = calibration.rig.reference_from_camera[1].translation_mm
    off = off - rig.reference_from_camera[1].translation_mm
    names = list(rig.parameter_names)
    u = np.sqrt(calibration.covariance.diagonal())[[names.index(f"right.t{a}_mm") for a in "xyz"]]
    assert (np.abs(off) < 4 * u).all()
    assert calibration.noise_px == pytest.approx(0.1, rel=0.05)


def test_a_rig_without_uncertainty_is_refused(calibration):
    with pytest.raises(UsageError, match="without its uncertainty"):
        plan(ImportedRig(calibration.rig, "opencv", {}), SHAFT)


def test_a_better_calibration_is_worth_what_its_covariance_says(calibration):
    better = replace(calibration, covariance=calibration.covariance / 4)
    before, after = (plan(c, SHAFT, poses=10).foresight for c in (calibration, better))
    np.testing.assert_allclose(
        after.uncertainty.calibration_mm2, before.uncertainty.calibration_mm2 / 4, rtol=1e-3
    )
