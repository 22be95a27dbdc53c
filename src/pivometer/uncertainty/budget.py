"""Which source makes the result uncertain by how much, and what to do about the largest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.uncertainty.intrinsic import NoiseEffect, noise_effects
from pivometer.uncertainty.line_errors import LineErrors, Noise

ROBOT = "the robot's own misses"
EDGES = "noise of the shaft's edges"
FLOOR = "the instrument's floor, seen on the gold standard"
SHADING = "light from one side"
CORNERS = "corners of the board views (calibration)"
SQUARES = "size of the board's squares"
REFERENCE = "corners of the reference board"

REMEDIES = {
    ROBOT: "take more poses: what they miss by averages out in the location, as 1/√n",
    EDGES: "more light and contrast, sharper focus, a longer visible shaft, or nearer cameras",
    FLOOR: "find out what the instrument does to a perfect joint: light, background, focus, lenses",
    SHADING: "light the shaft from both sides, or evenly from all",
    CORNERS: "more board views, tilted and into the corners of the pictures; or fix a board near "
    "the RCM (reference/), in whose frame most of this drops out",
    SQUARES: "measure the board over many squares with a better scale, and state square_u_mm",
    REFERENCE: "more views of the reference board, nearer and larger in the pictures",
}


@dataclass(frozen=True, slots=True, eq=False)
class BudgetSource:
    """One independent source of uncertainty, and what it contributes; squares add up.

    Parameters
    ----------
    name
        What it is.
    location_u_mm
        Standard uncertainty of the least-squares point from it, along x, y and z of the reference
        camera, shape (3,), mm.
    board_u_mm
        The same in the frame of the reference board; `None` without one.
    rms_mm
        Rms miss that a perfect robot would show because of it, mm; zero where it moves all lines
        alike, and for the robot's own misses.
    max_u_mm
        Standard uncertainty of the largest miss from it, mm, to first order.
    """

    name: str
    location_u_mm: Floats
    board_u_mm: Floats | None
    rms_mm: float
    max_u_mm: float

    def __post_init__(self) -> None:
        at = read_only(checked(self.location_u_mm, (3,), "location_u_mm"))
        object.__setattr__(self, "location_u_mm", at)
        if self.board_u_mm is not None:
            object.__setattr__(
                self, "board_u_mm", read_only(checked(self.board_u_mm, (3,), "board_u_mm"))
            )


@dataclass(frozen=True, slots=True, eq=False)
class UncertaintyBudget:
    """All sources, and the largest.

    Parameters
    ----------
    sources
        The sources, independent of each other.
    largest_in_location
        The source that makes the location most uncertain, in the board's frame where there is one.
    largest_in_error
        The source that lies most in what is seen of the robot's error.
    advice
        What to do about them, a sentence each.
    """

    sources: tuple[BudgetSource, ...]
    largest_in_location: str
    largest_in_error: str
    advice: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class LocationParts:
    """The location in one frame, and the independent parts of its covariance.

    Parameters
    ----------
    point_mm
        The least-squares point, shape (3,), mm.
    lines_mm2, calibration_mm2, shading_mm2, board_mm2
        As in `BoardFrameUncertainty`, shape (3, 3), mm²; the last is zero in a camera's frame.
    turn
        Rotation from the reference camera's frame into this one, shape (3, 3).
    """

    point_mm: Floats
    lines_mm2: Floats
    calibration_mm2: Floats
    shading_mm2: Floats
    board_mm2: Floats
    turn: Floats


def uncertainty_budget(
    points_mm: ArrayLike,
    errors: LineErrors,
    camera: LocationParts,
    board: LocationParts | None = None,
    *,
    squares_relative: float,
) -> UncertaintyBudget:
    """Return what each source contributes to location, rms and max.

    The scatter of the lines holds the noise of the edges, the floor and the robot's own misses;
    the first two are known, and the rest is the robot's. The calibration's covariance holds the
    corners and one scale, that of the squares.

    Parameters
    ----------
    points_mm
        A point on each line, shape (n, 3), mm, reference camera's frame.
    errors
        What the instrument does to the lines.
    camera, board
        The location in the reference camera's frame and, where there is one, in the board's.
    squares_relative
        Relative standard uncertainty of the size of a square; 0 where none is stated.

    References
    ----------
    GUM (JCGM 100:2008), 5.1 and H.1 (the budget as a table).
    """
    none, nothing = np.zeros_like(errors.edges_mm2), errors.calibration_mm[..., :0]
    noises = {
        EDGES: Noise(errors.edges_mm2, nothing),
        FLOOR: Noise(errors.floor_mm2[0] * errors.across(), nothing),
        SHADING: Noise(none, errors.shading_mm),
        CORNERS: Noise(none, errors.calibration_mm),
    }
    own = {name: errors.location_mm2(noises[name].alone_mm2) for name in (EDGES, FLOOR)}
    in_camera = _by_source(camera, own, squares_relative)
    in_board = None if board is None else _by_source(board, own, squares_relative)
    found = noise_effects(points_mm, errors.directions, list(noises.values()))
    effects = dict(zip(noises, found, strict=True))
    sources = []
    for name, covariance in in_camera.items():
        effect = effects.get(name, NoiseEffect(0.0, 0.0))
        sources.append(
            BudgetSource(
                name,
                _deviations(covariance),
                None if in_board is None else _deviations(in_board[name]),
                float(np.sqrt(max(effect.squares_mm2, 0.0) / len(errors.directions))),
                effect.max_u_mm,
            )
        )
    return _told([one for one in sources if _counts(one)])


def _by_source(
    parts: LocationParts, own: dict[str, Floats], squares_relative: float
) -> dict[str, Floats]:
    """Return the covariance of the location from each source, shape (3, 3), mm²."""
    known = {name: parts.turn @ part @ parts.turn.T for name, part in own.items()}
    scaled = squares_relative * parts.point_mm
    squares = np.outer(scaled, scaled)
    return {
        ROBOT: _rest(parts.lines_mm2, *known.values()),
        **known,
        SHADING: parts.shading_mm2,
        CORNERS: _rest(parts.calibration_mm2, squares),
        SQUARES: squares,
        REFERENCE: parts.board_mm2,
    }


def _rest(whole: Floats, *parts: Floats) -> Floats:
    """Return what is left of a covariance without known parts; no variance is negative."""
    values, vectors = np.linalg.eigh(whole - sum(parts))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _deviations(covariance: Floats) -> Floats:
    return np.asarray(np.sqrt(np.maximum(covariance.diagonal(), 0.0)))


def _counts(source: BudgetSource) -> bool:
    board = 0.0 if source.board_u_mm is None else float(source.board_u_mm.max())
    return max(float(source.location_u_mm.max()), board, source.rms_mm) > 0


def _told(sources: Sequence[BudgetSource]) -> UncertaintyBudget:
    def in_location(source: BudgetSource) -> float:
        u = source.location_u_mm if source.board_u_mm is None else source.board_u_mm
        return float(u @ u)

    location = max(sources, key=in_location).name
    error = max(sources, key=lambda one: one.rms_mm).name
    return UncertaintyBudget(
        tuple(sources),
        location,
        error,
        (
            f"what makes the location most uncertain is {location}: {REMEDIES[location]}",
            f"what the instrument adds most to the misses is {error}: {REMEDIES[error]}",
        ),
    )
