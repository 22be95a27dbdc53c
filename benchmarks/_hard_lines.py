"""Line sets of the paper's geometry and of every degenerate kind, for benchmarks and tests."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Lines = tuple[Floats, Floats]
RCM_MM = np.array([6.4, 65.7, 478.3])


def cone(random: np.random.Generator, count: int, apex_deg: float = 57.0) -> Floats:
    """Return directions spread evenly over a cone about z."""
    tilt = np.radians(apex_deg / 2) * np.sqrt(random.random(count))
    turn = 2 * np.pi * random.random(count)
    return np.stack(
        [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=1
    )


def ring(count: int, scale: float) -> Lines:
    """Return lines of a hyperboloid: all at one distance from its middle."""
    turn = 2 * np.pi * np.arange(count) / count
    axes = np.stack([np.cos(turn), np.sin(turn), np.ones(count)], axis=1)
    return scale * np.stack([-np.sin(turn), np.cos(turn), 0 * turn], axis=1), axes


def repeated(random: np.random.Generator, points: Floats, axes: Floats) -> Lines:
    """Return lines most of which are given more than once."""
    chosen = random.integers(0, len(axes), len(axes))
    chosen[:3] = [0, 1, 2]
    return points[chosen], axes[chosen]


def one_distance(random: np.random.Generator, points: Floats, axes: Floats) -> Lines:
    """Return lines that all miss the origin by the same."""
    across = np.cross(axes, random.standard_normal(axes.shape))
    return np.abs(points).max() * across / np.linalg.norm(across, axis=1, keepdims=True), axes


def far_along(random: np.random.Generator, points: Floats, axes: Floats) -> Lines:
    """Return the same lines, each given by a point up to a kilometre along it."""
    return points + 1e6 * random.uniform(-1, 1, (len(axes), 1)) * axes, axes


def parallel_but(others: list[int], points: Floats, axes: Floats) -> Lines:
    """Return lines that are parallel but for some."""
    return points, np.where(np.isin(np.arange(len(axes)), others)[:, None], [1, 0, 1], [0, 0, 1])


def outlier(points: Floats, axes: Floats) -> Lines:
    """Return lines of which one is a million times farther."""
    return points * np.where(np.arange(len(axes)) == 0, 1e6, 1)[:, None], axes


HARD: dict[str, Callable[..., Lines]] = {
    "plain": lambda _, points, axes: (points, axes),
    "cauchy": lambda random, points, axes: (points * random.standard_t(1, axes.shape), axes),
    "coplanar": lambda _, points, axes: (points * [1, 0, 1], axes * [1, 0, 1]),
    "one plane of directions": lambda _, points, axes: (points, axes * [1, 0, 1]),
    "repeated": repeated,
    "symmetric": lambda _, points, axes: ring(len(axes), float(np.abs(points).max())),
    "concurrent": lambda _, points, axes: (0 * points, axes),
    "far from the origin": lambda random, points, axes: (
        points + 1e6 * random.standard_normal(3),
        axes,
    ),
    "given far along": far_along,
    "all but one parallel": lambda _, points, axes: parallel_but([0], points, axes),
    "two parallel families": lambda _, points, axes: parallel_but([0, 1], points, axes),
    "along the coordinate axes": lambda _, points, axes: (
        np.round(2 * points / np.abs(points).max()),
        np.eye(3)[np.arange(len(axes)) % 3],
    ),
    "one outlier": lambda _, points, axes: outlier(points, axes),
    "any length of direction": lambda random, points, axes: (
        points,
        axes * 10.0 ** random.uniform(-6, 6, (len(axes), 1)),
    ),
    "all at one distance": one_distance,
}


UNSOLVABLE: dict[str, Callable[..., Lines]] = {
    "parallel": lambda random, points, axes: (
        points,
        random.choice([-1, 1], (len(axes), 1)) * axes[0],
    ),
    "parallel to 1e-5 rad": lambda random, points, axes: (
        points,
        axes[0] + 1e-5 * random.standard_normal(axes.shape),
    ),
    "only two": lambda _, points, axes: (points[:2], axes[:2]),
}


def adversarial(kind: str, seed: int) -> Lines:
    """Return one hard set of a kind; the sizes, cones and scales vary with the seed."""
    random = np.random.default_rng([seed, *kind.encode()])
    count = int(random.choice([3, 4, 5, 6, 10, 20, 70, 149, 151, 300]))
    axes = cone(random, count, float(random.choice([0.5, 2, 10, 57, 120, 170])))
    points = 10.0 ** random.integers(-6, 7) * random.standard_normal((count, 3))
    return (HARD | UNSOLVABLE)[kind](random, points, axes)
