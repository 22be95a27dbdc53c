"""What one-sided light does to lines, against edges that are really shifted."""

import numpy as np

from pivometer.cameras import Camera, Rig
from pivometer.uncertainty.carried_edges import feet_of, lines_of, thinned_points
from pivometer.uncertainty.propagation import common_location
from pivometer.uncertainty.shading import SHADING_PX, shading_displacements

RCM_MM = np.array([6.4, 65.7, 478.3])


def straight(rig):
    """The same cameras without distortion: a pixel is then the same all over."""
    cameras = [
        Camera(c.name, c.width, c.height, [1000, 1000], [320, 240], [0, 0]) for c in rig.cameras
    ]
    return Rig(cameras, rig.reference_from_camera)


def test_it_is_what_a_shift_of_both_edges_does(view, rig):
    rig = straight(rig)
    edges = view(12, rig=rig)
    stated = shading_displacements(edges, rig, RCM_MM)
    names = [camera.name for camera in rig.cameras]
    before = feet_of(*lines_of(thinned_points(edges, names), rig), RCM_MM)
    for place in range(2):
        moved = view(12, rig=rig)
        for pose in moved:
            # to the right in the picture, or to the left: the sign is free
            points = pose[place].points_px
            along = points[0, -1] - points[0, 0]
            across = np.array([-along[1], along[0]]) / np.hypot(*along)
            pose[place].points_px = points + SHADING_PX * across * np.sign(across[0])
        after = feet_of(*lines_of(thinned_points(moved, names), rig), RCM_MM)
        found = after - before
        sign = np.sign((found * stated[..., place]).sum())
        np.testing.assert_allclose(sign * found, stated[..., place], rtol=0.02, atol=2e-5)


def test_it_shifts_the_rcm_as_a_whole(view, rig):
    """Light from one side is like a principal point that is off: the misses hardly change."""
    edges = view(40)
    moved = shading_displacements(edges, rig, RCM_MM)
    _, directions = lines_of(thinned_points(edges, [c.name for c in rig.cameras]), rig)
    shift = common_location(directions, moved)
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    left = moved - across @ shift
    assert np.linalg.norm(shift, axis=0).min() > 0.3 * SHADING_PX * 478 / 1000
    assert np.sqrt((left**2).sum(axis=1).mean()) < 0.2 * np.linalg.norm(shift, axis=0).max()
