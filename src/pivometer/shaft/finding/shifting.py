"""A shaft that shifts and does not turn in a camera's frames, or turns in a plane with the camera.

Its middle lines are nearly parallel, so nothing tells a pivot. What remains is that one pair of
moving edges outranks all others of its frame and is as wide in all of them.
"""

from __future__ import annotations

import numpy as np

from pivometer._arrays import Floats
from pivometer.shaft.finding.motion import Motion, PairTable

LEAST_FRAMES = 3
LEAST_SHARE = 0.75
"""Share of the frames that have a moving pair in which it must be so."""

MOST_RIVAL = 0.5
"""Weight of the next pair that is another thing, against the best one's."""

WIDTH_SPREAD = 0.2
ANYWHERE_PX = 1e6


def shifting_motion(table: PairTable) -> Motion | None:
    """Return a motion without a pivot (any line passes it), or None where no pair stands out."""
    if len(table.at) == 0:
        return None
    top = table.best_per_frame(table.weight)
    if len(top) < LEAST_FRAMES:
        return None
    width = float(np.median(table.width[top]))
    alike = np.abs(table.width[top] / width - 1) < WIDTH_SPREAD
    alone = np.array([_rival(table, int(row)) < MOST_RIVAL for row in top])
    agreeing = alike & alone
    if agreeing.sum() < max(LEAST_FRAMES, LEAST_SHARE * len(top)):
        return None
    length = float(np.median(table.length[top][agreeing]))
    middle = table.middle[top][agreeing].mean(axis=0)
    return Motion(middle, width, ANYWHERE_PX, WIDTH_SPREAD, length, int(agreeing.sum()))


def _rival(table: PairTable, row: int) -> float:
    """Return the weight of the best other thing in a row's frame as a share of the row's."""
    turn = np.abs(_cross(table.normal, table.normal[row]))
    away = np.abs((table.middle - table.middle[row]) @ table.normal[row])
    other = (table.at == table.at[row]) & ((turn > 0.1) | (away > 2 * table.width[row]))
    return float(table.weight[other].max(initial=0.0) / max(table.weight[row], 1e-9))


def _cross(one: Floats, other: Floats) -> Floats:
    return np.asarray(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])
