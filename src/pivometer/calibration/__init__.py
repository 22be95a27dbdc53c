"""From views of a board to a calibrated rig."""

from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.corners import find_corners
from pivometer.calibration.procedure import calibrate_rig
from pivometer.calibration.result import Calibration, RejectedView

__all__ = ["Board", "BoardView", "Calibration", "RejectedView", "calibrate_rig", "find_corners"]
