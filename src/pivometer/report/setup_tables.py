"""The tables of the calibration and of the set-up."""

from collections.abc import Mapping

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration.board import Board
from pivometer.calibration.result import Calibration
from pivometer.cameras.rig import Rig
from pivometer.measurement import Measurement
from pivometer.report.digits import error_decimals, fixed, with_uncertainty
from pivometer.report.tables import Table

_PINHOLE = (
    "focal length f·s_x, px",
    "focal length f·s_y, px",
    "principal point o_x, px",
    "principal point o_y, px",
)
_LENS = ("k₁ = β₁", "k₂ = β₂", "p₁", "p₂", "k₃", "k₄", "k₅", "k₆")


def parameter_rows(calibration: Calibration) -> tuple[tuple[str, ...], ...]:
    """Return a row for each intrinsic parameter, value ± standard uncertainty of each camera."""
    quality = {camera.name: camera for camera in calibration.cameras}
    rows = []
    for i, name in enumerate((*_PINHOLE, *(f"distortion {lens}" for lens in _LENS))):
        cells = [
            with_uncertainty(
                float(camera.parameters[i]), float(quality[camera.name].parameters_u[i])
            )
            if i < len(camera.parameters)
            else ""
            for camera in calibration.rig.cameras
        ]
        if any(cells):
            rows.append((name, *cells))
    return tuple(rows)


def camera_table(measurement: Measurement) -> Table:
    """Tabulate every camera's parameters with their standard uncertainties, and its fit."""
    calibration = measurement.calibration
    rig = calibration.rig
    quality = {camera.name: camera for camera in calibration.cameras}
    known = [quality[camera.name] for camera in rig.cameras]
    rows = [
        *parameter_rows(calibration),
        ("image size, px", *(f"{camera.width} × {camera.height}" for camera in rig.cameras)),
        ("reprojection rms, px", *(f"{fit.rms_px:.3f}" for fit in known)),
        ("board views used", *(str(fit.view_count) for fit in known)),
        ("corners used", *(str(fit.corner_count) for fit in known)),
        ("part of the image covered", *(f"{100 * fit.filled:.0f} %" for fit in known)),
        ("largest tilt between boards, °", *(f"{fit.tilt_deg:.0f}" for fit in known)),
        (
            "worst view (rms, px)",
            *(f"{fit.worst_view} ({fit.worst_rms_px:.3f})" for fit in known),
        ),
    ]
    return Table(
        "Cameras, value ± standard uncertainty",
        ("", *(camera.name for camera in rig.cameras)),
        tuple(rows),
        f"A corner coordinate scatters by {calibration.noise_px:.3f} px (standard deviation). "
        "Corresponding rays meet after image corrections of "
        f"{calibration.epipolar_rms_px:.3f} px rms.",
    )


def relative_pose_table(measurement: Measurement) -> Table:
    """Tabulate where each further camera stands in the reference camera's frame."""
    calibration = measurement.calibration
    rig = calibration.rig
    spread = np.sqrt(np.maximum(np.diag(calibration.covariance), 0.0))
    columns = [_pose_cells(rig, index, spread) for index in range(1, len(rig.cameras))]
    names = (
        "rotation vector x, °",
        "rotation vector y, °",
        "rotation vector z, °",
        "position x, mm",
        "position y, mm",
        "position z, mm",
        "baseline, mm",
        "angle between optical axes, °",
    )
    rows = tuple((name, *cells) for name, *cells in zip(names, *columns, strict=True))
    return Table(
        f"Relative pose (R, t) in the frame of camera “{rig.reference}”, value ± standard "
        "uncertainty",
        ("", *(camera.name for camera in rig.cameras[1:])),
        rows,
    )


def _pose_cells(rig: Rig, index: int, spread: Floats) -> list[str]:
    """Return the cells of one further camera."""
    transform, name = rig.reference_from_camera[index], rig.cameras[index].name
    at = {key: spread[place] for place, key in enumerate(rig.parameter_names)}
    turn_deg = np.degrees(transform.rotation_vector_rad())
    turn_u = [np.degrees(at[f"{name}.r{axis}_rad"]) for axis in "xyz"]
    place_u = [at[f"{name}.t{axis}_mm"] for axis in "xyz"]
    baseline = float(np.linalg.norm(transform.translation_mm))
    axes_deg = float(np.degrees(np.arccos(np.clip(transform.rotation[2, 2], -1, 1))))
    values = [*zip(turn_deg, turn_u, strict=True)]
    values += [*zip(transform.translation_mm, place_u, strict=True)]
    cells = [with_uncertainty(float(value), float(u)) for value, u in values]
    return [*cells, f"{baseline:.2f}", f"{axes_deg:.2f}"]


def length_table(measurement: Measurement) -> Table:
    """Tabulate the errors of the reconstructed board edges."""
    calibration = measurement.calibration
    routes = (
        ("all pairs (the paper's measure)", calibration.edge_length_error),
        ("held-out pairs", calibration.held_out),
        ("all pairs, the paper's own route", calibration.paper.edge_length_error),
    )
    decimals = error_decimals([error.rms_mm for _, error in routes])
    return Table(
        f"Error of reconstructed board edges of {calibration.board.square_mm:g} mm, mm",
        ("views", "max", "rms", "edges"),
        tuple(
            (name, fixed(error.max_mm, decimals), fixed(error.rms_mm, decimals), str(error.count))
            for name, error in routes
        ),
        "Held-out pairs took no part in the calibration that reconstructs them: theirs is the "
        "figure to trust. The paper's own route is the relative pose by (19)–(20), then the metric "
        f"upgrade (21); its baseline differs by {_baseline_difference_mm(measurement)} mm.",
    )


def _baseline_difference_mm(measurement: Measurement) -> str:
    """Compare the first baseline of the paper's route with the one used."""
    calibration = measurement.calibration
    ours, papers = calibration.rig.baselines_mm[0], calibration.paper.rig.baselines_mm[0]
    return fixed(float(papers - ours), 2)


def view_table(measurement: Measurement) -> Table:
    """Tabulate the board views that were not used, with the reasons."""
    return Table(
        "Board views not used",
        ("view", "camera", "reason"),
        tuple((view.view, view.camera, view.reason) for view in measurement.calibration.rejected),
    )


def setup_table(measurement: Measurement) -> Table:
    """Tabulate what the session says of itself."""
    setup = measurement.setup
    diameter = "not stated" if setup.diameter_mm is None else f"{setup.diameter_mm:g} mm"
    rows = [
        ("session", setup.session),
        ("calibration board", board_text(setup.board)),
        ("shaft diameter, nominal", diameter),
        *_entries("device", setup.device),
        *_entries("operator", setup.operator),
    ]
    return Table("Set-up as the session states it", ("what", "value"), tuple(rows))


def board_text(board: Board) -> str:
    """Describe a board in words.

    Examples
    --------
    >>> board_text(Board("checkerboard", (9, 7), 15.0))
    'checkerboard of 9 × 7 squares of 15 mm (uncertainty of the square not stated)'
    """
    across, down = board.squares
    square = f"{board.square_mm:g} mm (uncertainty of the square not stated)"
    if board.square_u_mm is not None:
        square = f"({with_uncertainty(board.square_mm, board.square_u_mm)}) mm"
    text = f"{board.kind} of {across} × {down} squares of {square}"
    if board.marker_mm is not None:
        text += f", markers {board.dictionary} of {board.marker_mm:g} mm"
    return text


def _entries(name: str, values: Mapping[str, object]) -> list[tuple[str, str]]:
    """Flatten a free-form table of ``session.toml`` into rows."""
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            rows += _entries(f"{name}, {key}", value)
        else:
            rows.append((f"{name}, {key}", str(value)))
    return rows
