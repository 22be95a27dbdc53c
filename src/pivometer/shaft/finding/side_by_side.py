"""Two things that turn side by side, as the shaft and a rail of its carriage: which one pivots.

They stay parallel, at a constant distance. Robots miss their point by more than a rail's lines miss
one of their own, but both by the same misses: of all lines between the two, in every pose at the
same part of the way from one to the other, those that meet best tell which it is.
"""

from __future__ import annotations

import numpy as np

from pivometer.geometry.line import across, projectors
from pivometer.shaft.finding.agreement import Together
from pivometer.shaft.finding.rivals import EQUAL_SUPPORT

LEAST_COMMON = 5
LARGEST_ANGLE_DEG, LARGEST_CHANGE_DEG = 2.0, 1.5
LARGEST_CHANGE = 0.1
"""Two things are parallel if at least so many poses show both, with usually so small an angle
before each camera, and with a standard deviation of it that is small, also beside how they turn. In
630 drawn sessions it was 0.3° for rails of a carriage, up to 1.2° for wider ones of which edges are
badly seen, and 2.9° and more for other rods."""

PIVOT_SIGMAS = 4.0
"""By how much one must pivot rather than the other. Unrefined edges are no Gaussian noise: of 492
pairs of a shaft and what turned beside it in 630 drawn sessions, 30 with wide rails, two spoke
against the shaft by more than 1.7, one by 3.3 and a hardly seen one by 4.8."""

ROUNDS = 4
FARTHEST = 3.0
"""Lines over three times as far from the point as usual do not count."""


def is_rail_of(one: Together, shaft: Together) -> bool:
    """Tell whether something turns beside what is well seen and clearly pivots rather.

    Parameters
    ----------
    one, shaft
        What cameras agree on.
    """
    seen = shaft.support >= EQUAL_SUPPORT * one.support and not shaft.rare
    return seen and alongside(one, shaft) and pivots_rather(shaft, one) > PIVOT_SIGMAS


def alongside(one: Together, other: Together) -> bool:
    """Tell whether two things turn side by side: parallel, and neither on the other.

    Parameters
    ----------
    one, other
        What cameras agree on.
    """
    own, another = _common(one, other)
    if len(own) < LEAST_COMMON or not one.apart_from(other):
        return False
    directions = one.lines.directions[own]
    between = across(other.lines.points_mm[another] - one.lines.points_mm[own], directions)
    if np.median(np.linalg.norm(between, axis=1)) < max(one.diameter_mm, other.diameter_mm) / 2:
        return False
    planes = other.lines.planes[another]
    ways = np.sign(np.einsum("ncx,cx->nc", planes, planes[0]))
    angles = np.degrees(ways * np.einsum("ncx,nx->nc", planes, directions))
    usual = np.median(angles, axis=0)
    change = 1.4826 * np.median(np.abs(angles - usual), axis=0)
    turned = np.degrees(np.arccos(np.clip(np.abs(directions @ directions[0]), 0, 1)))
    largest = min(LARGEST_CHANGE_DEG, LARGEST_CHANGE * float(np.median(turned)))
    return bool((np.abs(usual) < LARGEST_ANGLE_DEG).all() and (change < largest).all())


def pivots_rather(one: Together, other: Together) -> float:
    """Return by how many standard deviations one is nearer to what pivots than another beside it.

    Parameters
    ----------
    one, other
        Two things that turn side by side.
    """
    own, another = _common(one, other)
    point = one.lines.points_mm[own].mean(axis=0)
    directions = one.lines.directions[own]
    flat, kept = projectors(directions), np.ones(len(own), dtype=bool)
    part, sigma = 0.5, np.inf
    for _ in range(ROUNDS):
        away = across(one.lines.points_mm[own] - point, directions)
        aside = across(other.lines.points_mm[another] - point, other.lines.directions[another])
        design = np.concatenate([flat, (away - aside)[:, :, None]], axis=2)
        rows, seen = design[kept].reshape(-1, 4), away[kept].ravel()
        inverse = np.linalg.inv(rows.T @ rows)
        solution = inverse @ (rows.T @ seen)
        left = np.linalg.norm(away - design @ solution, axis=1)
        variance = float((left[kept] ** 2).sum()) / max(2 * int(kept.sum()) - 4, 1)
        part, sigma = float(solution[3]), float(np.sqrt(variance * inverse[3, 3]))
        point = point + solution[:3]
        kept = left <= FARTHEST * np.median(left) + 1e-9
    return (0.5 - part) / max(sigma, 1e-9)


def _common(one: Together, other: Together) -> tuple[list[int], list[int]]:
    """Return where both have the poses that show both."""
    places = {pose: place for place, pose in enumerate(other.lines.poses)}
    pairs = [(k, places[pose]) for k, pose in enumerate(one.lines.poses) if pose in places]
    return [k for k, _ in pairs], [k for _, k in pairs]
