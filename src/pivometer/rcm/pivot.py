"""Pivot calibration: where a tracked instrument pivots, and where its tip is.

A recording of a thousand frames is not a thousand poses: successive residuals are alike, and
standard errors that ignore it are several times too small. Here they come from blocks of the
recording.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.errors import DegenerateGeometryError, ShapeError, TooFewPosesError
from pivometer.rcm.blocks import ALIKE, block_covariance, halves_apart, lag_one, worth
from pivometer.rcm.geometry_check import NARROW_CONE_DEG, NARROWEST_CONE_DEG
from pivometer.rcm.result import Finding

FEWEST_POSES = 8
"""Fewest poses from which blocks can be drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class PivotCalibration:
    """Where the instrument pivots.

    Parameters
    ----------
    pivot_mm
        The pivot in the tracker's frame, shape (3,), mm.
    tip_mm
        The point of the instrument that stays there, in the instrument's frame, shape (3,), mm.
    covariance_mm2
        Covariance of (pivot, tip), shape (6, 6), mm², from blocks of the recording.
    rms_mm, max_mm
        Root mean square and largest distance of the tip from the pivot, mm.
    misses_mm
        The tip's offsets from the pivot, shape (n, 3), mm.
    lag_one
        Autocorrelation of successive misses.
    effective_count
        How many independent poses would tell as much.
    cone_deg
        Apex angle of the cone whose poses would turn the instrument as much about its weakest axis.
    halves_mm
        Distance between the pivots of the first and of the second half of the recording, mm: what
        the rms does not show.
    """

    pivot_mm: Floats
    tip_mm: Floats
    covariance_mm2: Floats
    rms_mm: float
    max_mm: float
    misses_mm: Floats
    lag_one: float
    effective_count: float
    cone_deg: float
    halves_mm: float

    def __post_init__(self) -> None:
        shapes: dict[str, tuple[int | None, ...]] = {
            "pivot_mm": (3,),
            "tip_mm": (3,),
            "covariance_mm2": (6, 6),
            "misses_mm": (None, 3),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, read_only(checked(getattr(self, name), shape, name)))


def calibrate_pivot(rotations: ArrayLike, translations_mm: ArrayLike) -> PivotCalibration:
    """Return the pivot p and the tip t with the least Σ ‖Rᵢ t + tᵢ − p‖².

    Parameters
    ----------
    rotations
        From the instrument's frame to the tracker's, shape (n, 3, 3), in the order of time.
    translations_mm
        The instrument's origin in the tracker's frame, shape (n, 3), mm.

    Raises
    ------
    ShapeError
        If the shapes differ.
    TooFewPosesError
        If there are fewer than eight poses.
    DegenerateGeometryError
        If the instrument hardly turned, or turned about one axis only.

    References
    ----------
    Z. Yaniv, doi:10.1117/12.2081348 (the algebraic one-step method).

    Examples
    --------
    >>> from pivometer.geometry import RigidTransform
    >>> turns = [[0.3, 0, 0], [-0.3, 0, 0], [0, 0.3, 0], [0, -0.3, 0]] * 2
    >>> rotations = [RigidTransform.from_rotation_vector(v, [0, 0, 0]).rotation for v in turns]
    >>> found = calibrate_pivot(rotations, [[1, 2, 3] - R @ [0, 0, 100] for R in rotations])
    >>> found.pivot_mm.round(9), found.tip_mm.round(9) + 0.0
    (array([1., 2., 3.]), array([  0.,   0., 100.]))
    """
    R = checked(rotations, (None, 3, 3), "rotations")
    origins = checked(translations_mm, (None, 3), "translations_mm")
    if len(R) != len(origins):
        raise ShapeError(
            f"{len(R)} rotations for {len(origins)} translations",
            next_step="pass one of each for every pose",
        )
    if len(R) < FEWEST_POSES:
        raise TooFewPosesError(
            f"{len(R)} poses, {FEWEST_POSES} are the least", next_step="record more poses"
        )
    cone_deg = _turned_deg(R)
    middle = origins.mean(axis=0)
    rows = np.concatenate([np.tile(np.eye(3), (len(R), 1, 1)), -R], axis=2)  # p − Rᵢ t = tᵢ
    normal = np.swapaxes(rows, 1, 2) @ rows
    right = np.einsum("nij,ni->nj", rows, origins - middle)
    unknowns = np.linalg.solve(normal.sum(axis=0), right.sum(axis=0))
    misses = origins - middle - rows @ unknowns
    squares = np.vecdot(misses, misses)
    alike = lag_one(misses)
    return PivotCalibration(
        pivot_mm=unknowns[:3] + middle,
        tip_mm=unknowns[3:],
        covariance_mm2=block_covariance(rows, misses),
        rms_mm=float(np.sqrt(squares.mean())),
        max_mm=float(np.sqrt(squares.max())),
        misses_mm=misses,
        lag_one=alike,
        effective_count=len(R) * worth(alike),
        cone_deg=cone_deg,
        halves_mm=float(np.linalg.norm(halves_apart(rows, misses)[:3])),
    )


def pivot_findings(found: PivotCalibration) -> tuple[Finding, ...]:
    """Return what weakens a pivot calibration, in plain words."""
    findings = []
    if found.cone_deg < NARROW_CONE_DEG:
        findings.append(
            Finding(
                "warning",
                f"the instrument turned only as in a cone of {found.cone_deg:.1f}°",
                "tilt it more, and about all axes: as in a cone of 57°",
            )
        )
    if found.lag_one > ALIKE:
        findings.append(
            Finding(
                "warning",
                f"successive misses are alike (autocorrelation {found.lag_one:.2f}): "
                f"{len(found.misses_mm)} poses tell as much as {found.effective_count:.0f} "
                f"independent ones, and the pivots of its two halves are {found.halves_mm:.1f} mm "
                "apart; the stated uncertainty takes it into account, the rms does not show it",
                "spread the poses: pause, and take single ones in all directions",
            )
        )
    return tuple(findings)


def _turned_deg(R: Floats) -> float:
    """Return the apex angle of the cone with the same turning about the weakest axis, deg.

    For poses that fill a cone of half angle h evenly the rotation about each axis across it has an
    rms of h/2; the least eigenvalue of I − R̄ᵀR̄ is its square.
    """
    mean = R.mean(axis=0)
    least = float(np.linalg.eigvalsh(np.eye(3) - mean.T @ mean)[0])
    cone_deg = float(np.degrees(4 * np.sqrt(max(least, 0.0))))
    if cone_deg < NARROWEST_CONE_DEG:
        raise DegenerateGeometryError(
            f"the instrument turned only as in a cone of {cone_deg:.2g}°, or about one axis: its "
            "tip is not determined",
            next_step="tilt it about all axes, as in a cone of at least 20°, better 57°",
        )
    return cone_deg
