"""Diameters that cannot be one shaft's."""

import numpy as np

from pivometer.shaft.fitting.stated import ShaftEdges
from pivometer.shaft.gate import CAMERAS_TOLERANCE, diameter_faults, uncertain_end


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


def edges_of(sigma_px: float, angle_sigma_rad: float, blur_px: float = 0.8) -> ShaftEdges:
    """Edges 200 px long, one of them exact."""
    along = np.linspace(0, 200, 25)
    points = np.stack([np.stack([np.full(25, x), along], axis=1) for x in (100.0, 120.0)])
    return ShaftEdges(
        camera="left",
        points_px=points,
        normals=[[1, 0, 0], [-1, 0, 0]],
        normals_covariance=np.zeros((6, 6)),
        sigma_px=[sigma_px, 0.0],
        angle_sigma_rad=[angle_sigma_rad, 0.0],
        width_px=20.0,
        contrast=[9.0, 40.0],
        blur_px=blur_px,
        residual_px=0.1,
        used_part=[1.0, 1.0],
    )


def test_an_edge_that_is_not_known_at_its_ends_is_said_to_be_so():
    # At 100 px from the middle: √(0.12² + (100 × 0.0025)²) = 0.277 px, with 0.0028 rad 0.305 px.
    assert uncertain_end(edges_of(0.12, 0.0025)) is None
    reason = uncertain_end(edges_of(0.12, 0.0028))
    assert reason is not None
    assert "known to 0.30 px only at its ends" in reason
    assert "contrast of 9 grey levels" in reason
    assert uncertain_end(edges_of(0.12, 0.0028, blur_px=1.1)) is None
