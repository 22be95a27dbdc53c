"""From the scatter of the lines and the covariance of the calibration to the RCM's location.

All figures belong to the least-squares point: its covariance can be computed and holds (94–96 % of
nominal 95 % over 300 data sets); the minimax point depends on a few lines and scatters 2.7 to 2.9
times as much.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.cameras.rig import Rig
from pivometer.errors import ShapeError
from pivometer.geometry.line import projectors
from pivometer.rcm.least_squares import least_squares_rcm
from pivometer.uncertainty.carried_edges import (
    Carried,
    EdgePoints,
    feet_of,
    lines_of,
    passing_through,
    thinned_points,
)
from pivometer.uncertainty.coverage import (
    COVERAGE,
    coverage_factor,
    fewest_degrees_of_freedom,
)
from pivometer.uncertainty.sequence import Scatter, scatter
from pivometer.uncertainty.shading import displacements_of

LEAST_CORRELATION = 1e-9
"""Eigenvalues of a correlation matrix below this are rounding, 3e-5 of a standard uncertainty."""


@dataclass(frozen=True, slots=True, eq=False)
class LocationUncertainty:
    """How well the least-squares RCM point is known, in the reference camera's frame.

    Parameters
    ----------
    lines_mm2
        Covariance from the scatter of the lines, shape (3, 3), mm²: s² N⁻¹, or that of blocks where
        successive poses miss alike. It holds the noise of the edges and the robot's own error.
    calibration_mm2
        Covariance from the calibration, J Σ Jᵀ, shape (3, 3), mm²: common to all poses, so more
        poses do not lessen it.
    total_mm2
        The sum of these and of `shading_mm2`, shape (3, 3), mm².
    degrees_of_freedom
        Effective degrees of freedom of the total: the least of the three axes.
    coverage
        Coverage probability of `expanded_mm`, for each axis by itself.
    coverage_factor
        k of that coverage, from Student's t distribution.
    expanded_mm
        Expanded uncertainty U = k u along x, y and z, shape (3,), mm.
    max_calibration_u_mm, rms_calibration_u_mm
        What the calibration adds to the standard uncertainty of the largest and of the rms
        distance from the least-squares point, mm.
    independent_poses
        How many independent poses tell as much as those measured: all of them, unless successive
        ones miss alike; `None` in files of versions that did not ask.
    shading_mm2
        Covariance from light that comes from one side, common to all poses, shape (3, 3), mm²; zero
        in files of versions that did not count it.
    """

    lines_mm2: Floats
    calibration_mm2: Floats
    total_mm2: Floats
    degrees_of_freedom: float
    coverage: float
    coverage_factor: float
    expanded_mm: Floats
    max_calibration_u_mm: float
    rms_calibration_u_mm: float
    independent_poses: float | None = None
    shading_mm2: Floats = field(default_factory=lambda: np.zeros((3, 3)))

    def __post_init__(self) -> None:
        for name, shape in (
            ("lines_mm2", (3, 3)),
            ("calibration_mm2", (3, 3)),
            ("shading_mm2", (3, 3)),
            ("total_mm2", (3, 3)),
            ("expanded_mm", (3,)),
        ):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), shape, name)))


@dataclass(frozen=True, slots=True, eq=False)
class LinesUncertainty:
    """What is known of the RCM's location where nothing is known of the calibration's quality.

    The figures hold the scatter of the lines only, so they are too small by an unknown amount.

    Parameters
    ----------
    lines_mm2
        Covariance from the scatter of the lines, s² N⁻¹, shape (3, 3), mm².
    degrees_of_freedom
        Its degrees of freedom.
    coverage
        Coverage probability of `expanded_mm` if the calibration were perfect.
    coverage_factor
        k of that coverage, from Student's t distribution.
    expanded_mm
        k times the standard uncertainty from the lines along x, y and z, shape (3,), mm.
    status
        ``"calibration unknown"``.
    independent_poses
        As in `LocationUncertainty`.
    """

    lines_mm2: Floats
    degrees_of_freedom: float
    coverage: float
    coverage_factor: float
    expanded_mm: Floats
    status: str = "calibration unknown"
    independent_poses: float | None = None

    def __post_init__(self) -> None:
        for name, shape in (("lines_mm2", (3, 3)), ("expanded_mm", (3,))):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), shape, name)))


def lines_uncertainty(scatter: Scatter, *, coverage: float = COVERAGE) -> LinesUncertainty:
    """Return the part of the location's uncertainty that the scatter of the lines shows.

    Parameters
    ----------
    scatter
        What the lines say of the least-squares point.
    coverage
        Coverage probability of the expanded uncertainty.
    """
    factor = coverage_factor(scatter.degrees_of_freedom, coverage=coverage)
    return LinesUncertainty(
        lines_mm2=scatter.covariance_mm2,
        degrees_of_freedom=scatter.degrees_of_freedom,
        coverage=coverage,
        coverage_factor=factor,
        expanded_mm=factor * np.sqrt(scatter.covariance_mm2.diagonal()),
        independent_poses=scatter.independent_poses,
    )


def location_uncertainty(
    edges: Sequence[Sequence[EdgePoints]],
    rig: Rig,
    rig_covariance: ArrayLike,
    *,
    coverage: float = COVERAGE,
) -> LocationUncertainty:
    """Return the covariance of the least-squares RCM point: lines, calibration and shading.

    The calibration's part goes through the whole chain: with the rig's parameters moved by plus
    and minus one standard deviation along each independent direction of their covariance, the same
    raw edge points are undistorted and fitted (to first order), triangulated and solved again. So
    strongly correlated parameters only move together, as far as the calibration leaves them free.

    Parameters
    ----------
    edges
        For each pose, the edges that two cameras of the rig or more saw, in the rig's order.
    rig
        The calibrated cameras.
    rig_covariance
        Covariance of the entries of `rig.parameter_names`, shape (d, d).
    coverage
        Coverage probability of the expanded uncertainty.

    Raises
    ------
    ShapeError
        If an array has the wrong shape, or the covariance a negative variance.
    TooFewPosesError, DegenerateGeometryError
        If the lines do not determine a point.

    References
    ----------
    GUM (JCGM 100:2008), 5.1.3 (numerical sensitivities), 5.2 (correlated inputs) and annex G.
    """
    size = len(rig.parameter_names)
    covariance = checked(rig_covariance, (size, size), "rig_covariance")
    points = thinned_points(edges, [camera.name for camera in rig.cameras])
    lines = lines_of(points, rig)
    rcm = least_squares_rcm(*lines)
    told = scatter(rcm, *lines)
    root = square_root(covariance)
    carried = Carried.by(points, rig, np.sqrt(covariance.diagonal()))
    jacobian = jacobian_by_differences(
        lambda independent: _location_max_rms(*carried.lines(root @ independent)),
        np.zeros(root.shape[1]),
        np.ones(root.shape[1]),
    )
    moved = displacements_of(points, rig, rcm.point_mm)
    shading = common_location(lines[1], moved)
    return _combined(told, jacobian @ jacobian.T, shading @ shading.T, coverage)


def common_location(directions: Floats, displacements_mm: Floats) -> Floats:
    """Return what displacements of all lines do to the least-squares point, N⁻¹ Σ Pᵢ Dᵢ.

    Parameters
    ----------
    directions
        Of the lines, unit length, shape (n, 3).
    displacements_mm
        By one standard uncertainty of each of r sources, shape (n, 3, r), mm.

    Returns
    -------
    numpy.ndarray
        Shape (3, r), mm.
    """
    across = projectors(directions)
    return np.asarray(np.linalg.solve(across.sum(axis=0), (across @ displacements_mm).sum(axis=0)))


def calibration_displacements(
    edges: Sequence[Sequence[EdgePoints]],
    rig: Rig,
    rig_covariance: ArrayLike,
    point_mm: ArrayLike,
    *,
    of_misses: bool = True,
) -> Floats:
    """Return how far the calibration's uncertainty moves each line near a point.

    Parameters
    ----------
    edges, rig, rig_covariance
        As in `location_uncertainty`.
    point_mm
        Where the lines pass, shape (3,), mm: the RCM.
    of_misses
        Whether what the lines miss the point by is displaced, too: a calibration whose unit of
        length is wrong scales it. An estimate *from* the misses must do without: it would find the
        unit of length that makes them small.

    Returns
    -------
    numpy.ndarray
        Shape (n, 3, r), mm: displacement of the foot of the perpendicular from the point on each
        line, for one standard uncertainty of each of the r independent directions of the rig's
        covariance.
    """
    size = len(rig.parameter_names)
    covariance = checked(rig_covariance, (size, size), "rig_covariance")
    root = square_root(covariance)
    points = thinned_points(edges, [camera.name for camera in rig.cameras])
    at = checked(point_mm, (3,), "point_mm")
    if not of_misses:
        points = passing_through(points, rig, at)
    carried = Carried.by(points, rig, np.sqrt(covariance.diagonal()))

    def feet(independent: Floats) -> Floats:
        return feet_of(*carried.lines(root @ independent), at).ravel()

    jacobian = jacobian_by_differences(feet, np.zeros(root.shape[1]), np.ones(root.shape[1]))
    return jacobian.reshape(len(edges), 3, root.shape[1])


def jacobian_by_differences(
    function: Callable[[Floats], Floats], parameters: ArrayLike, steps: ArrayLike
) -> Floats:
    """Return ∂function/∂parameters by central differences, shape (outputs, d).

    Parameters
    ----------
    function
        Maps parameters of shape (d,) to outputs of shape (outputs,).
    parameters
        Where to differentiate, shape (d,).
    steps
        Half the distance between the two evaluations of each parameter, shape (d,). A parameter
        with step 0 is known: its column is zero.

    Examples
    --------
    >>> jacobian_by_differences(lambda x: np.array([x[0] * x[1], x[1]]), [2.0, 3.0], [0.1, 0.1])
    array([[3., 2.],
           [0., 1.]])
    """
    at = checked(parameters, (None,), "parameters")
    widths = checked(steps, (len(at),), "steps")
    columns = []
    for index in np.flatnonzero(widths):
        step = np.zeros_like(at)
        step[index] = widths[index]
        columns.append((function(at + step) - function(at - step)) / (2 * widths[index]))
    outputs = len(columns[0]) if columns else len(function(at))
    jacobian = np.zeros((outputs, len(at)))
    jacobian[:, np.flatnonzero(widths)] = np.reshape(columns, (-1, outputs)).T
    return jacobian


def _combined(
    told: Scatter, calibration: Floats, shading: Floats, coverage: float
) -> LocationUncertainty:
    """Add the parts; `calibration` is the covariance of (x, y, z, max, rms), shape (5, 5)."""
    lines, location = told.covariance_mm2, (calibration[:3, :3] + calibration[:3, :3].T) / 2
    total = lines + location + shading
    degrees = fewest_degrees_of_freedom(
        [lines, location + shading], [told.degrees_of_freedom, np.inf]
    )
    factor = coverage_factor(degrees, coverage=coverage)
    return LocationUncertainty(
        lines_mm2=lines,
        calibration_mm2=location,
        total_mm2=total,
        degrees_of_freedom=degrees,
        coverage=coverage,
        coverage_factor=factor,
        expanded_mm=factor * np.sqrt(total.diagonal()),
        max_calibration_u_mm=float(np.sqrt(calibration[3, 3])),
        rms_calibration_u_mm=float(np.sqrt(calibration[4, 4])),
        independent_poses=told.independent_poses,
        shading_mm2=shading,
    )


def _location_max_rms(points_mm: Floats, directions: Floats) -> Floats:
    """Return the location of the RCM, its largest and its rms distance, shape (5,), mm."""
    rcm = least_squares_rcm(points_mm, directions)
    return np.array([*rcm.point_mm, rcm.max_mm, rcm.rms_mm])


def square_root(covariance: Floats) -> Floats:
    """Return a matrix with root @ root.T = covariance, shape (d, r), r the rank.

    The correlations are decomposed, not the covariance, so that units do not matter.
    """
    sigma = np.sqrt(np.maximum(covariance.diagonal(), 0))
    inverse = np.divide(1, sigma, out=np.zeros_like(sigma), where=sigma > 0)
    values, vectors = np.linalg.eigh(inverse[:, None] * covariance * inverse)
    least = min(float(values[0]), float(np.sign(covariance.diagonal().min())))
    if least < -LEAST_CORRELATION:
        raise ShapeError(
            f"rig_covariance is not a covariance: a variance is negative ({least:.1e} of the rest)",
            next_step="pass the covariance that the calibration returned",
        )
    kept = values > LEAST_CORRELATION
    root: Floats = sigma[:, None] * vectors[:, kept] * np.sqrt(values[kept])
    return root
