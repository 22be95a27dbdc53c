"""Which of several things that turn in a camera's frames is the shaft, or that nobody can tell.

Another rod that pivots leaves edges as long, as parallel and as constant in width as the shaft's.
One camera sees no diameter, so all there is to go by is that an instrument's shaft is the widest of
what turns there; where not even that is clear the camera gives no answer and names both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pivometer.shaft.finding.motion import AGREEING, Motion, PairTable, at_pivot, common_motion

MOST_MOTIONS, MOST_LOOKS = 3, 5
"""Motions that are kept, and how often one is looked for: what too few frames show is chance and
set aside. In a drawn session the long edges of three frames, far apart and crossing by chance, hid
a shaft that 11 of 25 showed."""

SAME_PIVOT_SPREADS = 3.0
"""Pairs that pass a motion's pivot this close, at any width, are on the thing that turns there: its
stripes, its collar and its carriage."""

SERIOUS_SHARE = 0.4
RARE_SHARE, RARE_FRAMES = 0.2, 5
"""A motion counts that this share of the frames shows; with half of it, but five frames, where
another camera sees it in more. With three frames of twelve chance passed for a second rod."""

EQUAL_SUPPORT = 0.25
"""A motion with this share of the best one's edge length is seen as well as that one."""

FAINT_SUPPORT = 0.08
"""One with less is chance; between the two it may be the shaft, badly seen."""

WIDER = 1.2
"""Ratio of widths that tells a shaft from a thinner rod."""


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """One thing that turns: its motion and the edge length that all frames show of it, px.

    A rare one is shown by less than `SERIOUS_SHARE` of the frames.
    """

    motion: Motion
    support_px: float
    rare: bool = False


def turning_things(table: PairTable) -> list[Turning]:
    """Return what turns in at least some frames, the best seen first; each about its own pivot."""
    things: list[Turning] = []
    frames = len(np.unique(table.at))
    serious = max(3.0, SERIOUS_SHARE * frames)
    least = min(serious, max(RARE_FRAMES, RARE_SHARE * frames))
    for _ in range(MOST_LOOKS):
        motion = None if len(things) == MOST_MOTIONS else common_motion(table)
        if motion is None:
            break
        if motion.frames < least:
            apart = motion.agreement(table) < AGREEING * table.weight
            if apart.all():
                break  # another look would find the same
            table = table.rows(apart)
            continue
        fits = motion.agreement(table)
        support = float(fits[table.best_per_frame(fits)].sum())
        things.append(Turning(motion, support, rare=motion.frames < serious))
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
