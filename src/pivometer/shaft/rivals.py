"""Which of several things that turn in a camera's frames is the shaft, or that nobody can tell.

Another rod that pivots leaves edges as long, as parallel and as constant in width as the shaft's.
One camera sees no diameter, so all there is to go by is that an instrument's shaft is the widest of
what turns there; where not even that is clear the camera gives no answer and names both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pivometer.shaft.motion import Motion, PairTable, at_pivot, common_motion

MOST_MOTIONS = 3

SAME_PIVOT_SPREADS = 3.0
"""Pairs that pass a motion's pivot this close, at any width, are on the thing that turns there: its
stripes, its collar and its carriage."""

SERIOUS_SHARE = 0.4
"""A motion counts that this share of the frames shows."""

EQUAL_SUPPORT = 0.25
"""A motion with this share of the best one's edge length is seen as well as that one."""

FAINT_SUPPORT = 0.08
"""One with less is chance; between the two it may be the shaft, badly seen."""

WIDER = 1.2
"""Ratio of widths that tells a shaft from a thinner rod."""


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """One thing that turns: its motion and the edge length that all frames show of it, px."""

    motion: Motion
    support_px: float


def turning_things(table: PairTable) -> list[Turning]:
    """Return what turns in the frames, the best seen first; each about a pivot of its own."""
    things: list[Turning] = []
    frames = len(np.unique(table.at))
    for _ in range(MOST_MOTIONS):
        motion = common_motion(table)
        if motion is None or motion.frames < max(3.0, SERIOUS_SHARE * frames):
            break
        fits = motion.agreement(table)
        things.append(Turning(motion, float(fits[table.best_per_frame(fits)].sum())))
        away = np.abs(at_pivot(table, motion.pivot_px, 0.0)[0]) / motion.spread_px
        table = table.rows(away > SAME_PIVOT_SPREADS)
    return sorted(things, key=lambda thing: -thing.support_px)


def widest(things: list[Turning]) -> tuple[Turning, Turning | None, bool]:
    """Return the shaft, the thing most like it, and whether the two can be told apart.

    Of all things seen as well as the best, the widest is the shaft. It cannot be told if another is
    about as wide, or if a wider one is badly seen.
    """
    best = things[0].support_px
    well = [thing for thing in things if thing.support_px >= EQUAL_SUPPORT * best]
    shaft = max(well, key=lambda thing: thing.motion.width_px)
    others = [t for t in things if t is not shaft and t.support_px >= FAINT_SUPPORT * best]
    if not others:
        return shaft, None, True
    rival = max(others, key=lambda thing: thing.motion.width_px)
    told = rival.motion.width_px * WIDER < shaft.motion.width_px
    return shaft, rival if rival in well or not told else None, told
