"""What several calibrated cameras agree is one thing that turns.

One camera sees no diameter. Two that are calibrated do: of the right pair of silhouettes both
measure the same, in every pose, and the centerlines pass one point. A rod in one picture and the
shaft in the other give neither, nor does a stripe in one and a silhouette in the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from pivometer._arrays import Floats
from pivometer.cameras import Rig
from pivometer.shaft.finding.candidates import Candidate
from pivometer.shaft.finding.motion import WIDTH_POWER
from pivometer.shaft.finding.relations import along, joined
from pivometer.shaft.silhouette import edge_normals

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
"""Standard deviation of a diameter from unrefined edges, as above, for edges that are off to the
same side in both cameras. Chosen: a shaft of 12 px was measured 0.83 to 1 of its diameter, one of
50 px 0.97 to 1."""

RATIO_SPREAD = 0.15
"""Median departure of single poses from the usual ratio, above which it is not one thing."""

LEAST_SLENDERNESS = 1.5
"""Carriages were 1.1 to 1.2 widths long in drawn sessions, shafts of 60 px or less at least 1.9."""

LEAST_DIHEDRAL_SINE = 0.05
MISS_DIAMETERS = 0.6
MISS_PX = 4.0
"""Median distance of the centerlines from their common point: robots miss by up to 0.3 diameters,
edges by a pixel or two."""


@dataclass(frozen=True, slots=True, eq=False)
class Centerlines:
    """Middles of one thing's edges in space, in the poses that two cameras see.

    Parameters
    ----------
    poses
        Names of the poses.
    points_mm, directions
        A point of each line and its unit direction, shape (n, 3), the rig's frame.
    planes
        Unit normals of the planes of both cameras' centres and the lines, shape (n, 2, 3).
    """

    poses: tuple[str, ...]
    points_mm: Floats
    directions: Floats
    planes: Floats


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
    lines
        Its centerlines.
    """

    chosen: tuple[Candidate, ...]
    diameter_mm: float
    support: float
    score: float
    lines: Centerlines

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
            and all(map(along, self.chosen, wider.chosen))
        )

    def joined_to(self, shaft: Together) -> bool:
        """Whether a camera sees an edge of it on something else, as of a shaft and its shadow."""
        return any(map(joined, self.chosen, shaft.chosen))

    def shadows(self, other: Together) -> bool:
        """Whether it is rather something better seen that is joined to its shadow."""
        return (
            self.apart_from(other)
            and self.joined_to(other)
            and self.diameter_mm > other.diameter_mm
            and self.support < other.support
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
            one.described(camera.name) for one, camera in zip(self.chosen, rig.cameras, strict=True)
        ]
        return f"one of {self.diameter_mm:.1f} mm ({', '.join(places)})"


def agreeing(
    seen: Sequence[Sequence[Candidate]], poses: Sequence[Mapping[int, str]], rig: Rig
) -> list[Together]:
    """Return every choice of one candidate per camera that is one thing for all of them.

    Parameters
    ----------
    seen, poses, rig
        As of `concurrence`.
    """
    planes = [[_Planes.of(one, poses[c], rig, c) for one in ones] for c, ones in enumerate(seen)]
    measured: dict[tuple[int, int, int, int], tuple[float, float, Centerlines] | None] = {}
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
        diameters, fits, lines = zip(*told, strict=True)
        ones = tuple(seen[c][k] for c, k in enumerate(choice))
        parts = [one.support_px / most for one, most in zip(ones, best, strict=True)]
        score = min(fits) * sum(
            part * one.width_px**WIDTH_POWER for part, one in zip(parts, ones, strict=True)
        )
        diameter = float(np.median(diameters))
        found.append(Together(ones, diameter, min(parts), score, lines[0]))
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _Planes:
    """A candidate's tangent planes: outward normals (n, 2, 3) by pose, in the rig's frame."""

    normals: Mapping[str, Floats]
    centre_mm: Floats
    width_px: float

    @classmethod
    def of(cls, one: Candidate, poses: Mapping[int, str], rig: Rig, number: int) -> _Planes:
        camera, place = rig.cameras[number], rig.reference_from_camera[number]
        samples = [sample for sample in one.edges_px if sample in poses]
        normals: dict[str, Floats] = {}
        if samples:
            stacked = edge_normals(np.stack([one.edges_px[s] for s in samples]), camera)
            turned = place.rotate(stacked.reshape(-1, 3)).reshape(-1, 2, 3)
            normals = {poses[s]: turned[k] for k, s in enumerate(samples)}
        return cls(normals, place.translation_mm, one.width_px)


def _one_thing(one: _Planes, other: _Planes) -> tuple[float, float, Centerlines] | None:
    """Return the diameter (mm) on which two cameras agree, how well (1 is fully), and where."""
    common = [pose for pose in one.normals if pose in other.normals]
    least = LEAST_SHARE * min(len(one.normals), len(other.normals))
    if len(common) < max(LEAST_POSES, least):
        return None
    pair = np.stack([[side.normals[pose] for side in (one, other)] for pose in common])
    centres = np.stack([one.centre_mm, other.centre_mm])
    planes, points, directions, diameters = _centerlines(pair, centres)
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
    poses = tuple(common[place] for place in np.flatnonzero(good))
    lines = Centerlines(poses, points[good], directions[good], planes[good])
    return diameter, float(np.exp(-(away**2) / 2)), lines


def _centerlines(pair: Floats, centres: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return planes (n, 2, 3), points, directions (n, 3), diameters (n, 2); nan if degenerate."""
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
    return middles, points, direction, diameters


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
