"""The instrument's own floor: what it reads on a joint that is known to turn about one point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.cameras.rig import Rig
from pivometer.errors import TooFewPosesError, UsageError
from pivometer.rcm.least_squares import least_squares_rcm
from pivometer.uncertainty.coverage import COVERAGE
from pivometer.uncertainty.intrinsic import noise_effects
from pivometer.uncertainty.line_errors import LineErrors
from pivometer.uncertainty.sequence import scatter

FEWEST_POSES = 10
"""Poses from which a floor is stated: fewer leave its square uncertain by more than a factor 3."""

NEAR = 1.25
"""Factor by which the size of a pixel at the RCM may differ from that of the gold standard: within
it the floor is scaled with the pixel, beyond it focus and light are other ones, too."""


@dataclass(frozen=True, slots=True, eq=False)
class InstrumentFloor:
    """What the instrument adds to every line beyond its stated noise, seen on a gold standard.

    Parameters
    ----------
    excess_mm2
        Variance of a line a component beyond noise of the edges and calibration: estimate, lower
        and upper end of its 95 % interval, shape (3,), mm².
    rms_mm, max_mm
        What was read on the gold standard: rms miss at the least-squares point and largest miss at
        the minimax point, mm.
    stated_rms_mm
        What of the rms noise of the edges and calibration explain, mm.
    bearing_rms_mm
        Rms miss of the gold standard itself, as stated by the user, mm.
    poses
        Number of its poses.
    cameras
        Name of each camera and the size of its images.
    pixel_mm
        Size of a pixel at the RCM, mean of the cameras, mm.
    session
        Name of the session's folder.
    """

    excess_mm2: Floats
    rms_mm: float
    max_mm: float
    stated_rms_mm: float
    bearing_rms_mm: float
    poses: int
    cameras: tuple[str, ...]
    pixel_mm: float
    session: str

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "excess_mm2", read_only(checked(self.excess_mm2, (3,), "excess_mm2"))
        )

    def at(self, rig: Rig, point_mm: ArrayLike) -> Floats:
        """Return `excess_mm2` for another session of the same instrument, shape (3,), mm².

        Raises
        ------
        UsageError
            If the cameras, or their distance from the RCM, are other ones.
        """
        found = _cameras(rig)
        if found != self.cameras:
            raise UsageError(
                f"the floor is of cameras {', '.join(self.cameras)}, this session has "
                f"{', '.join(found)}",
                next_step="measure the gold standard with this session's cameras",
            )
        ratio = pixel_mm(rig, point_mm) / self.pixel_mm
        if not 1 / NEAR <= ratio <= NEAR:
            raise UsageError(
                f"a pixel at the RCM is {ratio:.2f} times as large as at the gold standard of "
                f"'{self.session}'; a floor holds up to a factor of {NEAR:g}",
                next_step="measure the gold standard from as far as the robot",
            )
        return np.asarray(self.excess_mm2 * ratio**2)


def instrument_floor(
    points_mm: ArrayLike,
    errors: LineErrors,
    rig: Rig,
    *,
    max_mm: float,
    session: str,
    bearing_rms_mm: float = 0.0,
) -> InstrumentFloor:
    """Return the instrument's floor from the lines of a joint that turns about one point.

    With R as in `intrinsic_error`, the sum of squares is on average tr(RS) + (2n − 3)(τ² + β²/2), β
    the rms miss of the joint itself; τ² is what is sought. The sum has about a χ² distribution,
    whose ends give those of τ²; the lower one also without what light from one side may have done.

    Parameters
    ----------
    points_mm
        A point on each line, shape (n, 3), mm.
    errors
        What is stated of the lines.
    rig
        The cameras.
    max_mm
        Largest miss at the minimax point, mm.
    session
        Name of the session's folder.
    bearing_rms_mm
        Rms miss of the joint itself, mm.

    Raises
    ------
    TooFewPosesError
        If there are fewer than ten lines.
    UsageError
        If the joint is said to miss by more than was seen.
    """
    from scipy.special import gammaincinv

    rcm = least_squares_rcm(points_mm, errors.directions)
    count = len(errors.directions)
    if count < FEWEST_POSES:
        raise TooFewPosesError(
            f"{count} usable poses, but the instrument's floor needs at least {FEWEST_POSES}",
            next_step="measure the gold standard in 30 poses or more",
        )
    if not 0 <= bearing_rms_mm <= rcm.rms_mm:
        raise UsageError(
            f"the gold standard is said to miss by {bearing_rms_mm:g} mm rms, but "
            f"{rcm.rms_mm:.3g} mm were seen in all",
            next_step="state the rms miss of the joint itself, smaller than what is seen",
        )
    told = scatter(rcm, points_mm, errors.directions)
    freedom, own = 2 * count - 3, bearing_rms_mm**2 * count
    squares = float(rcm.distances_mm @ rcm.distances_mm)
    half = told.degrees_of_freedom / 2
    low, high = (
        squares * half / float(gammaincinv(half, p))
        for p in ((1 + COVERAGE) / 2, (1 - COVERAGE) / 2)
    )
    noises = (errors.stated(), *errors.possible())
    effects = noise_effects(points_mm, errors.directions, noises)
    stated, *possible = (effect.squares_mm2 for effect in effects)
    excess = np.array([squares - stated - own, low - max(possible) - own, high - stated]) / freedom
    return InstrumentFloor(
        excess_mm2=np.maximum(excess, 0.0),
        rms_mm=rcm.rms_mm,
        max_mm=max_mm,
        stated_rms_mm=float(np.sqrt(stated / count)),
        bearing_rms_mm=bearing_rms_mm,
        poses=count,
        cameras=_cameras(rig),
        pixel_mm=pixel_mm(rig, rcm.point_mm),
        session=session,
    )


def pixel_mm(rig: Rig, point_mm: ArrayLike) -> float:
    """Return the size of a pixel at a point of the reference camera's frame, mm: Z/f, mean."""
    sizes = [
        (camera_from.inverse() @ checked(point_mm, (3,), "point_mm"))[2] / camera.focal_px.mean()
        for camera, camera_from in zip(rig.cameras, rig.reference_from_camera, strict=True)
    ]
    return float(np.mean(sizes))


def _cameras(rig: Rig) -> tuple[str, ...]:
    return tuple(f"{one.name} ({one.width}×{one.height})" for one in rig.cameras)
