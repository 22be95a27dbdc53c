"""Whether edges, cameras and one cylinder of one radius fit together; and the shaft's diameter.

What the axes leave over is held against what the noise of the edges, shading and the calibration's
covariance explain together. Three things can be wrong, and they look different:

- the edges of one pose: its remainder is too large, beside the other poses';
- the cameras' poses or lenses: remainders lie where moves of the cameras would bring them;
- a camera that moved between two poses: the same, from one pose on.

A statement is made where chance alone would bring it once in ten thousand sessions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.cameras.rig import Rig
from pivometer.shaft.cylinder_fit import CylinderFits
from pivometer.uncertainty.coverage import COVERAGE, coverage_factor
from pivometer.uncertainty.remainders import FittedEdges, Remainders, remainders

CHANCE = 1e-4
"""How often chance may bring each of the three statements in a session."""

LEAST_POSES = 5
"""Poses from which remainders are judged: fewer do not tell a common cause from noise."""

MEDIAN_EFFICIENCY = 0.6
"""The median of χ² with 4 degrees of freedom tells a scale as well as 0.6 times as many values'
mean; with 8 and more, 0.64."""

LARGEST_SCATTER = 1e3
UNKNOWN = 1e4
"""What is known of a move that only has to be allowed for, in standard uncertainties."""

LEAST_CORRELATION = 1e-9
"""Moves that differ by less than this in what they do to the edges count as one."""


@dataclass(frozen=True, slots=True, eq=False)
class MoveTest:
    """Whether cameras stand, or stood from some pose on, elsewhere than the calibration says.

    Parameters
    ----------
    camera
        The camera that moved; empty where that cannot be told, as of two.
    pose
        Number of the pose from which on it moved, from 0.
    chi_square
        How much the move lessens the squared remainders, over what chance would.
    limit
        What chance exceeds once in ten thousand sessions.
    """

    camera: str
    pose: int
    chi_square: float
    limit: float

    @property
    def significant(self) -> bool:
        """Whether chance is no explanation."""
        return self.chi_square > self.limit


@dataclass(frozen=True, slots=True, eq=False)
class ShaftDiameter:
    """The shaft's diameter, measured by all edges of all poses and cameras.

    Parameters
    ----------
    value_mm
        The diameter, mm.
    u_mm
        Its standard uncertainty, mm: the three parts combined.
    edges_u_mm, shading_u_mm, calibration_u_mm
        From the edges' noise, from what shading does alike in all poses, and from the calibration,
        mm. The size of a square of the board, as stated, is not in it: that is what it checks.
    coverage_factor, expanded_mm
        k for 95 % coverage, and U = k u, mm.
    """

    value_mm: float
    u_mm: float
    edges_u_mm: float
    shading_u_mm: float
    calibration_u_mm: float
    coverage_factor: float
    expanded_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class ShaftCheck:
    """How well edges, cameras and one cylinder fit together.

    Parameters
    ----------
    fits
        The maximum-likelihood cylinders, of one common radius.
    diameter
        The shaft's diameter.
    scatter
        By how many times the remainders of half of the poses exceed what is stated for them; at
        least 1. All that follows counts with uncertainties that many times as large.
    chi_squares
        Each pose's squared remainder, over what noise, shading and the calibration explain, (n,).
    limits
        What chance exceeds in one pose of ten thousand sessions, shape (n,).
    moved
        Whether cameras stood elsewhere than the calibration says, all through the session.
    change
        Whether a camera moved between two poses.
    """

    fits: CylinderFits
    diameter: ShaftDiameter
    scatter: float
    chi_squares: Floats
    limits: Floats
    moved: MoveTest
    change: MoveTest

    def __post_init__(self) -> None:
        for name in ("chi_squares", "limits"):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), (None,), name)))


def check_shaft(
    edges: Sequence[Sequence[FittedEdges]],
    rig: Rig,
    rig_covariance: ArrayLike | None,
    *,
    outward_px: Sequence[float] | None = None,
    chance: float = CHANCE,
) -> ShaftCheck:
    """Fit one cylinder to each pose, all of one radius, and judge what is left over.

    Parameters
    ----------
    edges
        For each pose, the edges that two cameras of the rig or more saw, in the session's order.
    rig
        The calibrated cameras.
    rig_covariance
        Covariance of the entries of `rig.parameter_names`, shape (d, d); `None` if unknown.
    outward_px
        By how much each camera's response may have moved both edges of the shaft outward or inward,
        px, as a standard uncertainty; nothing where none is given.
    chance
        How often chance may bring each of the three statements.

    Raises
    ------
    ShapeError, DegenerateGeometryError
        As `fit_cylinders`.
    """
    size = len(rig.parameter_names)
    given = None if rig_covariance is None else checked(rig_covariance, (size, size), "covariance")
    left = remainders(edges, rig, given, outward_px or [0.0] * len(rig.cameras))
    explained = np.concatenate([left.by_shading, left.by_calibration], axis=2)
    still, share = _without_moves(left)
    scatter, chi_squares = _scatter(still, share * left.freedom, explained)
    told = np.inf if scatter == 1.0 else MEDIAN_EFFICIENCY * share * float(left.freedom.sum())
    odds = _Chance(chance, told)
    names = [camera.name for camera in rig.cameras]
    moved, change = _move_tests(left, explained, scatter, names, odds)
    tries = len(chi_squares)
    return ShaftCheck(
        fits=left.fits,
        diameter=_diameter(left, scatter),
        scatter=scatter,
        chi_squares=chi_squares,
        limits=np.array([odds.limit(f, tries=tries) for f in left.freedom]),
        moved=moved,
        change=change,
    )


@dataclass(frozen=True, slots=True)
class _Chance:
    """How often chance may exceed a limit, with a scale that `known` degrees of freedom tell.

    They are endless where the scale is the stated one.
    """

    probability: float
    known: float

    def limit(self, freedom: float, *, tries: int = 1) -> float:
        """Return the χ² that chance exceeds; zero where there is nothing that could be seen."""
        from scipy.special import fdtri, gammaincinv

        if freedom < 1:
            return 0.0
        if np.isinf(self.known):
            return float(2 * gammaincinv(freedom / 2, 1 - self.probability / tries))
        return float(freedom * fdtri(freedom, self.known, 1 - self.probability / tries))


def _without_moves(left: Remainders) -> tuple[Floats, float]:
    """Return the remainders less what moves of the cameras explain, and the share that is left.

    A moved camera must not pass for noise, nor make every pose look wrong.
    """
    n, rows = left.values.shape
    moves = left.by_moves[:, :, 1:].reshape(n * rows, -1)
    scale = np.sqrt(np.square(moves).sum(axis=0))
    vectors, values, _ = np.linalg.svd(moves / np.where(scale > 0, scale, 1.0), full_matrices=False)
    told = vectors[:, values > np.sqrt(LEAST_CORRELATION)]
    flat = left.values.ravel()
    total = float(left.freedom.sum())
    share = max(total - told.shape[1], 1.0) / total
    return (flat - told @ (told.T @ flat)).reshape(n, rows), share


def _scatter(values: Floats, freedom: Floats, explained: Floats) -> tuple[float, Floats]:
    """Return the factor that makes half of the poses' χ² what it should be, and all χ² with it."""
    from scipy.special import gammaincinv

    middle = 2 * gammaincinv(freedom / 2, 0.5)
    low, high = 1.0, LARGEST_SCATTER
    squares = _chi_squares(values, explained, low)
    if np.median(squares / middle) <= 1:
        return low, squares
    while high / low > 1 + 1e-6:
        tried = float(np.sqrt(low * high))
        over = np.median(_chi_squares(values, explained, tried) / middle) > 1
        low, high = (tried, high) if over else (low, tried)
    return low, _chi_squares(values, explained, low)


def _chi_squares(values: Floats, explained: Floats, scatter: float) -> Floats:
    """Return each pose's χ² under s² I + A Aᵀ, by the inverse of the small matrix s² I + Aᵀ A."""
    transposed = np.swapaxes(explained, 1, 2)
    inner = scatter**2 * np.eye(explained.shape[2]) + transposed @ explained
    pulled = transposed @ values[..., None]
    taken = np.swapaxes(pulled, 1, 2) @ np.linalg.solve(inner, pulled)
    total: Floats = (np.square(values).sum(axis=1) - taken[:, 0, 0]) / scatter**2
    return total


def _diameter(left: Remainders, scatter: float) -> ShaftDiameter:
    """Return twice the common radius; its weights say what each cause does to it."""
    weights = left.by_radius / np.square(left.by_radius).sum()
    noise = 2 * scatter * float(np.sqrt(np.square(weights).sum()))
    shading, calibration = (
        2 * float(np.linalg.norm(np.einsum("na,nac->c", weights, cause)))
        for cause in (left.by_shading, left.by_calibration)
    )
    factor = coverage_factor(np.inf, coverage=COVERAGE)
    u = float(np.linalg.norm([noise, shading, calibration]))
    value = 2 * float(left.fits.radii_mm[0])
    return ShaftDiameter(value, u, noise, shading, calibration, factor, factor * u)


class _Moves:
    """Score tests of camera moves beside noise and what else is known to change the remainders."""

    def __init__(self, left: Remainders, moves: Floats, known: Floats, scatter: float) -> None:
        inner = scatter**2 * np.eye(known.shape[2]) + np.einsum("nai,naj->ij", known, known)
        self.inverse = np.linalg.inv(inner)
        self.scatter = scatter
        self.pulled = np.einsum("nai,na->i", known, left.values)
        # Sums over the poses from each one on, the whole session first.
        self.square, self.across, self.along = (
            np.cumsum(each[::-1], axis=0)[::-1]
            for each in (
                np.swapaxes(moves, 1, 2) @ moves,
                np.swapaxes(moves, 1, 2) @ known,
                (np.swapaxes(moves, 1, 2) @ left.values[..., None])[..., 0],
            )
        )

    def gain(self, pose: int, columns: slice) -> tuple[float, int]:
        """Return by how much moves from a pose on lessen χ², and how many of them can be told."""
        across = self.across[pose, columns]
        square = self.square[pose, columns, columns] - across @ self.inverse @ across.T
        pull = self.along[pose, columns] - across @ self.inverse @ self.pulled
        sigma = np.sqrt(np.maximum(square.diagonal(), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(square / np.outer(sigma, sigma))
        told = values > LEAST_CORRELATION
        size = (vectors.T @ (pull / sigma))[told] ** 2 / values[told]
        return float(size.sum()) / self.scatter**2, int(told.sum())


def _move_tests(
    left: Remainders, explained: Floats, scatter: float, names: Sequence[str], chance: _Chance
) -> tuple[MoveTest, MoveTest]:
    """Test moves all through the session, and moves of one camera from any pose on beside those."""
    radius = left.by_radius[..., None] * float(left.fits.radii_mm[0])  # unknown by 100 %
    known = np.concatenate([explained, radius], axis=2)
    n, rows, c, _ = left.by_moves.shape
    moves = left.by_moves.reshape(n, rows, 6 * c)
    size = np.sqrt(np.square(moves).sum(axis=(0, 1)))
    moves = moves / np.where(size > 0, size, 1.0)
    others = slice(6, None)
    gain, rank = _Moves(left, moves, known, scatter).gain(0, others)
    moved = MoveTest("", 0, gain, chance.limit(rank))
    beside = np.concatenate([known, UNKNOWN * scatter * moves[..., others]], axis=2)
    tests = _Moves(left, moves, beside, scatter)
    suspects = range(c) if c > 2 else (1,)  # of two cameras nothing tells which one moved
    tried = [(k, camera) for k in range(2, n - 1) for camera in suspects]
    change = MoveTest("", 0, 0.0, 0.0)
    for pose, camera in tried:
        gain, rank = tests.gain(pose, slice(6 * camera, 6 * camera + 6))
        if gain > change.chi_square:
            limit = chance.limit(rank, tries=len(tried))
            change = MoveTest(names[camera] if c > 2 else "", pose, gain, limit)
    return moved, change
