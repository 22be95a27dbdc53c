"""What might be the shaft in one camera's frames: everything that turns, at each width it shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pivometer._arrays import Floats
from pivometer.shaft.finding.background import WorkingScale
from pivometer.shaft.finding.motion import Motion, PairTable, at_pivot, hinted_motion
from pivometer.shaft.finding.pairs import EdgePair
from pivometer.shaft.finding.rivals import SAME_PIVOT_SPREADS, SERIOUS_SHARE, Turning
from pivometer.shaft.finding.straight import SAME_LINE_PX

MOST_WIDTHS = 5
OTHER_WIDTH = 0.05
"""Pairs about one pivot are another pair of edges where their width there differs by a twentieth: a
stripe, a lane of brushed metal, a highlight and one edge, or the silhouette around all these. Not
by less than lines differ that are not the same."""

LEAST_SUPPORT = 0.15
"""Share of the thing's edge length that another width must show."""

FITTING_SPREADS = 3.0

NEIGHBOUR_SPREADS = 4.0
LEAST_WIDTH_SPREAD = 0.01
"""Another width of the same thing must be four spreads away, so that no frame takes that one."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One thing that turns, at one width.

    Parameters
    ----------
    motion
        Its motion in the working copy, from the image's centre.
    support_px
        The edge length that all samples show of it, px.
    thing
        Which thing it is: candidates of one number turn about one pivot.
    edges_px
        By sample, its two edges' ends in the raw image, shape (2, 2, 2), where it is seen.
    width_px, pivot_px
        Its width at the pivot and where that is, raw px.
    unexplained
        Edge length of the best other thing in the usual sample, in parts of its own.
    rare
        Whether so few samples show it that another camera must see it in more of them.
    """

    motion: Motion
    support_px: float
    thing: int
    edges_px: Mapping[int, Floats]
    width_px: float
    pivot_px: Floats
    unexplained: float = 0.0
    rare: bool = False

    @property
    def slenderness(self) -> float:
        """How long its edges usually are, in its widths."""
        ends = np.stack(list(self.edges_px.values())) if self.edges_px else np.zeros((1, 2, 2, 2))
        lengths = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=-1)
        return float(np.median(lengths.mean(axis=-1))) / self.width_px

    def described(self, camera: str) -> str:
        """How a person would find it in the images of its camera."""
        x, y = self.pivot_px
        return f"{self.width_px:.0f} px wide about ({x:.0f}, {y:.0f}) in {camera}"


def candidates(
    things: Sequence[Turning],
    table: PairTable,
    pairs: Sequence[Sequence[EdgePair]],
    scale: WorkingScale,
    centre_px: Floats,
    *,
    alone: bool = False,
) -> tuple[Candidate, ...]:
    """Return every thing at every width it shows, the motions of `things` among them.

    Parameters
    ----------
    things
        What turns.
    table, pairs
        The samples' pairs of edges.
    scale, centre_px
        How the working copy was made, and its centre.
    alone
        Whether the things are what they are, at no other width.
    """
    found = []
    for number, thing in enumerate(things):
        for one, part in [(thing, table)] if alone else _widths(thing, table):
            edges = {
                frame: scale.raw_pixels(pairs[frame][which].edges_px + centre_px)
                for frame, which in _fitting(one.motion, part)
            }
            pivot = scale.raw_pixels(one.motion.pivot_px + centre_px)
            width = one.motion.width_px * scale.factor
            others = unexplained(one.motion, table)
            found.append(
                Candidate(
                    one.motion, one.support_px, number, edges, width, pivot, others, thing.rare
                )
            )
    return tuple(found)


def unexplained(motion: Motion, table: PairTable) -> float:
    """Return how the best pair that is another thing compares with the motion's, usually.

    Parameters
    ----------
    motion
        Of what is taken for the shaft.
    table
        The samples' pairs of edges.
    """
    fits = motion.agreement(table)
    away = np.abs(at_pivot(table, motion.pivot_px, 0.0)[0])
    other = np.where(away > SAME_PIVOT_SPREADS * motion.spread_px, table.weight, 0.0)
    own, rest = (values[table.best_per_frame(values)] for values in (fits, other))
    return float(np.median(rest / np.maximum(own, 1e-9))) if len(own) else 0.0


def told_apart(one: Candidate, others: Sequence[Candidate]) -> Motion:
    """Return a candidate's motion, its width so narrow that none of its thing's other widths fits.

    Parameters
    ----------
    one
        The candidate.
    others
        All of the camera's candidates.
    """
    widths = [other.width_px for other in others if other.thing == one.thing and other is not one]
    nearest = min((abs(width / one.width_px - 1) for width in widths), default=1.0)
    narrow = max(nearest / NEIGHBOUR_SPREADS, LEAST_WIDTH_SPREAD)
    return replace(one.motion, width_spread=min(one.motion.width_spread, narrow))


def _fitting(motion: Motion, table: PairTable) -> list[tuple[int, int]]:
    """Return frame and number of each frame's best pair, where it fits the motion."""
    if len(table.at) == 0:
        return []
    away, width = motion.departures(table)
    top = table.best_per_frame(motion.agreement(table))
    good = (np.abs(away[top]) < FITTING_SPREADS) & (width[top] < FITTING_SPREADS)
    return [(int(table.at[row]), int(table.which[row])) for row in top[good]]


def _widths(thing: Turning, table: PairTable) -> list[tuple[Turning, PairTable]]:
    """Return a thing at every width that about as many frames show, and the pairs that may be it.

    Of a short piece the width at the pivot is extrapolated: it is another one only where that
    cannot be why it differs.
    """
    away, width, sigma = at_pivot(table, thing.motion.pivot_px, 0.0)
    frames = len(np.unique(table.at))
    rest = np.abs(away) < SAME_PIVOT_SPREADS * thing.motion.spread_px
    found = [(thing, table)]
    while len(found) < MOST_WIDTHS:
        known = found[-1][0].motion.width_px
        apart = np.maximum(max(OTHER_WIDTH * known, SAME_LINE_PX), FITTING_SPREADS * sigma)
        rest = rest & (np.abs(width - known) > apart)
        part = table.rows(rest)
        motion = hinted_motion(part, thing.motion.pivot_px, None)
        if motion is None or motion.frames < max(3.0, SERIOUS_SHARE * frames):
            break
        if motion.width_px in [one.motion.width_px for one, _ in found]:
            break  # and would come for ever: at the pivot these pairs are not as wide as half way
        fits = motion.agreement(part)
        support = float(fits[part.best_per_frame(fits)].sum())
        if support < LEAST_SUPPORT * thing.support_px:
            break
        found.append((Turning(motion, support), part))
    return found
