"""Which of the things that turn before several cameras is the shaft: what they agree on.

One camera sees no diameter. Two that are calibrated do: of the right pair of silhouettes both
measure the same, in every pose, and the centerlines pass one point. A rod in one picture and the
shaft in the other give neither, nor does a stripe in one and a silhouette in the other. So chance
things fall away, what remains is compared in mm, and a stated diameter decides.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from pivometer._arrays import Floats
from pivometer.cameras import Rig
from pivometer.shaft.candidates import Candidate
from pivometer.shaft.detection import TRUSTED_MEDIAN, ShaftFinder
from pivometer.shaft.edges import edge_normals
from pivometer.shaft.motion import WIDTH_POWER
from pivometer.shaft.rivals import EQUAL_SUPPORT, WIDER

LEAST_POSES = 3
LEAST_SHARE = 0.3
"""Poses in which both cameras must see a thing, and their share of those in which one does."""

RATIO = 0.02
RATIO_PX = 0.7
RATIO_SIGMAS = 3.0
"""Standard deviation of the ratio of one thing's diameters from two cameras: 2 % and what 0.7 px of
its width are, and the most that counts. Unrefined edges are good to about 1 px, and on shaded
shafts off to the same side in both."""

DIAMETER = 0.03
DIAMETER_PX = 1.0
MOST_SIGMAS = 3.0
CLEAR_SIGMAS = 1.5
"""Standard deviation of a diameter from unrefined edges, as above, for edges that are off to the
same side in both cameras; the most that it may differ from the stated one; and by how much better
one of two things must fit. Chosen: a shaft of 12 px was measured 0.83 to 1 of its diameter, one of
50 px 0.97 to 1."""

ON_SHAFT_PX = 2.0
"""Whatever lies on the shaft is within half its width, and so much that edges are off, of one of
its edges."""

RATIO_SPREAD = 0.15
"""Median departure of single poses from the usual ratio, above which it is not one thing."""

LEAST_SLENDERNESS = 1.5
"""Carriages were 1.1 to 1.2 widths long in drawn sessions, shafts of 60 px or less at least 1.9."""

WELL = 0.4
"""Of one thing's pairs of edges the widest with this part of the best one's score is its
silhouette. In drawn scenes: lanes of brushed metal under clutter 1 to 0.5, a collar 0.18."""

LEAST_RIVAL = 0.1
"""What shows less of its edges than this part of what the longest thing shows is no rod that may be
the shaft, but edges of clutter and collars that agree by chance."""

FAINT_RIVAL = 0.03
"""With so little something clearly wider still is the shaft; where all cameras see it rarely, there
is no answer. In 390 drawn sessions all such things that were not joined to a shadow were shafts."""

LONG_SLENDERNESS = 6.0
"""What one camera alone sees turn, wider than the shaft, may be it if it is so long in its widths,
or as well seen as what is seen best; or slender, if the others see something turn besides, too. In
390 drawn sessions it was so in 7 where a rod was taken, and in one beside a shaft, a carriage."""

MOST_UNEXPLAINED = 0.5
"""In few poses another pair of edges half as long as the shaft's may be the shaft instead."""

LEAST_DIHEDRAL_SINE = 0.05
MISS_DIAMETERS = 0.6
MISS_PX = 4.0
"""Median distance of the centerlines from their common point: robots miss by up to 0.3 diameters,
edges by a pixel or two."""


@dataclass(frozen=True, slots=True, eq=False)
class Together:
    """One thing as all cameras see it.

    Parameters
    ----------
    chosen
        Which of each camera's candidates it is.
    diameter_mm
        What they measure, the median over cameras and poses.
    support
        Edge length as a part of the best candidate's, the least of the cameras.
    score
        The same, summed over the cameras, with the width's weight as in one camera's vote.
    """

    chosen: tuple[Candidate, ...]
    diameter_mm: float
    support: float
    score: float

    @property
    def things(self) -> tuple[int, ...]:
        """Which thing it is in each camera."""
        return tuple(one.thing for one in self.chosen)

    @property
    def sigma(self) -> float:
        """Relative standard uncertainty of the diameter."""
        return DIAMETER + DIAMETER_PX / min(one.width_px for one in self.chosen)

    def apart_from(self, other: Together) -> bool:
        """Whether no camera sees both as the same thing."""
        return all(one != another for one, another in zip(self.things, other.things, strict=True))

    def lies_on(self, wider: Together) -> bool:
        """Whether it is part of something wider: all cameras see it along that, about its pivot."""
        return (
            self.things == wider.things
            and self.diameter_mm < wider.diameter_mm
            and all(map(_along, self.chosen, wider.chosen))
        )

    @property
    def rare(self) -> bool:
        """Whether no camera sees it often."""
        return all(one.rare for one in self.chosen)

    @property
    def slender(self) -> bool:
        """Whether all cameras see it longer than wide, as a shaft, not as what holds it."""
        return min(one.slenderness for one in self.chosen) > LEAST_SLENDERNESS

    def departure(self, diameter_mm: float) -> float:
        """Return by how many standard deviations it differs from a stated diameter."""
        return abs(float(np.log(self.diameter_mm / diameter_mm))) / self.sigma

    def described(self, rig: Rig) -> str:
        """How a person would find it in the images."""
        places = [
            f"{one.description} in {camera.name}"
            for one, camera in zip(self.chosen, rig.cameras, strict=True)
        ]
        return f"one of {self.diameter_mm:.1f} mm ({', '.join(places)})"


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
    planes = [[_Planes.of(one, poses[c], rig, c) for one in ones] for c, ones in enumerate(seen)]
    agreeing = _agreeing(seen, planes)
    often = [one for one in agreeing if not one.rare]
    if not often:
        return Concurrence(None, None)
    if diameter_mm is not None:
        fitting = [one for one in often if one.departure(diameter_mm) < MOST_SIGMAS]
        if fitting:
            return _fitting(fitting, often, diameter_mm, rig)
    found = _widest(often, rig)
    wider = None if found.shaft is None else _wider(seen, agreeing, found.shaft, rig)
    if wider is None:
        return found
    advice = "state diameter_mm"
    if diameter_mm is not None:
        advice = (
            f"nothing that all cameras see often has the stated {diameter_mm:g} mm: give hints "
            "([shaft.hint])"
        )
    return Concurrence(None, f"{wider}; {advice}")


def _wider(
    seen: Sequence[Sequence[Candidate]], agreeing: Sequence[Together], shaft: Together, rig: Rig
) -> str | None:
    """Say what is wider and may be the shaft instead, too badly seen to tell, if anything is."""
    faint = _faint(agreeing, shaft)
    if faint is not None:
        return (
            f"of something wider that turns too little is seen to tell whether it is the shaft: "
            f"{faint.described(rig)}, not {shaft.described(rig)}"
        )
    alone = " and ".join(_seen_by_one(seen, shaft, rig))
    if alone:
        return (
            f"the cameras agree on {shaft.described(rig)}, but not on what else turns and is "
            f"wider: {alone}"
        )
    return None


def _faint(agreeing: Sequence[Together], shaft: Together) -> Together | None:
    """Return what is clearly wider than the shaft, but hardly seen, if there is anything."""
    least = FAINT_RIVAL * max(one.support for one in agreeing)
    wider = [
        one
        for one in agreeing
        if one.slender
        and one.support >= least
        and one.apart_from(shaft)
        and not all(map(_joined, one.chosen, shaft.chosen))
        and one.diameter_mm > WIDER * (1 + CLEAR_SIGMAS * shaft.sigma) * shaft.diameter_mm
    ]
    return max(wider, key=lambda one: one.score, default=None)


def _joined(one: Candidate, shaft: Candidate) -> bool:
    """Tell whether an edge of something wider usually lies on the shaft: it is joined to a shadow.

    Of 7 such things in drawn sessions with shadows all were so, of 6 thick shafts none.
    """
    away = [
        min(
            _farthest_px(ends, edge)
            for ends in one.edges_px[sample]
            for edge in shaft.edges_px[sample]
        )
        for sample in one.edges_px
        if sample in shaft.edges_px
    ]
    return bool(away) and float(np.median(away)) < shaft.width_px / 2 + ON_SHAFT_PX


def _along(one: Candidate, other: Candidate) -> bool:
    """Tell whether most of one's length is usually beside the other, along the other's middle."""
    parts = []
    for sample in one.edges_px.keys() & other.edges_px.keys():
        middle, around = one.edges_px[sample].mean(axis=0), other.edges_px[sample].mean(axis=0)
        direction = around[1] - around[0]
        (begin, end), (least, most) = np.sort(middle @ direction), np.sort(around @ direction)
        parts.append((min(end, most) - max(begin, least)) / (end - begin))
    return bool(parts) and float(np.median(parts)) > 0.5


def _farthest_px(points_px: Floats, edge_px: Floats) -> float:
    """Return how far points (n, 2) lie from the line through an edge's ends (2, 2) at most."""
    along = edge_px[1] - edge_px[0]
    normal = np.array([-along[1], along[0]]) / np.hypot(*along)
    return float(np.abs((points_px - edge_px[0]) @ normal).max())


def _seen_by_one(seen: Sequence[Sequence[Candidate]], shaft: Together, rig: Rig) -> list[str]:
    """Describe what is wider than the shaft and turns before one camera, not before all alike."""
    besides = [
        _besides(ones, taken, LEAST_SLENDERNESS)
        for ones, taken in zip(seen, shaft.chosen, strict=True)
    ]
    named = []
    for ones, taken, others, camera in zip(seen, shaft.chosen, besides, rig.cameras, strict=True):
        if not all(besides):
            others = _besides(ones, taken, LONG_SLENDERNESS)
        wider = [one for one in others if one.width_px > WIDER * taken.width_px]
        named += [f"{one.description} in {camera.name}" for one in wider[:1]]
    return named


def _besides(ones: Sequence[Candidate], shaft: Candidate, slenderness: float) -> list[Candidate]:
    """Return what one camera sees turn besides the shaft, as well as its best or so slender."""
    best = max(one.support_px for one in ones)
    return [
        one
        for one in ones
        if one.thing != shaft.thing
        and not one.rare
        and not _joined(one, shaft)
        and one.support_px
        >= best * (LEAST_RIVAL if one.slenderness > slenderness else EQUAL_SUPPORT)
    ]


def _fitting(
    fitting: Sequence[Together], agreeing: Sequence[Together], diameter_mm: float, rig: Rig
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
    rest = [one for one in agreeing if one.apart_from(shaft)]
    if rest and shaft.departure(diameter_mm) > CLEAR_SIGMAS:
        rival = max(rest, key=lambda one: one.score)
        return Concurrence(
            None,
            f"two things turn, and neither clearly has the stated {diameter_mm:g} mm: "
            f"{shaft.described(rig)} and {rival.described(rig)}",
        )
    return Concurrence(shaft, None)


def _widest(agreeing: Sequence[Together], rig: Rig) -> Concurrence:
    """Take the widest thing, unless another is about as wide; clearly wider it may be faint."""
    least = LEAST_RIVAL * max(one.support for one in agreeing)
    long = [one for one in agreeing if one.support >= least]
    distinct = _distinct(_silhouettes(long), lambda one: one.score)
    distinct.sort(key=lambda one: -one.diameter_mm)
    faint = _faint(agreeing, distinct[0])
    if faint is not None:
        distinct.insert(0, faint)
    if len(distinct) == 1:
        return Concurrence(distinct[0], None)
    shaft, rival = distinct[:2]
    both = f"{shaft.described(rig)} and {rival.described(rig)}"
    clear = WIDER * (1 + CLEAR_SIGMAS * max(shaft.sigma, rival.sigma))
    if shaft.diameter_mm < clear * rival.diameter_mm:
        return Concurrence(None, f"two things turn and either may be the shaft: {both}")
    return Concurrence(shaft, f"two things turn, and the wider is taken for the shaft: {both}")


def _distinct(ones: Sequence[Together], value: Callable[[Together], float]) -> list[Together]:
    """Return the best of each thing; one that shares a picture with a better one is a chance."""
    found: list[Together] = []
    for one in sorted(ones, key=value, reverse=True):
        if all(one.apart_from(other) for other in found):
            found.append(one)
    return found


def _silhouettes(agreeing: Sequence[Together]) -> list[Together]:
    """Return the widest of each thing's pairs of edges that are seen well: the rest lie inside.

    What turns with a slender shaft and is about as long as wide is the carriage that holds it, and
    what lies along that is on it.
    """
    stout = [one for one in agreeing if not one.slender]
    slender = [one for one in agreeing if one.slender and not any(map(one.lies_on, stout))]
    held = {one.things for one in slender}
    agreeing = slender + [one for one in stout if one.things not in held]
    best: dict[tuple[int, ...], float] = {}
    for one in agreeing:
        best[one.things] = max(best.get(one.things, 0.0), one.score)
    well = [one for one in agreeing if one.score >= WELL * best[one.things]]
    widest = {one.things: one for one in sorted(well, key=lambda one: one.diameter_mm)}
    return list(widest.values())


def _agreeing(
    seen: Sequence[Sequence[Candidate]], planes: Sequence[Sequence[_Planes]]
) -> list[Together]:
    """Return every choice of one candidate per camera that is one thing for all of them."""
    measured: dict[tuple[int, int, int, int], tuple[float, float] | None] = {}
    for a, b in combinations(range(len(seen)), 2):
        for i, j in product(range(len(seen[a])), range(len(seen[b]))):
            measured[a, i, b, j] = _one_thing(planes[a][i], planes[b][j])
    best = [max((one.support_px for one in ones), default=1.0) for ones in seen]
    found = []
    for choice in product(*(range(len(ones)) for ones in seen)):
        every = [measured[a, choice[a], b, choice[b]] for a, b in combinations(range(len(seen)), 2)]
        told = [value for value in every if value is not None]
        if len(told) < len(every):
            continue
        diameters, fits = np.array(told).T
        ones = tuple(seen[c][k] for c, k in enumerate(choice))
        parts = [one.support_px / most for one, most in zip(ones, best, strict=True)]
        score = float(fits.min()) * sum(
            part * one.width_px**WIDTH_POWER for part, one in zip(parts, ones, strict=True)
        )
        found.append(Together(ones, float(np.median(diameters)), min(parts), score))
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _Planes:
    """A candidate's tangent planes: outward normals (n, 2, 3) by pose, in the rig's frame."""

    normals: Mapping[str, Floats]
    centre_mm: Floats
    width_px: float
    focal_px: float

    @classmethod
    def of(cls, one: Candidate, poses: Mapping[int, str], rig: Rig, number: int) -> _Planes:
        camera, place = rig.cameras[number], rig.reference_from_camera[number]
        samples = [sample for sample in one.edges_px if sample in poses]
        normals: dict[str, Floats] = {}
        if samples:
            stacked = edge_normals(np.stack([one.edges_px[s] for s in samples]), camera)
            turned = place.rotate(stacked.reshape(-1, 3)).reshape(-1, 2, 3)
            normals = {poses[s]: turned[k] for k, s in enumerate(samples)}
        focal = float(camera.focal_px.mean())
        return cls(normals, place.translation_mm, one.width_px, focal)


def _one_thing(one: _Planes, other: _Planes) -> tuple[float, float] | None:
    """Return the diameter (mm) on which two cameras agree and how well (1 is fully), or `None`."""
    common = [pose for pose in one.normals if pose in other.normals]
    least = LEAST_SHARE * min(len(one.normals), len(other.normals))
    if len(common) < max(LEAST_POSES, least):
        return None
    pair = np.stack([[side.normals[pose] for side in (one, other)] for pose in common])
    centres = np.stack([one.centre_mm, other.centre_mm])
    points, directions, diameters = _centerlines(pair, centres)
    good = np.isfinite(diameters).all(axis=1) & (diameters > 0).all(axis=1)
    if good.sum() < max(LEAST_POSES, least):
        return None
    ratio = np.log(diameters[good, 0] / diameters[good, 1])
    usual = float(np.median(ratio))
    spread = float(np.median(np.abs(ratio - usual)))
    narrow = min(one.width_px, other.width_px)
    away = abs(usual) / (RATIO + RATIO_PX / narrow)
    if away > RATIO_SIGMAS or spread > RATIO_SPREAD:
        return None
    diameter = float(np.median(diameters[good]))
    allowed = MISS_DIAMETERS + MISS_PX / narrow
    if _usual_miss(points[good], directions[good]) > allowed * diameter:
        return None
    return diameter, float(np.exp(-(away**2) / 2))


def _centerlines(pair: Floats, centres: Floats) -> tuple[Floats, Floats, Floats]:
    """Return points, directions (n, 3) and both cameras' diameters (n, 2); nan where degenerate."""
    middles = pair[:, :, 0] - pair[:, :, 1]
    middles = middles / np.linalg.norm(middles, axis=-1, keepdims=True)
    direction = np.cross(middles[:, 0], middles[:, 1])
    sine = np.linalg.norm(direction, axis=-1)
    clear = sine > LEAST_DIHEDRAL_SINE
    direction = direction / np.where(clear, sine, np.nan)[:, None]
    matrix = np.concatenate([middles, direction[:, None]], axis=1)
    right = np.einsum("ncx,cx->nc", middles, centres)
    right = np.concatenate([right, np.zeros((len(right), 1))], axis=1)
    matrix = np.where(clear[:, None, None], matrix, np.eye(3))
    points = np.linalg.solve(matrix, right[..., None])[..., 0]
    points[~clear] = np.nan
    away = points[:, None] - centres
    diameters = -np.einsum("ncx,ncx->nc", pair.sum(axis=2), away)
    return points, direction, diameters


def _usual_miss(points: Floats, directions: Floats) -> float:
    """Return the median distance of lines from the point nearest to all, mm."""
    across = (1 + 1e-9) * np.eye(3) - directions[:, :, None] * directions[:, None, :]
    right = np.einsum("nij,nj->ni", across, points)
    keep = np.ones(len(points), dtype=bool)
    miss = np.zeros(len(points))
    for _ in range(3):
        point = np.linalg.solve(across[keep].sum(axis=0), right[keep].sum(axis=0))
        miss = np.linalg.norm(across @ point - right, axis=1)
        keep = miss <= 3 * np.median(miss) + 1e-9
    return float(np.median(miss))
