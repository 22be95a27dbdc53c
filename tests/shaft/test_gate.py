"""Diameters that cannot be one shaft's."""

import numpy as np

from pivometer.shaft.gate import CAMERAS_TOLERANCE, diameter_faults


def test_a_camera_that_sees_other_edges_throughout_is_not_hidden_by_a_common_median():
    rng = np.random.default_rng(3)
    rows = np.array([22.3, 17.5]) + rng.normal(0, 0.1, (20, 2))
    faults = diameter_faults(list(rows))
    assert all(fault is not None and "do not see the same two edges" in fault for fault in faults)


def test_cameras_that_differ_by_less_are_not_refused():
    rows = np.tile([10.0, 10.0 * (1 + 0.8 * CAMERAS_TOLERANCE)], (20, 1))
    assert diameter_faults(list(rows)) == [None] * 20


def test_poses_that_not_all_cameras_saw_are_judged_by_the_common_median():
    faults = diameter_faults([[10.0, 10.1, 10.0], [10.0, 10.1], [10.0, 7.0], [10.0, 10.0]])
    assert [fault is None for fault in faults] == [True, True, False, True]
