"""Poses in the order they were taken: successive ones may miss the RCM alike.

The frames of a video are no poses of their own, nor are those along a path of a robot whose error
changes slowly. To take them for independent makes the uncertainty of the location several times
too small: a thousand frames would pretend to be a thousand poses.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats
from pivometer.geometry.line import projectors
from pivometer.rcm.blocks import ALIKE, FEWEST_BLOCKS, block_covariance, lag_one, worth
from pivometer.rcm.lines import checked_lines
from pivometer.rcm.result import Finding, LeastSquaresRcm

CHANCE_SIGMAS = 3.3
"""Correlations under so many of their standard deviations, 1/√2n where there is none, are chance:
one session in two thousand exceeds it."""


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """What the scatter of the lines says of the least-squares point.

    Parameters
    ----------
    covariance_mm2
        Covariance of the point, shape (3, 3), mm².
    independent_poses
        How many independent poses tell as much: all, unless successive ones miss alike.
    """

    covariance_mm2: Floats
    independent_poses: float

    @property
    def degrees_of_freedom(self) -> float:
        """Degrees of freedom of the covariance."""
        return max(2 * self.independent_poses - 3, 1.0)


def scatter(rcm: LeastSquaresRcm, points_mm: ArrayLike, directions: ArrayLike) -> Scatter:
    """Return the covariance of the least-squares point from lines in the order of their poses.

    It is s² N⁻¹ unless the misses of successive lines are correlated beyond chance; then it comes
    from blocks of successive poses.

    Parameters
    ----------
    rcm
        The least-squares point of the lines, with s² N⁻¹.
    points_mm, directions
        The lines, shape (n, 3) each, mm, in the order in which they were taken.

    References
    ----------
    H. Künsch, doi:10.1214/aos/1176347265.
    """
    points, axes = checked_lines(points_mm, directions)
    across = projectors(axes)
    misses = np.einsum("nij,nj->ni", across, points - rcm.point_mm)
    count, alike = len(points), lag_one(misses)
    if count < 2 * FEWEST_BLOCKS or alike < max(ALIKE, CHANCE_SIGMAS / np.sqrt(2 * count)):
        return Scatter(rcm.covariance_mm2, float(count))
    return Scatter(block_covariance(across, misses), count * worth(alike))


def sequence_findings(count: int, independent_poses: float | None) -> tuple[Finding, ...]:
    """Return a warning if successive poses miss alike.

    Examples
    --------
    >>> sequence_findings(70, 70.0)
    ()
    >>> sequence_findings(900, 31.4)[0].text.partition(":")[0]
    'successive poses miss the RCM alike, as the frames of a video do'
    """
    if independent_poses is None or independent_poses >= count:
        return ()
    return (
        Finding(
            "warning",
            f"successive poses miss the RCM alike, as the frames of a video do: {count} poses tell "
            f"as much as {independent_poses:.0f} independent ones; the stated uncertainty takes "
            "that into account",
            "spread the poses: single ones in all directions, not along a path",
        ),
    )
