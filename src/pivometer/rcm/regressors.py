"""What misses may follow, as regressors: direction, order, side of approach, joint values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pivometer._arrays import Floats

DEGREES = ((70, 4), (40, 3), (20, 2), (10, 1))
"""Degree of the polynomial map over the shaft's directions from so many poses on: the map takes at
most a third of the 2n numbers, and none is drawn through fewer than ten poses."""

MOST_BREAKS = 60
"""Places at which a jump is looked for; more would cost time and find the same."""

FEWEST_BESIDE_BREAK = 3

STILL = 1e-9
"""A joint whose values differ by less than this, relative to their size, did not move."""


def direction_map(across: Floats) -> Floats:
    """Return the powers of a line's two slopes across the mean shaft, shape (n, m).

    Examples
    --------
    >>> direction_map(np.zeros((25, 2))).shape, direction_map(np.zeros((5, 2))).shape
    ((25, 5), (5, 0))
    """
    degree = next((d for least, d in DEGREES if len(across) >= least), 0)
    size = max(float(np.abs(across).max()), np.finfo(float).tiny)
    x, y = (across / size).T
    powers = [x**i * y ** (d - i) for d in range(1, degree + 1) for i in range(d + 1)]
    return np.stack(powers, axis=1) if powers else np.zeros((len(across), 0))


def joint_regressors(name: str, values: Floats) -> Floats:
    """Return what a joint's error may follow, shape (n, k).

    Cos θ, sin θ and θ for an angle (name ending in ``_deg`` or ``_rad``), the value and its square
    for a length; nothing for a joint that did not move.

    Examples
    --------
    >>> joint_regressors("q1_deg", np.array([0.0, 90.0, 180.0])).round(3) + 0.0
    array([[ 1.,  0., -1.],
           [ 0.,  1.,  0.],
           [-1.,  0.,  1.]])
    """
    span = float(np.ptp(values))
    if span <= STILL * float(np.abs(values).max()):
        return np.zeros((len(values), 0))
    linear = 2 * (values - values.min()) / span - 1
    if not name.endswith(("_deg", "_rad")):
        return np.stack([linear, linear**2], axis=1)
    angle = np.radians(values) if name.endswith("_deg") else values
    return np.stack([np.cos(angle), np.sin(angle), linear], axis=1)


def label_steps(labels: Sequence[str]) -> tuple[tuple[str, ...], Floats]:
    """Return the labels that occur, and a step for each but the first, shape (n, labels − 1).

    Examples
    --------
    >>> label_steps(["up", "down", "up"])
    (('down', 'up'), array([[1.], [0.], [1.]]))
    """
    known = sorted(set(labels))
    steps = [[float(label == name) for name in known[1:]] for label in labels]
    return tuple(known), np.array(steps).reshape(len(labels), max(len(known) - 1, 0))


def order_alternatives(times_s: Floats | None, count: int) -> tuple[list[Floats], list[int]]:
    """Return a drift from 0 to 1 and jumps from 0 to 1, shape (n, 1) each, and where they jump."""
    time = np.arange(count, dtype=np.float64) if times_s is None else times_s
    span = float(np.ptp(time))
    drift = (time - time[0]) / span if span > 0 else np.arange(count) / max(count - 1, 1)
    first, last = FEWEST_BESIDE_BREAK, count - FEWEST_BESIDE_BREAK
    places = np.unique(np.linspace(first, last, min(MOST_BREAKS, last - first + 1)).round())
    breaks = [int(place) for place in places]
    jumps = [(np.arange(count) >= at).astype(np.float64)[:, None] for at in breaks]
    return [drift[:, None], *jumps], breaks


def successive_block(left_mm: Floats) -> int:
    """Return how many successive lines count as one, from the correlation of what is left of them.

    Misses of the frames of a video, or along a path, are alike; (1 + ρ)/(1 − ρ) of them say as
    much as one. A correlation that chance explains (1.64/√2n, 5 %) does not count.

    Examples
    --------
    >>> walk = np.cumsum(np.random.default_rng(0).standard_normal((400, 3)), axis=0)
    >>> successive_block(walk) > 20, successive_block(np.diff(walk, axis=0))
    (True, 1)
    """
    count, whole = len(left_mm), float(np.square(left_mm).sum())
    if whole == 0:
        return 1
    rho = float(np.sum(left_mm[1:] * left_mm[:-1])) / whole
    if rho < 1.64 / np.sqrt(2 * count):
        return 1
    return min(int(np.ceil((1 + rho) / (1 - min(rho, 0.99)))), count)
