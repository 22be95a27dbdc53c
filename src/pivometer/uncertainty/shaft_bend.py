"""Whether the shaft is bent: a bow to the same side in all poses.

Each camera sees the bow's part across its line of sight. The parts of all cameras give a vector
across the shaft; carried from each pose's direction to the mean one by the least turn, these
vectors point alike if a bent shaft keeps its roll. Shading and noise point anywhere, and how far
they scatter from pose to pose is what the mean is held against (Hotelling's T²), so that nothing
rests on a stated noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pivometer._arrays import Floats
from pivometer.cameras.rig import Rig
from pivometer.geometry.line import cross
from pivometer.shaft.edges import ShaftEdges
from pivometer.uncertainty.shaft_check import CHANCE, ShaftCheck


@dataclass(frozen=True, slots=True, eq=False)
class ShaftBend:
    """The bow that all poses have in common.

    Parameters
    ----------
    sagitta_mm
        How far the middle of the visible part lies from the line through its ends, mm.
    u_mm
        Its standard uncertainty from the scatter of the poses, mm.
    length_mm
        Length of the visible part, mm.
    f_ratio
        Hotelling's T² as an F ratio with 2 and n − 2 degrees of freedom.
    limit
        What chance exceeds once in ten thousand sessions.
    """

    sagitta_mm: float
    u_mm: float
    length_mm: float
    f_ratio: float
    limit: float

    @property
    def significant(self) -> bool:
        """Whether chance is no explanation."""
        return self.f_ratio > self.limit


def shaft_bend(
    edges: Sequence[Sequence[ShaftEdges]],
    rig: Rig,
    check: ShaftCheck,
    *,
    chance: float = CHANCE,
) -> ShaftBend | None:
    """Return the common bow; `None` where fewer than five poses state a curvature in two cameras.

    Parameters
    ----------
    edges, rig
        As for `check_shaft`.
    check
        What it returned for them.
    chance
        How often chance may bring a significant bow.

    References
    ----------
    H. Hotelling, doi:10.1214/aoms/1177732979.
    """
    from scipy.special import fdtri

    mean = check.fits.directions.mean(axis=0)
    mean /= np.linalg.norm(mean)
    bows, lengths = [], []
    for number, pose in enumerate(edges):
        axis = check.fits.directions[number]
        seen = [_seen(one, rig, check, number) for one in pose if one.curvature_sigma_px.all()]
        if len(seen) < 2:
            continue
        across = np.stack([side for side, _, _ in seen])
        bow = np.linalg.lstsq(across, np.array([size for _, size, _ in seen]), rcond=None)[0]
        bows.append(_carried(bow, axis, mean))
        lengths.append(np.mean([length for _, _, length in seen]))
    if len(bows) < 5:
        return None
    base = np.linalg.svd(mean[None])[2][1:]
    flat = np.stack(bows) @ base.T
    count, middle = len(flat), flat.mean(axis=0)
    spread = np.cov(flat.T) / count
    f_ratio = float(middle @ np.linalg.solve(spread, middle)) * (count - 2) / (2 * (count - 1))
    size = float(np.linalg.norm(middle))
    towards = middle / size if size > 0 else np.array([1.0, 0.0])
    return ShaftBend(
        size,
        float(np.sqrt(towards @ spread @ towards)),
        float(np.mean(lengths)),
        f_ratio,
        float(fdtri(2, count - 2, 1 - chance)),
    )


def _seen(
    edges: ShaftEdges, rig: Rig, check: ShaftCheck, number: int
) -> tuple[Floats, float, float]:
    """Return the direction across that a camera sees, the bow along it and its length, mm."""
    place = rig.index(edges.camera)
    transform, focal = rig.reference_from_camera[place], float(rig.cameras[place].focal_px.mean())
    side = transform.rotate(edges.normals[0] - edges.normals[1])
    side /= np.linalg.norm(side)
    ends = edges.points_px[:, [0, -1]].mean(axis=0)
    ray = transform.rotate(np.append(rig.cameras[place].normalized_from_pixels(ends).mean(0), 1.0))
    point = check.fits.points_mm[number] - transform.translation_mm
    axis = check.fits.directions[number]
    # Where the line of sight passes the axis: both perpendicular to their common normal.
    normal = cross(ray, cross(ray, axis))
    at = point - axis * (point @ normal) / (axis @ normal)
    depth = float(transform.inverse().rotate(at)[2])
    inclined = float(np.linalg.norm(cross(ray / np.linalg.norm(ray), axis)))
    length = float(np.linalg.norm(ends[1] - ends[0])) * depth / focal / inclined
    bow = float(edges.curvature_px[0] - edges.curvature_px[1]) / 2 * depth / focal
    return side, bow, length


def _carried(vector: Floats, axis: Floats, mean: Floats) -> Floats:
    """Return a vector turned by the least rotation that brings `axis` to `mean`."""
    turn, cosine = cross(axis, mean), float(axis @ mean)
    turned: Floats = vector * cosine + cross(turn, vector)
    turned += turn * float(turn @ vector) / (1 + cosine)
    return turned
