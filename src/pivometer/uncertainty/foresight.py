"""What a measurement will be good for, before it is made: the same propagation, on ideal edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.cameras import Camera, Rig
from pivometer.errors import UsageError
from pivometer.geometry import RigidTransform, tangent_plane_normals
from pivometer.geometry.line import projectors
from pivometer.rcm.least_squares import least_squares_rcm
from pivometer.rcm.minimax import minimax_rcm
from pivometer.shaft.silhouette import edge_normals
from pivometer.shaft.triangulation import Centerline, triangulate_centerline
from pivometer.uncertainty.coverage import (
    COVERAGE,
    coverage_factor,
    fewest_degrees_of_freedom,
)
from pivometer.uncertainty.intrinsic import intrinsic_error
from pivometer.uncertainty.propagation import (
    LocationUncertainty,
    calibration_displacements,
    location_uncertainty,
    square_root,
)

_POINTS = 25
_FEWEST_IN_VIEW = 8
"""Of the points along an edge so many must be in the image: a third of the visible length."""

_DRAWS = 200
"""Draws for the mean of the largest miss: known to 2 %."""

_STEP_PX = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Shaft:
    """The part of the shaft that the cameras see.

    Parameters
    ----------
    diameter_mm
        Its diameter, mm.
    span_mm
        Where the visible part starts and ends, from the RCM towards the robot, mm.
    """

    diameter_mm: float
    span_mm: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class ForeseenEdges:
    """The two edges that a camera will see, and how well it will know them.

    Parameters
    ----------
    camera
        The camera's name.
    points_px
        Points on both edges, shape (2, m, 2), raw px.
    normals
        Their coimage normals, shape (2, 3), camera frame.
    normals_covariance
        Covariance of both normals as one vector of six, shape (6, 6).
    """

    camera: str
    points_px: Floats
    normals: Floats
    normals_covariance: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Foresight:
    """What a number of poses will be good for.

    Parameters
    ----------
    poses
        The number of poses.
    uncertainty
        Of the least-squares point, as a measurement will state it on average.
    instrument_rms_mm, instrument_max_mm
        The rms and the mean largest miss that the instrument alone will show with a perfect robot,
        mm: smaller errors of a robot cannot be seen without taking the noise off.
    """

    poses: int
    uncertainty: LocationUncertainty
    instrument_rms_mm: float
    instrument_max_mm: float

    @property
    def largest_u_mm(self) -> float:
        """The largest expanded uncertainty of a coordinate, mm."""
        return float(self.uncertainty.expanded_mm.max())


def foreseen_edges(
    camera: Camera,
    camera_from_reference: RigidTransform,
    point_mm: ArrayLike,
    direction: ArrayLike,
    shaft: Shaft,
    *,
    edge_px: float,
) -> ForeseenEdges:
    """Return the edges of a shaft in one camera, known from one independent row for each pixel.

    Parameters
    ----------
    camera, camera_from_reference
        The camera, and where it stands.
    point_mm, direction
        The RCM (mm) and the unit direction towards the robot, shape (3,), reference frame.
    shaft
        The shaft.
    edge_px
        Standard deviation of one row's edge, px.

    Raises
    ------
    UsageError
        If less than a third of the visible part is in the image.

    References
    ----------
    A straight line through M points of standard deviation σ: offset σ²/M, slope 12 σ²/(M L²).
    """
    base = camera_from_reference @ checked(point_mm, (3,), "point_mm")
    axis = camera_from_reference.rotate(checked(direction, (3,), "direction"))
    radius = shaft.diameter_mm / 2
    outward = tangent_plane_normals(base, axis, radius)
    along = np.linspace(*shaft.span_mm, _POINTS)[:, None] * axis
    points = np.stack([camera.project(base + radius * normal + along) for normal in outward])
    size = np.array([camera.width, camera.height])
    kept = ((points >= 0) & (points <= size - 1)).all(axis=(0, 2))
    if kept.sum() < _FEWEST_IN_VIEW:
        raise UsageError(
            f"camera {camera.name} sees less than a third of the shaft between "
            f"{shaft.span_mm[0]:g} and {shaft.span_mm[1]:g} mm from the RCM",
            next_step="move the cameras back, take a wider lens, or state the part they see",
        )
    points = points[:, kept]
    return ForeseenEdges(
        camera.name,
        read_only(points),
        read_only(edge_normals(points, camera)),
        read_only(_normals_covariance(points, camera, edge_px)),
    )


def _normals_covariance(points: Floats, camera: Camera, edge_px: float) -> Floats:
    """Return the covariance of both edges' normals, shape (6, 6), by central differences."""
    ways = points[:, -1] - points[:, 0]
    lengths = np.linalg.norm(ways, axis=1)
    across = np.stack([-ways[:, 1], ways[:, 0]], axis=1) / lengths[:, None]
    places = np.linspace(-1, 1, points.shape[1])
    shapes = np.stack([np.ones_like(places), places])  # offset, and slope times half the length
    moved = np.zeros((2, 2, 2, *points.shape))  # back and ahead, edge, shape
    for side in range(2):
        step = _STEP_PX * shapes[:, :, None] * across[side]
        moved[0, side, :, side], moved[1, side, :, side] = -step, step
    back, ahead = edge_normals(points + moved, camera)
    covariance = np.zeros((6, 6))
    for side in range(2):
        jacobian = (ahead - back)[side, :, side].T / (2 * _STEP_PX)
        at = slice(3 * side, 3 * side + 3)
        variances = np.diag([1.0, 3.0]) * edge_px**2 / lengths[side]
        covariance[at, at] = jacobian @ variances @ jacobian.T
    return covariance


@dataclass(frozen=True, slots=True, eq=False)
class ForeseenLines:
    """The edges and centerlines of all planned poses, and what the noise does to them.

    Parameters
    ----------
    edges
        For each pose, the edges of each camera.
    rcm_mm
        The RCM, shape (3,), mm.
    points_mm, directions
        The centerlines, shape (n, 3).
    noise_mm2
        Covariance of each near the RCM, shape (n, 3, 3), mm².
    """

    edges: tuple[tuple[ForeseenEdges, ...], ...]
    rcm_mm: Floats
    points_mm: Floats
    directions: Floats
    noise_mm2: Floats


def foreseen_lines(
    rig: Rig, point_mm: ArrayLike, directions: ArrayLike, shaft: Shaft, *, edge_px: float
) -> ForeseenLines:
    """Return what the cameras will see of a shaft through a perfect RCM.

    Parameters
    ----------
    rig
        The cameras.
    point_mm, directions
        The RCM, shape (3,), mm, and the shaft's directions towards the robot, shape (n, 3), unit
        length; reference frame.
    shaft
        The shaft.
    edge_px
        Standard deviation of one row's edge, px.

    Raises
    ------
    UsageError
        If a camera does not see the shaft.
    DegenerateGeometryError
        If the cameras see a pose in one plane.
    """
    axes, point = checked(directions, (None, 3), "directions"), checked(point_mm, (3,), "point_mm")
    edges = tuple(_seen(rig, point, axis, shaft, edge_px) for axis in axes)
    lines = [_line(rig, pose) for pose in edges]
    return ForeseenLines(
        edges=edges,
        rcm_mm=point,
        points_mm=np.stack([line.point_mm for line in lines]),
        directions=np.stack([line.direction for line in lines]),
        noise_mm2=np.stack([line.position_covariance_mm2(point) for line in lines]),
    )


def foreseen_location(
    lines: ForeseenLines,
    rig: Rig,
    rig_covariance: ArrayLike,
    *,
    robot_rms_mm: float = 0.0,
    coverage: float = COVERAGE,
) -> LocationUncertainty:
    """Return the uncertainty of the least-squares point that a measurement will state on average.

    Parameters
    ----------
    lines
        The planned lines.
    rig, rig_covariance
        The cameras, and the covariance of the entries of ``rig.parameter_names``, shape (d, d).
    robot_rms_mm
        The robot's own rms miss, mm, taken as independent from pose to pose.
    coverage
        Coverage probability of the expanded uncertainty.

    Raises
    ------
    TooFewPosesError, DegenerateGeometryError
        If the poses do not determine the point.
    """
    axes = lines.directions
    robot = robot_rms_mm**2 / 2 * projectors(axes)
    rcm = least_squares_rcm(lines.points_mm, axes, covariances_mm2=lines.noise_mm2 + robot)
    calibrated = location_uncertainty(lines.edges, rig, rig_covariance, coverage=coverage)
    return _with_lines(calibrated, rcm.covariance_mm2, len(axes))


def foresee(
    lines: ForeseenLines,
    rig: Rig,
    rig_covariance: ArrayLike,
    *,
    robot_rms_mm: float = 0.0,
    coverage: float = COVERAGE,
) -> Foresight:
    """Return what a measurement with these lines will be good for: see `foreseen_location`."""
    common = calibration_displacements(lines.edges, rig, rig_covariance, lines.rcm_mm)
    own = intrinsic_error(lines.points_mm, lines.directions, lines.noise_mm2, common_mm=common)
    return Foresight(
        poses=len(lines.edges),
        uncertainty=foreseen_location(
            lines, rig, rig_covariance, robot_rms_mm=robot_rms_mm, coverage=coverage
        ),
        instrument_rms_mm=own.instrument_rms_mm,
        instrument_max_mm=_mean_largest(lines, common),
    )


def _seen(
    rig: Rig, point: Floats, axis: Floats, shaft: Shaft, edge_px: float
) -> tuple[ForeseenEdges, ...]:
    return tuple(
        foreseen_edges(camera, transform.inverse(), point, axis, shaft, edge_px=edge_px)
        for camera, transform in zip(rig.cameras, rig.reference_from_camera, strict=True)
    )


def _line(rig: Rig, edges: Sequence[ForeseenEdges]) -> Centerline:
    return triangulate_centerline(
        np.stack([one.normals for one in edges]),
        rig.reference_from_camera,
        covariances=np.stack([one.normals_covariance for one in edges]),
    )


def _with_lines(calibrated: LocationUncertainty, lines: Floats, count: int) -> LocationUncertainty:
    """Put what the lines will add in the place of the scatter of ideal lines, which is none."""
    total = lines + calibrated.calibration_mm2
    degrees = fewest_degrees_of_freedom(
        [lines, calibrated.calibration_mm2], [2 * count - 3, np.inf]
    )
    factor = coverage_factor(degrees, coverage=calibrated.coverage)
    return LocationUncertainty(
        lines_mm2=lines,
        calibration_mm2=calibrated.calibration_mm2,
        total_mm2=total,
        degrees_of_freedom=degrees,
        coverage=calibrated.coverage,
        coverage_factor=factor,
        expanded_mm=factor * np.sqrt(total.diagonal()),
        max_calibration_u_mm=calibrated.max_calibration_u_mm,
        rms_calibration_u_mm=calibrated.rms_calibration_u_mm,
    )


def _mean_largest(lines: ForeseenLines, common: Floats) -> float:
    """Return the mean largest miss of a perfect robot, mm, by simulation with a fixed seed."""
    rng, count = np.random.default_rng(0), len(lines.edges)
    roots = np.stack([_padded(square_root(one)) for one in lines.noise_mm2])
    largest = []
    for _ in range(_DRAWS):
        moved = np.einsum("nij,nj->ni", roots, rng.standard_normal((count, 3)))
        moved += common @ rng.standard_normal(common.shape[2])
        largest.append(minimax_rcm(lines.points_mm + moved, lines.directions).max_mm)
    return float(np.mean(largest))


def _padded(root: Floats) -> Floats:
    padded = np.zeros((3, 3))
    padded[:, : root.shape[1]] = root
    return padded
