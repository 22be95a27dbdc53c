"""The tables of the calibration and of the set-up."""

from collections.abc import Mapping
from datetime import datetime

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration.board import Board
from pivometer.calibration.result import Calibration
from pivometer.cameras.rig import Rig
from pivometer.measurement import ImportedRig, Measurement, Options
from pivometer.report.digits import error_decimals, fixed, with_uncertainty
from pivometer.report.tables import Table

_PINHOLE = (
    "focal length f·s_x, px",
    "focal length f·s_y, px",
    "principal point o_x, px",
    "principal point o_y, px",
)
_LENS = ("k₁ = β₁", "k₂ = β₂", "p₁", "p₂", "k₃", "k₄", "k₅", "k₆")


def parameter_rows(calibration: Calibration | ImportedRig) -> tuple[tuple[str, ...], ...]:
    """Return a row for each intrinsic parameter, value ± standard uncertainty of each camera.

    An imported rig has no uncertainties: its values are given as they are.
    """
    known = () if isinstance(calibration, ImportedRig) else calibration.cameras
    u = {camera.name: camera.parameters_u for camera in known}
    rows = []
    for i, name in enumerate((*_PINHOLE, *(f"distortion {lens}" for lens in _LENS))):
        cells = [
            _stated(camera.parameters[i], None if camera.name not in u else u[camera.name][i])
            if i < len(camera.parameters)
            else ""
            for camera in calibration.rig.cameras
        ]
        if any(cells):
            rows.append((name, *cells))
    return tuple(rows)


def _stated(value: float, u: float | None) -> str:
    """Return a value with its standard uncertainty, or as it is where that is unknown."""
    return f"{float(value):.7g}" if u is None else with_uncertainty(float(value), float(u))


def camera_table(measurement: Measurement) -> Table:
    """Tabulate every camera's parameters with their standard uncertainties, and its fit."""
    calibration = measurement.calibration
    rig = calibration.rig
    size_row = ("image size, px", *(f"{camera.width} × {camera.height}" for camera in rig.cameras))
    if isinstance(calibration, ImportedRig):
        return Table(
            "Cameras, imported; their uncertainty is unknown",
            ("", *(camera.name for camera in rig.cameras)),
            (*parameter_rows(calibration), size_row),
            f"Read from {calibration.file_format} files: {', '.join(calibration.inputs)}.",
        )
    quality = {camera.name: camera for camera in calibration.cameras}
    known = [quality[camera.name] for camera in rig.cameras]
    rows = [
        *parameter_rows(calibration),
        size_row,
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
    spread = None
    if isinstance(calibration, Calibration):
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
        f"Relative pose (R, t) in the frame of camera “{rig.reference}”"
        + ("" if spread is None else ", value ± standard uncertainty"),
        ("", *(camera.name for camera in rig.cameras[1:])),
        rows,
    )


def _pose_cells(rig: Rig, index: int, spread: Floats | None) -> list[str]:
    """Return the cells of one further camera."""
    transform, name = rig.reference_from_camera[index], rig.cameras[index].name
    turn_deg = np.degrees(transform.rotation_vector_rad())
    turn_u: list[float | None] = [None] * 3
    place_u: list[float | None] = [None] * 3
    if spread is not None:
        at = {key: float(spread[place]) for place, key in enumerate(rig.parameter_names)}
        turn_u = [float(np.degrees(at[f"{name}.r{axis}_rad"])) for axis in "xyz"]
        place_u = [at[f"{name}.t{axis}_mm"] for axis in "xyz"]
    baseline = float(np.linalg.norm(transform.translation_mm))
    axes_deg = float(np.degrees(np.arccos(np.clip(transform.rotation[2, 2], -1, 1))))
    values = [*turn_deg, *transform.translation_mm]
    cells = [_stated(value, u) for value, u in zip(values, turn_u + place_u, strict=True)]
    return [*cells, f"{baseline:.2f}", f"{axes_deg:.2f}"]


def length_table(calibration: Calibration) -> Table:
    """Tabulate the errors of the reconstructed board edges."""
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
        f"upgrade (21); its baseline differs by {_baseline_difference_mm(calibration)} mm.",
    )


def _baseline_difference_mm(calibration: Calibration) -> str:
    """Compare the first baseline of the paper's route with the one used."""
    ours, papers = calibration.rig.baselines_mm[0], calibration.paper.rig.baselines_mm[0]
    return fixed(float(papers - ours), 2)


def view_table(calibration: Calibration) -> Table:
    """Tabulate the board views that were not used, with the reasons."""
    return Table(
        "Board views not used",
        ("view", "camera", "reason"),
        tuple((view.view, view.camera, view.reason) for view in calibration.rejected),
    )


def setup_table(measurement: Measurement) -> Table:
    """Tabulate what the session says of itself."""
    setup = measurement.setup
    diameter = "not stated" if setup.diameter_mm is None else f"{setup.diameter_mm:g} mm"
    rows = [
        ("session", setup.session),
        ("cameras", _camera_text(measurement.calibration.rig)),
        ("calibration board", board_text(setup.board)),
        ("shaft diameter, nominal", diameter),
        *_entries("device", setup.device),
        *_entries("operator", setup.operator),
    ]
    return Table("Set-up as the session states it", ("what", "value"), tuple(rows))


def provenance_table(measurement: Measurement, seal: str) -> Table:
    """Tabulate how and when a measurement was made, with the SHA-256 of its result."""
    rows = [("SHA-256 of the result", seal)]
    provenance = measurement.provenance
    if provenance is not None:
        rows = [
            ("made", moment_text(measurement)),
            ("command", provenance.command),
            *_options(provenance.options),
            *provenance.versions.items(),
            *rows,
        ]
    return Table("How the result was made", ("what", "value"), tuple(rows))


def _options(options: Options | None) -> list[tuple[str, str]]:
    if options is None:
        return []
    source = "from elsewhere" if options.rig_given else f"{options.method}, {options.distortion}"
    hints = [
        (f"hint, {camera}", f"x {hint.x_px:g}, y {hint.y_px:g} px")
        for camera, hint in options.hints.items()
    ]
    return [("calibration", source), ("centerline", options.centerline), *hints]


def moment_text(measurement: Measurement) -> str:
    """Say when a measurement was made; nothing where that is not recorded."""
    if measurement.provenance is None:
        return ""
    try:
        moment = datetime.fromisoformat(measurement.provenance.created)
    except ValueError:  # a file that someone wrote
        return measurement.provenance.created
    return moment.strftime("%Y-%m-%d %H:%M %Z").strip()


def _camera_text(rig: Rig) -> str:
    """List the cameras, the reference first."""
    sizes = [f"{camera.name} ({camera.width} × {camera.height} px)" for camera in rig.cameras]
    return f"{', '.join(sizes)}; the first is the reference"


def board_text(board: Board) -> str:
    """Describe a board in words.

    Examples
    --------
    >>> board_text(Board("checkerboard", (9, 7), 15.0, square_u_mm=0.01, form="flat"))
    'checkerboard of 9 × 7 squares of (15.000 ± 0.010) mm, taken for flat'
    """
    across, down = board.squares
    square = f"{board.square_mm:g} mm (uncertainty of the square not stated)"
    if board.square_u_mm is not None:
        square = f"({with_uncertainty(board.square_mm, board.square_u_mm)}) mm"
    text = f"{board.kind} of {across} × {down} squares of {square}"
    if board.marker_mm is not None:
        text += f", markers {board.dictionary} of {board.marker_mm:g} mm"
    taken = {"flat": "taken for flat", "bowed": "its bow estimated", "free": "its shape estimated"}
    return f"{text}, {taken[board.form]}"


def _entries(name: str, values: Mapping[str, object]) -> list[tuple[str, str]]:
    """Flatten a free-form table of ``session.toml`` into rows."""
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            rows += _entries(f"{name}, {key}", value)
        else:
            rows.append((f"{name}, {key}", str(value)))
    return rows
