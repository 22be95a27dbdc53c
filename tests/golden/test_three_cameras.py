"""More than two cameras, all the way: the third is in the session, the rig and the answer."""

from dataclasses import replace

import numpy as np
import pytest

import pivometer
from pivometer import pipeline
from pivometer.cameras import Rig
from pivometer.simulation.presets import camera, gold, looking
from pivometer.uncertainty import lies_within


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    preset = gold()
    pivot = preset.stage.pivot_mm
    third = looking(np.array([150.0, -60.0, 120.0]), pivot - [0.0, 52.0, 0.0], 0.0, 0.0)
    rig = Rig(
        [*preset.rig.cameras, camera("third", [820, 818], [322.0, 241.0], [-0.15, 0.05])],
        [*preset.rig.reference_from_camera, third],
    )
    folder = tmp_path_factory.mktemp("three") / "session"
    preset = replace(preset, rig=rig, single_mm=(*preset.single_mm, 400.0))
    pipeline.simulate(preset, folder, poses=8, board_pairs=8, single_views=2)
    (folder / "shaft/right/003.png").unlink()  # two cameras still see this pose
    return folder


def test_three_cameras_give_one_rcm(session):
    measured = pivometer.measure(pivometer.load(session))
    truth = pipeline.true_rcm(session)
    assert len(measured.calibration.rig.cameras) == 3
    assert [len(pose.edges) for pose in measured.poses] == [3, 3, 3, 2, 3, 3, 3, 3]
    assert measured.rejected == ()
    assert lies_within(
        truth.least_squares.point_mm,
        measured.rcm.least_squares.point_mm,
        measured.uncertainty.total_mm2,
        degrees_of_freedom=measured.uncertainty.degrees_of_freedom,
    )
    assert measured.shaft.diameter.value_mm == pytest.approx(
        measured.setup.diameter_mm, abs=3 * measured.shaft.diameter.u_mm
    )
    assert not measured.shaft.moved.significant
    assert not measured.shaft.change.significant
    assert all(pose.cylinder.chi_square < pose.cylinder.limit for pose in measured.used)
