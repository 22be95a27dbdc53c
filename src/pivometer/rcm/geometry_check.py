"""Whether the lines can be believed: what the residuals do not show, in plain words."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pivometer._arrays import Floats
from pivometer.errors import DegenerateGeometryError
from pivometer.rcm.cone import angles_to_axis, signed_axes
from pivometer.rcm.lines import checked_lines
from pivometer.rcm.pose_advice import advice_text
from pivometer.rcm.result import Finding, RcmSolution

NARROWEST_CONE_DEG = 5.0
"""Below this apex angle the position along the shaft is refused.

Its standard uncertainty times √n is 32 line errors at 5°, against 2.9 at the paper's 57°; a 2°
cone gave an rms of 0.51 mm for a point that was 35 mm off.
"""

NARROW_CONE_DEG = 20.0
"""Below this apex angle the answer carries a warning: 8.1 line errors against 2.9 at 57°."""

ONE_JOINT_RATIO = 0.05
"""Directions this near to one circle, relative to their spread, look like the sweep of one joint.

A filled cone has a ratio of 0.24, a sweep whose second joint moves a twelfth of the first 0.08,
a one-joint sweep with 0.05° of noise over 60° 0.003. Such a sweep gave an rms of 0.124 mm for a
point that was 104 mm off.
"""

FEWEST_FOR_CIRCLE = 6
"""Three directions always lie on a circle, and four or five do so to within a few per cent."""

FEWEST_POSES_ADVISED = 20
"""Fewest poses for a number that others may rely on; 70 is the paper's standard."""

SAME_POSE_RATIO = 1e-9
"""Lines nearer to each other than this part of their size are one line, given twice."""


def geometry_findings(
    points_mm: ArrayLike,
    directions: ArrayLike,
    solution: RcmSolution,
    *,
    camera: str | None = None,
    allowed: Callable[[Floats], NDArray[np.bool_]] | None = None,
) -> tuple[Finding, ...]:
    """Return what weakens or forbids the use of a solution, refusals first.

    Parameters
    ----------
    points_mm, directions
        The lines that were solved, shape (n, 3) each, mm.
    solution
        What `solve` returned for them.
    camera, allowed
        For the advice which poses to add: see `advice_text`.

    Examples
    --------
    >>> from pivometer.rcm import solve
    >>> lines = [[0.0, 0, 0], [0, 0.1, 0], [0, 0, 0]], [[0, 0, 1], [0, 0.01, 1], [0.01, 0, 1]]
    >>> for finding in geometry_findings(*lines, solve(*lines)):
    ...     print(finding.severity, "-", finding.text)
    refusal - the shaft fills a cone of only 0.8°: its position along the shaft cannot be told \
(standard uncertainty 2.9 mm)
    warning - only 3 poses
    """
    points, axes = checked_lines(points_mm, directions)
    findings = [
        *_narrow_cone(solution),
        *_few_tilted(axes, solution),
        *_one_joint(axes),
        *_few_poses(len(axes)),
    ]
    if findings:
        more = advice_text(axes, camera=camera, allowed=allowed)
        add = f"; poses to add: {more}" if more else ""
        findings = [replace(one, next_step=one.next_step + add) for one in findings]
    findings += _repeated(points, axes, solution)
    return tuple(sorted(findings, key=lambda finding: finding.severity != "refusal"))


def refuse_geometry(findings: Iterable[Finding], *, path: Path | str | None = None) -> None:
    """Raise the first refusal among findings.

    Parameters
    ----------
    findings
        What `geometry_findings` returned.
    path
        The file the lines come from, if any.

    Raises
    ------
    DegenerateGeometryError
        If a finding is a refusal.
    """
    for finding in findings:
        if finding.severity == "refusal":
            raise DegenerateGeometryError(finding.text, next_step=finding.next_step, path=path)


def _narrow_cone(solution: RcmSolution) -> Iterator[Finding]:
    if solution.cone_deg >= NARROW_CONE_DEG:
        return
    largest = np.linalg.eigvalsh(solution.least_squares.covariance_mm2)[-1]
    u_mm = float(np.sqrt(max(largest, 0.0)))
    only = f"the shaft fills a cone of only {solution.cone_deg:.1f}°: its position along the shaft"
    if solution.cone_deg < NARROWEST_CONE_DEG:
        text = f"{only} cannot be told (standard uncertainty {u_mm:.2g} mm)"
        yield Finding("refusal", text, "tilt the shaft more: at least 20°, better 57°, across")
    else:
        text = f"{only} is uncertain (standard uncertainty {u_mm:.2g} mm)"
        yield Finding("warning", text, "tilt the shaft more: at least 20°, better 57°, across")


def _few_tilted(axes: Floats, solution: RcmSolution) -> Iterator[Finding]:
    """Find a cone that is wide only by a few poses: then they alone fix the axial position."""
    cone = equivalent_cone_deg(axes)
    if cone >= NARROW_CONE_DEG or solution.cone_deg < NARROW_CONE_DEG:
        return
    severity: Literal["warning", "refusal"] = "warning" if cone >= NARROWEST_CONE_DEG else "refusal"
    yield Finding(
        severity,
        f"only few poses tilt the shaft: its position along the shaft is as uncertain as from "
        f"poses that fill a cone of {cone:.1f}°, though the widest are {solution.cone_deg:.0f}° "
        "apart",
        "tilt the shaft in most poses",
    )


def equivalent_cone_deg(axes: Floats) -> float:
    """Return the apex angle of the filled cone that fixes the axial position as well, deg.

    The axial variance is that of a line over Σ sin² tilt; the mean of sin² tilt over a filled cone
    of half-angle h is 1 − (1 + c + c²)/3 with c = cos h.

    Examples
    --------
    >>> tilts = np.radians([28.5] + [1] * 69)
    >>> axes = np.stack([np.sin(tilts), np.zeros(70), np.cos(tilts)], axis=1)
    >>> round(equivalent_cone_deg(axes), 1)
    8.9
    """
    least = np.linalg.eigvalsh(np.eye(3) - axes.T @ axes / len(axes))[0]
    c = (-1 + np.sqrt(max(1 + 8 - 12 * max(float(least), 0.0), 0.0))) / 2
    return 2 * float(np.degrees(np.arccos(np.clip(c, -1, 1))))


def swept_by_one_joint(axes: Floats) -> tuple[float, float] | None:
    """Return by how much unit directions miss one circle and how far they spread, rms, rad.

    `None` where they do not lie on one circle, or are too few to tell.
    """
    if len(axes) < FEWEST_FOR_CIRCLE:
        return None
    tips, axis = signed_axes(axes)
    spread = _rms(angles_to_axis(tips, axis))
    miss = min(_circle_miss(tips, normal) for normal in _circle_normals(tips))
    return (miss, spread) if miss < ONE_JOINT_RATIO * spread else None


def _one_joint(axes: Floats) -> Iterator[Finding]:
    swept = swept_by_one_joint(axes)
    if swept is not None:
        miss, spread = swept
        yield Finding(
            "warning",
            f"all directions lie on one circle to {np.degrees(miss):.2g}° (spread "
            f"{np.degrees(spread):.2g}°), as when only one joint moves: every shaft then passes "
            "near a point of that joint's axis, whether or not it is the RCM",
            "move all joints that tilt the shaft, so that the poses fill a cone",
        )


def _circle_normals(tips: Floats) -> Floats:
    """Return candidate normals of the plane of a circle through unit vectors, shape (6, 3)."""
    about_mean = tips - tips.mean(axis=0)
    scatters = np.stack([about_mean.T @ about_mean, tips.T @ tips])
    return np.swapaxes(np.linalg.eigh(scatters)[1], 1, 2).reshape(-1, 3)


def _circle_miss(tips: Floats, normal: Floats) -> float:
    """Return the rms angle by which unit vectors miss their best circle about `normal`, rad."""
    angles = np.arccos(np.clip(tips @ normal, -1, 1))
    return float(angles.std())


def _repeated(points: Floats, axes: Floats, solution: RcmSolution) -> Iterator[Finding]:
    """Find lines that are given more than once, as from a tool that did not move."""
    offsets = points - solution.least_squares.point_mm
    feet = offsets - np.vecdot(offsets, axes)[:, None] * axes
    largest = max(float(np.abs(feet).max()), np.finfo(float).tiny)
    outer = (axes[:, :, None] * axes[:, None, :]).reshape(-1, 9)
    keys = np.hstack([outer, feet / largest])
    distinct = len(np.unique(np.round(keys / SAME_POSE_RATIO), axis=0))
    if distinct < len(axes):
        yield Finding(
            "warning",
            f"{len(axes) - distinct} of {len(axes)} poses repeat another one exactly, so that the "
            "stated uncertainty is too small",
            "give each pose once",
        )


def _few_poses(count: int) -> Iterator[Finding]:
    if count < FEWEST_POSES_ADVISED:
        yield Finding(
            "warning",
            f"only {count} poses",
            f"take at least {FEWEST_POSES_ADVISED}, better 70: the largest error grows with the "
            "number of poses and is comparable only at equal numbers",
        )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
