"""What a calibration says: the rig, how far it can be trusted, and what it rests on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pivometer._arrays import Floats, checked, read_only
from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.board_shape import BoardShape
from pivometer.calibration.response import CameraResponse
from pivometer.cameras import Rig


@dataclass(frozen=True, slots=True, eq=False)
class LengthError:
    """Error of reconstructed board edges, mm: the first column of the paper's Table I.

    Parameters
    ----------
    max_mm, rms_mm
        Largest and root-mean-square difference from the known edge length, mm.
    count
        Number of edges.
    """

    max_mm: float
    rms_mm: float
    count: int


@dataclass(frozen=True, slots=True, eq=False)
class RejectedView:
    """A board view that does not count, and why."""

    camera: str
    view: str
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class CameraQuality:
    """How well one camera is calibrated.

    Parameters
    ----------
    name
        The camera.
    rms_px
        Root-mean-square distance between corners found and projected, px.
    view_count, corner_count
        What the calibration rests on.
    parameters_u
        Standard uncertainties of ``camera.parameters``, shape (4+m,).
    filled
        Fraction of the image, by cells of an 8×6 grid, in which corners were found.
    tilt_deg
        Largest angle between two board normals, deg: what determines the focal length.
    worst_view
        The view that fits worst.
    worst_rms_px
        Its root-mean-square distance, px.
    response
        How linearly it records light, as the board's edges tell; `None` where they do not.
    """

    name: str
    rms_px: float
    view_count: int
    corner_count: int
    parameters_u: Floats
    filled: float
    tilt_deg: float
    worst_view: str
    worst_rms_px: float
    response: CameraResponse | None = None

    def __post_init__(self) -> None:
        values = read_only(checked(self.parameters_u, (None,), "parameters_u"))
        object.__setattr__(self, "parameters_u", values)


@dataclass(frozen=True, slots=True, eq=False)
class PaperRoute:
    """The paper's two steps: relative pose by (19)–(20), then metric upgrade by (21).

    Parameters
    ----------
    rig
        Its rig.
    edge_length_error
        Error of all edges of all pairs with it.
    epipolar_rms_px
        Root-mean-square correction √(‖w₁‖² + ‖w₂‖²) of (19) per correspondence, px.
    """

    rig: Rig
    edge_length_error: LengthError
    epipolar_rms_px: float


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """A calibrated rig with its quality and the observations behind it.

    Parameters
    ----------
    rig
        The cameras and their poses, the reference first.
    covariance
        Covariance of the rig's parameters in the order of ``rig.parameter_names``, shape (d, d).
    edge_length_error
        Error of all board edges reconstructed from all pairs: Table I, first column.
    held_out
        The same for pairs that the rig was not estimated from.
    cameras
        Quality of each camera, in the rig's order.
    epipolar_rms_px
        Root-mean-square correction of (19) that makes corresponding rays meet, per correspondence,
        px; equals the noise of one corner coordinate where nothing else is wrong.
    board
        The board.
    views
        The views used, their corners numbered alike in all cameras.
    rejected
        The views not used, with the reason.
    notes
        Plain-word remarks and warnings.
    method
        ``"joint"`` or ``"paper"``.
    paper
        What the paper's route gives on the same views.
    noise_px
        Standard deviation of one corner coordinate, from the residuals, px.
    inputs
        SHA-256 of every board image read, by its path inside the session.
    board_shape
        The board as the joint adjustment estimated it; `None` where it was taken for flat.
    """

    rig: Rig
    covariance: Floats
    edge_length_error: LengthError
    held_out: LengthError
    cameras: tuple[CameraQuality, ...]
    epipolar_rms_px: float
    board: Board
    views: tuple[BoardView, ...]
    rejected: tuple[RejectedView, ...]
    notes: tuple[str, ...]
    method: str
    paper: PaperRoute
    noise_px: float
    inputs: Mapping[str, str] = field(default_factory=dict)
    board_shape: BoardShape | None = None

    def __post_init__(self) -> None:
        size = len(self.rig.parameter_names)
        values = read_only(checked(self.covariance, (size, size), "covariance"))
        object.__setattr__(self, "covariance", values)
