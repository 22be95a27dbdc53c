"""Whether what was found in a pose is the shaft: its diameter must be the same everywhere."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats
from pivometer.shaft.fitting.stated import ShaftEdges

LARGEST_END_SIGMA_PX = 0.3
"""At usual blur: 1 in 10 edges known to no better at an end is half a pixel off there."""

NOMINAL_TOLERANCE = 0.15
"""A diameter further than this from the nominal one is another object, whatever the scale."""

SPREAD_TOLERANCE = 0.03
"""Relative difference from the session's median that is always allowed: 0.5 px on a shaft of 17 px,
several times what an edge fitted on a shaded or shiny shaft is off."""

LEAST_POSES = 3
CAMERAS_TOLERANCE = 0.05
"""Relative difference between what two cameras usually measure: of right edges it was under 1 % in
the rendered sets, and of edges a pixel off each on a shaft of 40 px it is 5 %."""


def diameter_faults(
    diameters_mm: Sequence[ArrayLike], *, nominal_mm: float | None = None
) -> list[str | None]:
    """Say for each pose why its diameters cannot be the shaft's, or `None` where they can.

    Every camera measures the shaft's diameter in every pose. It is one number, so a value apart
    from the others is a wrong edge, a wrong object, or two cameras that saw different moments.

    Parameters
    ----------
    diameters_mm
        For each pose the diameter from each camera, mm.
    nominal_mm
        The shaft's stated diameter, if known, mm.

    Returns
    -------
    list of str or None
        One entry per pose.

    Examples
    --------
    >>> diameter_faults([[10.0, 10.1], [9.9, 10.0], [10.0, 7.0]])[2]
    'the shaft measures 7.00 mm in one camera, 10.00 mm over the session'
    """
    if not diameters_mm:
        return []
    seen = [np.asarray(row, dtype=np.float64) for row in diameters_mm]
    median = float(np.median(np.concatenate(seen)))
    spread = 1.4826 * float(np.median(np.abs(np.concatenate(seen) - median)))
    allowed = max(5 * spread, SPREAD_TOLERANCE * median)
    apart = _cameras_fault(seen)
    return [_fault(row, median, allowed, nominal_mm) or apart for row in seen]


def _cameras_fault(seen: Sequence[Floats]) -> str | None:
    """Say so if what one camera usually measures is not what another does: all poses are wrong."""
    if len({len(row) for row in seen}) > 1 or len(seen) < LEAST_POSES:
        return None
    usual = np.median(np.stack(seen), axis=0)
    if usual.max() < (1 + CAMERAS_TOLERANCE) * usual.min():
        return None
    return (
        f"one camera usually measures a shaft of {usual.min():.2f} mm, another one of "
        f"{usual.max():.2f} mm: they do not see the same two edges"
    )


def _fault(row: Floats, median: float, allowed: float, nominal_mm: float | None) -> str | None:
    worst = float(row[np.argmax(np.abs(row - median))])
    if nominal_mm is not None:
        farthest = float(row[np.argmax(np.abs(row - nominal_mm))])
        if abs(farthest - nominal_mm) > NOMINAL_TOLERANCE * nominal_mm:
            return f"the shaft measures {farthest:.2f} mm, not its stated {nominal_mm:.2f} mm"
    if abs(worst - median) > allowed:
        return f"the shaft measures {worst:.2f} mm in one camera, {median:.2f} mm over the session"
    return None


def uncertain_end(edges: ShaftEdges) -> str | None:
    """Say so if an edge is known to no better than 0.3 px at its ends, at usual blur.

    Parameters
    ----------
    edges
        Both edges; each is known best about its middle.

    Returns
    -------
    str or None
        The reason why their pose should not count, if there is one.
    """
    half = np.hypot(*(edges.points_px[:, -1] - edges.points_px[:, 0]).T) / 2
    end = float(np.hypot(edges.sigma_px, edges.angle_sigma_rad * half).max())
    limit = LARGEST_END_SIGMA_PX * max(1.0, edges.blur_px)
    if end <= limit:
        return None
    return (
        f"an edge is known to {end:.2f} px only at its ends (at most "
        f"{limit:.2f} px), with a contrast of {edges.contrast.min():.0f} grey levels"
    )
