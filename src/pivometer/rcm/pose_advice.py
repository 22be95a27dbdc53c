"""Which poses to add, in words that a person beside the robot can follow."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pivometer._arrays import Floats, checked
from pivometer.geometry.line import unit
from pivometer.rcm.cone import signed_axes

WANTED_CONE_DEG = 57.0
"""The paper's cone: the axial standard uncertainty is 2.9 line errors over √n there."""

_RINGS, _SPOKES = (0.5, 1.0), 12
_NEAR = np.radians(1.0)
"""Gaps that differ by less than this are alike: then the steeper pose is the better one."""


def poses_to_add(
    directions: ArrayLike,
    *,
    count: int = 3,
    cone_deg: float = WANTED_CONE_DEG,
    allowed: Callable[[Floats], NDArray[np.bool_]] | None = None,
) -> Floats:
    """Return directions within a cone that lie farthest from those there are, shape (k, 3).

    Parameters
    ----------
    directions
        Directions of the shaft so far, of any length and sign, shape (n, 3).
    count
        How many to name; fewer where not so many are allowed.
    cone_deg
        Apex angle of the cone to fill, about the middle of those there are.
    allowed
        Tells of unit directions, shape (m, 3), which ones the cameras measure well.

    Examples
    --------
    >>> new = poses_to_add([[0, 0.01, 1], [0.01, 0, 1], [0, 0, 1]], count=2)
    >>> np.degrees(np.arccos(np.abs(new @ [0, 0, 1]))).round(-1)
    array([30., 30.])
    """
    tips, middle = signed_axes(unit(checked(directions, (None, 3), "directions")))
    candidates = _cone(middle, np.radians(cone_deg) / 2)
    if allowed is not None:
        candidates = candidates[allowed(candidates)]
    there, added = tips, []
    for _ in range(min(count, len(candidates))):
        gaps = np.arccos(np.clip(candidates @ there.T, -1, 1)).min(axis=1)
        tilts = np.arccos(np.clip(candidates @ middle, -1, 1))
        best = int(np.argmax(np.where(gaps > gaps.max() - _NEAR, tilts, -1.0)))
        added.append(candidates[best])
        there = np.vstack([there, candidates[best]])
    return np.array(added).reshape(-1, 3)


def _cone(middle: Floats, half_rad: float) -> Floats:
    """Return directions on rings of a cone about `middle`, shape (m, 3)."""
    right = unit(np.cross(middle, np.eye(3)[int(np.argmin(np.abs(middle)))]))
    turns = np.arange(_SPOKES) * 2 * np.pi / _SPOKES
    across = np.cos(turns)[:, None] * right + np.sin(turns)[:, None] * np.cross(middle, right)
    rings = [np.cos(half_rad * r) * middle + np.sin(half_rad * r) * across for r in _RINGS]
    return np.vstack(rings)


def advice_text(
    directions: ArrayLike,
    *,
    camera: str | None = None,
    allowed: Callable[[Floats], NDArray[np.bool_]] | None = None,
) -> str:
    """Say which poses to add.

    Parameters
    ----------
    directions, allowed
        As in `poses_to_add`.
    camera
        The camera whose frame (x right, y down, z forward) the directions are in; without one the
        axes are named.

    Examples
    --------
    >>> print(advice_text([[0, 1, 0.1], [0, 1, 0.0], [0, 1, -0.1], [0.02, 1, 0]], camera="left"))
    from its middle direction tilt the shaft by 28°, so that in the pictures of camera left its \
upper end goes to the right; to the left; away from the camera
    >>> print(advice_text([[0, 0.1, 1], [0, -0.1, 1], [0, 0.0, 1], [0, 0.05, 1]]))
    from its middle direction tilt the shaft by 28° towards +x; −x; −y
    """
    middle = signed_axes(unit(checked(directions, (None, 3), "directions")))[1]
    new = poses_to_add(directions, allowed=allowed)
    if not len(new):
        return ""
    end, sign = _visible_end(middle)
    tilts = np.degrees(np.arccos(np.clip(new @ middle, -1, 1)))
    ways = dict.fromkeys(_way(sign * (d - (d @ middle) * middle), camera is not None) for d in new)
    start = f"from its middle direction tilt the shaft by {tilts.max():.0f}°"
    if camera is None:
        return f"{start} towards {'; '.join(ways)}"
    return (
        f"{start}, so that in the pictures of camera {camera} its {end} end goes {'; '.join(ways)}"
    )


def _visible_end(middle: Floats) -> tuple[str, float]:
    """Name the end of the shaft as a camera sees it, and the sign that points to it."""
    axis = int(np.argmax(np.abs(middle)))
    return ("left", "upper", "nearer")[axis], -float(np.sign(middle[axis]))


def _way(across: Floats, seen: bool) -> str:
    """Name the way in which the end of a shaft moves, by its largest components."""
    words = [
        ("to the left", "to the right"),
        ("up", "down"),
        ("towards the camera", "away from the camera"),
    ]
    size = np.abs(across)
    parts = [k for k in np.argsort(-size) if size[k] > 0.45 * size.max()]
    if seen:
        return " and ".join(words[k][int(across[k] > 0)] for k in parts)
    return "".join(f"{'+' if across[k] > 0 else '−'}{'xyz'[k]}" for k in parts)
