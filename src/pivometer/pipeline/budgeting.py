"""The uncertainty budget of a measurement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pivometer.measurement import BoardFrame, Measurement
from pivometer.pipeline.line_errors import line_points
from pivometer.uncertainty import LineErrors, LocationUncertainty
from pivometer.uncertainty.budget import LocationParts, uncertainty_budget


def with_budget(measurement: Measurement, errors: LineErrors) -> Measurement:
    """Return a measurement that states what each source contributes, if all are known."""
    u, board = measurement.uncertainty, measurement.setup.board
    if not isinstance(u, LocationUncertainty) or not errors.edges_mm2.any():
        return measurement
    camera = LocationParts(
        measurement.rcm.least_squares.point_mm,
        u.lines_mm2,
        u.calibration_mm2,
        u.shading_mm2,
        np.zeros((3, 3)),
        np.eye(3),
    )
    budget = uncertainty_budget(
        line_points(measurement),
        errors,
        camera,
        None if measurement.board_frame is None else _in_board(measurement.board_frame),
        squares_relative=(board.square_u_mm or 0.0) / board.square_mm,
    )
    return replace(measurement, budget=budget)


def _in_board(frame: BoardFrame) -> LocationParts:
    u = frame.uncertainty
    return LocationParts(
        frame.least_squares_point_mm,
        u.lines_mm2,
        u.calibration_mm2,
        u.shading_mm2,
        u.board_mm2,
        frame.reference_from_board.rotation.T,
    )
