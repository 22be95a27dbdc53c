"""The uncertainty of the result by drawing: nothing is linearized."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.cameras.rig import Rig
from pivometer.rcm.lines import centred_lines
from pivometer.rcm.minimax import solve_minimax
from pivometer.shaft.triangulation import lines_from_edge_normals
from pivometer.uncertainty.carried_edges import (
    SeenAlike,
    normals_of,
    thinned_points,
    transforms_of,
)
from pivometer.uncertainty.coverage import COVERAGE
from pivometer.uncertainty.line_errors import LineErrors
from pivometer.uncertainty.propagation import LocationUncertainty, square_root
from pivometer.uncertainty.remainders import FittedEdges
from pivometer.uncertainty.shading import one_sided

FEWEST_DRAWS = 100
"""Fewer draws know a standard uncertainty to no better than 7 %."""

DIFFERENCE = 0.1
"""Part by which a standard uncertainty may differ from the linear one, beyond what chance makes of
it, before the linear one is doubted: U is stated with two digits."""


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """What the draws of one quantity are like.

    Parameters
    ----------
    mean_mm, u_mm
        Mean and standard deviation, mm.
    interval_mm
        The central part that holds `MonteCarlo.coverage` of them, shape (2,), mm.
    """

    mean_mm: float
    u_mm: float
    interval_mm: Floats

    def __post_init__(self) -> None:
        ends = read_only(checked(self.interval_mm, (2,), "interval_mm"))
        object.__setattr__(self, "interval_mm", ends)


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarlo:
    """The uncertainty of location and misses by drawing every input from its distribution.

    Parameters
    ----------
    draws, seed
        How many were made, from which seed.
    coverage
        Part of the draws that each interval holds.
    x, y, z
        The least-squares point in the reference camera's frame.
    max, rms
        The largest miss at the minimax point, and the rms miss at the least-squares point. Noise is
        in the observed misses already, and in these once more: their mean lies above what was
        observed by about as much as that lies above the robot's own.
    linear_ratio
        The standard uncertainties of x, y and z over those of the linear propagation, shape (3,).
    linear_holds
        Whether the two agree.
    """

    draws: int
    seed: int
    coverage: float
    x: Spread
    y: Spread
    z: Spread
    max: Spread
    rms: Spread
    linear_ratio: Floats
    linear_holds: bool

    def __post_init__(self) -> None:
        ratio = read_only(checked(self.linear_ratio, (3,), "linear_ratio"))
        object.__setattr__(self, "linear_ratio", ratio)


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """All that is drawn, and the way from there to the result: pixels, edges, lines, RCM.

    Parameters
    ----------
    groups
        The poses that the same cameras saw, with points of their edges.
    rig
        The cameras.
    rig_root
        A root of the covariance of their parameters, shape (d, r).
    edge_roots
        For each group, a root of the covariance of both normals, shape (n, c, 6, 6).
    robot_root
        A root of the covariance of the location from what scatters beside edges and floor, (3, 3).
    degrees_of_freedom
        With which that covariance is known.
    floor_mm
        Standard deviation of every line a component from the instrument's floor, mm.
    """

    groups: tuple[SeenAlike, ...]
    rig: Rig
    rig_root: Floats
    edge_roots: tuple[Floats, ...]
    robot_root: Floats
    degrees_of_freedom: float
    floor_mm: float = 0.0

    def drawn(self, count: int, random: np.random.Generator) -> Floats:
        """Return x, y, z, max and rms of a number of draws, shape (count, 5), mm."""
        return np.stack([self._drawn(random) for _ in range(count)])

    def _drawn(self, random: np.random.Generator) -> Floats:
        rig = self.rig.perturbed(self.rig_root @ random.standard_normal(self.rig_root.shape[1]))
        light = random.standard_normal(len(rig.cameras))
        poses = sum(len(group.poses) for group in self.groups)
        points, directions = np.empty((poses, 3)), np.empty((poses, 3))
        for group, roots in zip(self.groups, self.edge_roots, strict=True):
            normals = normals_of(group, rig)
            noise = (roots @ random.standard_normal((*roots.shape[:3], 1)))[..., 0]
            moved = normals + noise.reshape(normals.shape)
            for place, index in enumerate(group.cameras):
                moved[:, place] += light[index] * one_sided(normals[:, place], rig.cameras[index])
            points[group.poses], directions[group.poses], _ = lines_from_edge_normals(
                moved / np.linalg.norm(moved, axis=-1, keepdims=True), transforms_of(group, rig)
            )
        points += self.floor_mm * random.standard_normal(points.shape)
        lines = centred_lines(points, directions)
        radii = lines.radii()
        spread = np.sqrt(self.degrees_of_freedom / random.chisquare(self.degrees_of_freedom))
        robot = spread * (self.robot_root @ random.standard_normal(3))
        rms = np.sqrt(radii @ radii / poses)
        return np.array([*(lines.centre + robot), solve_minimax(lines).max_mm, rms])


def chain(
    edges: Sequence[Sequence[FittedEdges]],
    rig: Rig,
    rig_covariance: ArrayLike,
    linear: LocationUncertainty,
    errors: LineErrors,
) -> Chain:
    """Return the chain from edges and calibration to the RCM, ready to be drawn from.

    Parameters
    ----------
    edges, rig, rig_covariance
        As in `location_uncertainty`.
    linear
        What it returned: it holds the scatter of the lines, of which the robot's own part is drawn.
    errors
        What the instrument does to the lines: what edges and floor explain of that scatter is drawn
        by itself.
    """
    size = len(rig.parameter_names)
    groups = thinned_points(edges, [camera.name for camera in rig.cameras])
    values, vectors = np.linalg.eigh(
        linear.lines_mm2 - errors.location_mm2(errors.stated().alone_mm2)
    )
    independent = linear.independent_poses or float(len(edges))
    return Chain(
        groups,
        rig,
        square_root(checked(rig_covariance, (size, size), "rig_covariance")),
        tuple(_edge_roots(edges, group, rig) for group in groups),
        vectors * np.sqrt(np.maximum(values, 0.0)),
        max(2 * independent - 3, 1.0),
        float(np.sqrt(errors.floor_mm2[0])),
    )


def _edge_roots(edges: Sequence[Sequence[FittedEdges]], group: SeenAlike, rig: Rig) -> Floats:
    """Return roots of the covariances of the normals of a group, shape (n, c, 6, 6)."""
    names = [rig.cameras[index].name for index in group.cameras]
    covariances = np.stack(
        [
            [
                next(one for one in edges[pose] if one.camera == name).normals_covariance
                for name in names
            ]
            for pose in group.poses
        ]
    )
    values, vectors = np.linalg.eigh(covariances)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :])


def summary(draws: ArrayLike, linear: LocationUncertainty, *, seed: int) -> MonteCarlo:
    """Return what the draws of a chain say, beside the linear propagation.

    Parameters
    ----------
    draws
        x, y, z, max and rms of every draw, shape (n, 5), mm.
    linear
        The linear propagation of the same measurement.
    seed
        From which they were made.

    References
    ----------
    GUM supplement 1 (JCGM 101:2008), 7.6, 7.7 and 8.1.
    """
    values = checked(draws, (None, 5), "draws")
    tails = [(1 - COVERAGE) / 2, (1 + COVERAGE) / 2]
    x, y, z, largest, rms = (
        Spread(float(one.mean()), float(one.std(ddof=1)), np.quantile(one, tails))
        for one in values.T
    )
    stated = np.sqrt(linear.total_mm2.diagonal())
    ratio = np.array([x.u_mm, y.u_mm, z.u_mm]) / stated
    chance = 3 / np.sqrt(2 * len(values))
    return MonteCarlo(
        len(values),
        seed,
        COVERAGE,
        x,
        y,
        z,
        largest,
        rms,
        ratio,
        bool((np.abs(ratio - 1) <= DIFFERENCE + chance).all()),
    )
