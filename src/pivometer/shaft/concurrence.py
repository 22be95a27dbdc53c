"""Which of the things that turn before several cameras is the shaft.

Each camera lists everything that turns, and what all of them agree on is compared in mm
(`agreement`): a stated diameter decides, else the widest thing is the shaft. Where something else
may be it as well there is no answer.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pivometer.cameras import Rig
from pivometer.shaft.detection import TRUSTED_MEDIAN, ShaftFinder
from pivometer.shaft.finding.agreement import LEAST_SLENDERNESS, Together, agreeing
from pivometer.shaft.finding.candidates import Candidate
from pivometer.shaft.finding.relations import joined, turns_with
from pivometer.shaft.finding.rivals import EQUAL_SUPPORT, WIDER
from pivometer.shaft.finding.side_by_side import alongside, is_rail_of, pivots_rather

MOST_SIGMAS = 3.0
CLEAR_SIGMAS = 1.5
"""By how many standard deviations a diameter may differ from the stated one at most, and by how
much better one of two things must fit."""

WELL = 0.4
"""Of one thing's pairs of edges the widest with this part of the best one's score is its
silhouette. In drawn scenes: lanes of brushed metal under clutter 1 to 0.5, a collar 0.18."""

LEAST_RIVAL = 0.1
"""What shows less of its edges than this part of what the longest thing shows is no rod that may be
the shaft, but edges of clutter and collars that agree by chance."""

FAINT_RIVAL = 0.03
"""With so little something clearly wider still is the shaft; where all cameras see it rarely, there
is no answer. In 510 drawn sessions all such things that were not joined to a shadow were shafts."""

LONG_SLENDERNESS = 6.0
"""What one camera alone sees turn, wider than the shaft, may be it if it is so long in its widths,
or as well seen as what is seen best; or slender, if the others see something slender turn besides,
even faintly. In 390 drawn sessions it was so in 7 where a rod was taken, and in one beside a shaft,
a carriage."""

LEANS_SIGMAS = 1.5
"""What is narrower and turns beside the shaft may be it if it pivots rather by so much. No rail
that showed a tenth of the edges did by over 0.8 in 630 drawn sessions."""

MOST_UNEXPLAINED = 0.5
"""In few poses another pair of edges half as long as the shaft's may be the shaft instead."""


@dataclass(frozen=True, slots=True, eq=False)
class Concurrence:
    """What the cameras agree on.

    Parameters
    ----------
    shaft
        The shaft, `None` where nobody can tell or nothing agrees.
    doubt
        Why it is uncertain, or why there is none; `None` where nothing else turns.
    """

    shaft: Together | None
    doubt: str | None

    @property
    def alone(self) -> bool:
        """Whether nothing else moves that is nearly as long, in any camera."""
        if self.shaft is None or self.doubt is not None:
            return False
        return max(one.unexplained for one in self.shaft.chosen) < MOST_UNEXPLAINED


def agreed_finders(
    finders: Sequence[ShaftFinder],
    poses: Sequence[Mapping[int, str]],
    rig: Rig,
    *,
    diameter_mm: float | None = None,
) -> list[ShaftFinder]:
    """Return each camera's finder, of what all of them agree is the shaft.

    Where nothing agrees each keeps its own choice: what is wrong then may be the calibration, and
    what is measured later tells.
    """
    seen = [finder.candidates for finder in finders]
    found = concurrence(seen, poses, rig, diameter_mm=diameter_mm)
    few = min(map(len, poses)) < TRUSTED_MEDIAN and diameter_mm is None
    if few and found.shaft is not None and not found.alone:
        found = Concurrence(
            None,
            f"in so few poses nothing tells the shaft from what else moves: it may be "
            f"{found.shaft.described(rig)}; state diameter_mm, or take {TRUSTED_MEDIAN} poses",
        )
    if found.shaft is not None:
        chosen = zip(finders, found.shaft.chosen, strict=True)
        return [finder.taking(one, found.doubt) for finder, one in chosen]
    if found.doubt is not None:
        return [finder.refusing(found.doubt) for finder in finders]
    return list(finders)


def concurrence(
    seen: Sequence[Sequence[Candidate]],
    poses: Sequence[Mapping[int, str]],
    rig: Rig,
    *,
    diameter_mm: float | None = None,
) -> Concurrence:
    """Decide what the shaft is by what all cameras of a rig agree on.

    Parameters
    ----------
    seen
        Each camera's candidates, in the rig's order.
    poses
        For each camera, the pose that each sample shows.
    rig
        The calibrated cameras.
    diameter_mm
        The shaft's stated diameter, if known.
    """
    every = agreeing(seen, poses, rig)
    rails = _rails(every)
    agreed = [one for one in every if one.things not in rails]
    often = [one for one in agreed if not one.rare]
    if not often:
        return Concurrence(None, None)
    advice = "state diameter_mm"
    if diameter_mm is not None:
        advice = "give hints ([shaft.hint])"
        fitting = [one for one in often if one.departure(diameter_mm) < MOST_SIGMAS]
        if fitting:
            return _advised(_fitting(fitting, often, diameter_mm, rig), advice)
        advice = f"nothing that all cameras see often has the stated {diameter_mm:g} mm: {advice}"
    found = _widest(often, rig)
    wider = None if found.shaft is None else _wider(seen, agreed, rails, found.shaft, rig)
    if wider is None and found.shaft is not None and found.doubt is None:
        found = _beside_what_none_agree_on(seen, every, found.shaft, rig)
    return _advised(found if wider is None else Concurrence(None, wider), advice)


def _advised(found: Concurrence, advice: str) -> Concurrence:
    """Add to the reason why there is no answer what would give one."""
    return found if found.shaft is not None else Concurrence(None, f"{found.doubt}; {advice}")


def _rails(agreed: Sequence[Together]) -> set[tuple[int, ...]]:
    """Return the things of which the best pair of edges turns beside what clearly pivots rather."""
    best = {one.things: one for one in sorted(agreed, key=lambda one: one.score)}.values()
    return {one.things for one in best if any(is_rail_of(one, other) for other in best)}


def _wider(
    seen: Sequence[Sequence[Candidate]],
    agreed: Sequence[Together],
    rails: Collection[tuple[int, ...]],
    shaft: Together,
    rig: Rig,
) -> str | None:
    """Say what is wider and may be the shaft instead, too badly seen to tell, if anything is."""
    faint = _faint(agreed, shaft)
    if faint is not None:
        return (
            f"of something wider that turns too little is seen to tell whether it is the shaft: "
            f"{faint.described(rig)}, not {shaft.described(rig)}"
        )
    alone = " and ".join(_seen_by_one(seen, rails, shaft, rig))
    if alone:
        return (
            f"the cameras agree on {shaft.described(rig)}, but not on what else turns and is "
            f"wider: {alone}"
        )
    return None


def _faint(agreed: Sequence[Together], shaft: Together) -> Together | None:
    """Return what is clearly wider than the shaft, but hardly seen, if there is anything."""
    least = FAINT_RIVAL * max(one.support for one in agreed)
    wider = [
        one
        for one in agreed
        if one.slender
        and one.support >= least
        and one.apart_from(shaft)
        and not one.joined_to(shaft)
        and one.diameter_mm > _clear(shaft) * shaft.diameter_mm
    ]
    return max(wider, key=lambda one: one.score, default=None)


def _seen_by_one(
    seen: Sequence[Sequence[Candidate]],
    rails: Collection[tuple[int, ...]],
    shaft: Together,
    rig: Rig,
) -> list[str]:
    """Describe what is wider than the shaft and turns before one camera, not before all alike."""
    others = _others(seen, shaft, {shaft.things, *rails})
    corroborated = all(
        any(share >= FAINT_RIVAL and one.slenderness > LEAST_SLENDERNESS for one, share in ones)
        for ones in others
    )
    slenderness = LEAST_SLENDERNESS if corroborated else LONG_SLENDERNESS
    named = []
    for ones, taken, camera in zip(others, shaft.chosen, rig.cameras, strict=True):
        wider = [
            one
            for one, share in ones
            if one.width_px > WIDER * taken.width_px
            and share >= (LEAST_RIVAL if one.slenderness > slenderness else EQUAL_SUPPORT)
        ]
        named += [one.described(camera.name) for one in wider[:1]]
    return named


def _beside_what_none_agree_on(
    seen: Sequence[Sequence[Candidate]], every: Sequence[Together], shaft: Together, rig: Rig
) -> Concurrence:
    """Doubt the shaft if each camera sees something else well, but no two see the same in it.

    Of that, which may be the shaft, each may see another lane.
    """
    well = [
        [one for one, share in ones if share >= LEAST_RIVAL and one.slenderness > LEAST_SLENDERNESS]
        for ones in _others(seen, shaft, {one.things for one in every})
    ]
    if not all(well):
        return Concurrence(shaft, None)
    widest = [max(ones, key=lambda one: one.width_px) for ones in well]
    alike = all(
        taken.width_px < _clear(shaft) * one.width_px
        for one, taken in zip(widest, shaft.chosen, strict=True)
    )
    cameras = zip(widest, rig.cameras, strict=True)
    named = " and ".join(one.described(camera.name) for one, camera in cameras)
    agreed = f"two things turn, and the cameras agree on one only: {shaft.described(rig)}"
    return Concurrence(None if alike else shaft, f"{agreed}, not on {named}")


def _others(
    seen: Sequence[Sequence[Candidate]], shaft: Together, known: Collection[tuple[int, ...]]
) -> list[list[tuple[Candidate, float]]]:
    """Return what each camera often sees turn that is not known, and not joined to the shaft.

    With each how much of it is seen, as a part of what is seen best by that camera.
    """
    others = []
    for camera, (ones, taken) in enumerate(zip(seen, shaft.chosen, strict=True)):
        numbers = {things[camera] for things in known}
        best = max(one.support_px for one in ones)
        lengths = _edge_lengths(ones, taken)
        others.append(
            [
                (one, length / best)
                for one, length in zip(ones, lengths, strict=True)
                if not one.rare and one.thing not in numbers and not joined(one, taken)
            ]
        )
    return others


def _edge_lengths(ones: Sequence[Candidate], shaft: Candidate) -> list[float]:
    """Return how much of each candidate's thing is seen, px: lanes of metal each show a part of it.

    Of what turns with the shaft each pair counts alone: edges of the carriage and of its rails.
    """
    whole = {one.thing: 0.0 for one in ones}
    for one in ones:
        whole[one.thing] += one.support_px
    return [one.support_px if turns_with(one, shaft) else whole[one.thing] for one in ones]


def _clear(*ones: Together) -> float:
    """Return by what factor one of things must be wider than another for that to be clear."""
    return WIDER * (1 + CLEAR_SIGMAS * max(one.sigma for one in ones))


def _fitting(
    fitting: Sequence[Together], agreed: Sequence[Together], diameter_mm: float, rig: Rig
) -> Concurrence:
    """Take the thing that has the stated diameter, unless another may have it as well.

    Where other things turn it must fit well: one of them may be the shaft, of which only a stripe
    is seen.
    """
    distinct = _distinct(
        fitting, lambda one: one.score * np.exp(-(one.departure(diameter_mm) ** 2))
    )
    distinct.sort(key=lambda one: one.departure(diameter_mm))
    shaft = distinct[0]
    others = [one for one in distinct[1:] if one.support >= LEAST_RIVAL * shaft.support]
    if others and others[0].departure(diameter_mm) < shaft.departure(diameter_mm) + CLEAR_SIGMAS:
        return Concurrence(
            None,
            f"two things turn that may have the stated {diameter_mm:g} mm: "
            f"{shaft.described(rig)} and {others[0].described(rig)}",
        )
    rest = [one for one in agreed if one.apart_from(shaft)]
    if rest and shaft.departure(diameter_mm) > CLEAR_SIGMAS:
        rival = max(rest, key=lambda one: one.score)
        return Concurrence(
            None,
            f"two things turn, and neither clearly has the stated {diameter_mm:g} mm: "
            f"{shaft.described(rig)} and {rival.described(rig)}",
        )
    return Concurrence(shaft, None)


def _widest(agreed: Sequence[Together], rig: Rig) -> Concurrence:
    """Take the widest thing, unless another is about as wide; clearly wider it may be faint."""
    least = LEAST_RIVAL * max(one.support for one in agreed)
    long = [one for one in agreed if one.support >= least]
    distinct = _distinct(_silhouettes(long), lambda one: one.score)
    distinct.sort(key=lambda one: -one.diameter_mm)
    shadows = [one for one in distinct if any(map(one.shadows, distinct))]
    distinct = [one for one in distinct if one not in shadows]
    faint = _faint(agreed, distinct[0])
    shaft, *others = distinct if faint is None else [faint, *distinct]
    rivals = [one for one in others if not _is_faint_rail(one, shaft)]
    if not rivals and not shadows:
        return Concurrence(shaft, None)
    if not rivals:
        both = f"{shaft.described(rig)} and {shadows[0].described(rig)}"
        return Concurrence(shaft, f"two things turn, and the wider is taken for a shadow: {both}")
    like = [one for one in rivals if _may_be_instead(one, shaft)]
    both = f"{shaft.described(rig)} and {(like or rivals)[0].described(rig)}"
    if like:
        return Concurrence(None, f"two things turn and either may be the shaft: {both}")
    return Concurrence(shaft, f"two things turn, and the wider is taken for the shaft: {both}")


def _may_be_instead(one: Together, shaft: Together) -> bool:
    """Tell whether something may be the shaft instead of what is wider.

    It may if that is not clearly wider, or no longer than wide, as the carriage of a shaft that is
    not seen; or if it is beside that and pivots rather.
    """
    if one.slender and not shaft.slender:
        return True
    if shaft.diameter_mm < _clear(shaft, one) * one.diameter_mm:
        return True
    return alongside(one, shaft) and _leans(one, shaft)


def _is_faint_rail(one: Together, shaft: Together) -> bool:
    """Tell whether something narrower turns beside the shaft, badly seen, which rather pivots."""
    faint = one.support < EQUAL_SUPPORT * shaft.support
    return faint and alongside(one, shaft) and _leans(shaft, one)


def _leans(one: Together, shaft: Together) -> bool:
    """Tell whether something beside the shaft pivots rather, if not clearly."""
    return pivots_rather(one, shaft) > LEANS_SIGMAS


def _distinct(ones: Sequence[Together], value: Callable[[Together], float]) -> list[Together]:
    """Return the best of each thing; one that shares a picture with a better one is a chance."""
    found: list[Together] = []
    for one in sorted(ones, key=value, reverse=True):
        if all(one.apart_from(other) for other in found):
            found.append(one)
    return found


def _silhouettes(agreed: Sequence[Together]) -> list[Together]:
    """Return the widest of each thing's pairs of edges that are seen well: the rest lie inside.

    What turns with a slender shaft and is about as long as wide is the carriage that holds it, and
    what lies along that is on it.
    """
    stout = [one for one in agreed if not one.slender]
    slender = [one for one in agreed if one.slender and not any(map(one.lies_on, stout))]
    held = {one.things for one in slender}
    agreed = slender + [one for one in stout if one.things not in held]
    best: dict[tuple[int, ...], float] = {}
    for one in agreed:
        best[one.things] = max(best.get(one.things, 0.0), one.score)
    well = [one for one in agreed if one.score >= WELL * best[one.things]]
    widest = {one.things: one for one in sorted(well, key=lambda one: one.diameter_mm)}
    return list(widest.values())
