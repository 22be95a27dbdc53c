"""How two things that turn before one camera lie to each other: joined, along, alongside."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.finding.candidates import Candidate

ON_SHAFT_PX = 2.0
"""Whatever lies on the shaft is within half its width, and so much that edges are off, of one of
its edges."""

LEAST_COMMON = 5
LARGEST_ANGLE_DEG, LARGEST_CHANGE_DEG = 2.0, 1.0
LARGEST_CHANGE = 0.1
"""Two things stay parallel if at least so many samples show both, usually so nearly parallel, and
with a standard deviation of the angle between them that is small, also beside how they turn. In 480
drawn sessions 224 of 233 rails of carriages did where nothing else turned; rods changed by 1.3° at
least."""


def joined(one: Candidate, shaft: Candidate) -> bool:
    """Tell whether an edge of something wider usually lies on the shaft: it is joined to a shadow.

    In 510 drawn sessions 13 wider things, hardly seen, were so, and none of 5 thick shafts.

    Parameters
    ----------
    one, shaft
        Candidates of one camera.
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


def along(one: Candidate, other: Candidate) -> bool:
    """Tell whether most of one's length is usually beside the other, along the other's middle.

    Parameters
    ----------
    one, other
        Candidates of one camera.
    """
    parts = []
    for sample in one.edges_px.keys() & other.edges_px.keys():
        middle, around = one.edges_px[sample].mean(axis=0), other.edges_px[sample].mean(axis=0)
        direction = around[1] - around[0]
        (begin, end), (least, most) = np.sort(middle @ direction), np.sort(around @ direction)
        parts.append((min(end, most) - max(begin, least)) / (end - begin))
    return bool(parts) and float(np.median(parts)) > 0.5


def alongside(one: Candidate, other: Candidate) -> bool:
    """Tell whether two things turn side by side, parallel, as a shaft and its carriage's rails.

    Parameters
    ----------
    one, other
        Candidates of one camera.
    """
    common = sorted(one.edges_px.keys() & other.edges_px.keys())
    if len(common) < LEAST_COMMON:
        return False
    own, another = (_middles(candidate, common) for candidate in (one, other))
    away = [_farthest_px(points[:1], middle) for points, middle in zip(own, another, strict=True)]
    if float(np.median(away)) < (one.width_px + other.width_px) / 2:
        return False
    turned, beside = _doubled(own), _doubled(another)
    usual, change = _usual_deg(turned / beside)
    _, turn = _usual_deg(turned / turned[0])
    largest = min(LARGEST_CHANGE_DEG, LARGEST_CHANGE * turn)
    return abs(usual) < LARGEST_ANGLE_DEG and change < largest


def _middles(one: Candidate, samples: Sequence[int]) -> Floats:
    """Return the ends of its middle line in each sample, shape (n, 2, 2)."""
    return np.stack([one.edges_px[sample].mean(axis=0) for sample in samples])


def _doubled(middles: Floats) -> NDArray[np.complex128]:
    """Return lines' directions, their angles doubled so that both ways along a line are one."""
    along = (middles[:, 1] - middles[:, 0]) @ np.array([1, 1j])
    return np.asarray((along / np.abs(along)) ** 2)


def _usual_deg(doubled: NDArray[np.complex128]) -> tuple[float, float]:
    """Return the median of angles whose doubles are given, and their standard deviation, robust."""
    about = doubled.mean()
    angles = np.degrees(np.angle(doubled / about)) / 2
    usual = float(np.median(angles))
    deviation = 1.4826 * float(np.median(np.abs(angles - usual)))
    return usual + float(np.degrees(np.angle(about))) / 2, deviation


def _farthest_px(points_px: Floats, edge_px: Floats) -> float:
    """Return how far points (n, 2) lie from the line through an edge's ends (2, 2) at most."""
    along = edge_px[1] - edge_px[0]
    normal = np.array([-along[1], along[0]]) / np.hypot(*along)
    return float(np.abs((points_px - edge_px[0]) @ normal).max())
