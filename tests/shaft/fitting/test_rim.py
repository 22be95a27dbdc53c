"""What a rim may add, against what a mirror shows."""

import numpy as np

from pivometer.shaft.fitting.rim import LIKELY_RIM, rim


def test_at_grazing_incidence_a_mirror_shows_what_stands_behind():
    angles = np.array([-np.pi / 2, 0.0, np.pi / 2])
    np.testing.assert_allclose(
        rim(angles, (200.0, 20.0), (50.0, 80.0)) / LIKELY_RIM, [-60.0, 0.0, 150.0], atol=1e-12
    )
