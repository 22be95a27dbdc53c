"""The measurement once more, in the frame of a board that stands still near the RCM."""

from __future__ import annotations

from dataclasses import replace

from pivometer.calibration import BoardView, Calibration, RejectedView
from pivometer.calibration.frame import FixedBoard, fixed_board
from pivometer.errors import CalibrationError
from pivometer.io.session import Session
from pivometer.measurement import BoardCenterline, BoardFrame, ImportedRig, Measurement
from pivometer.pipeline.calibrating import corners
from pivometer.pipeline.reading import Progress, hashes, in_threads, read
from pivometer.rcm import Finding
from pivometer.uncertainty.frame import board_frame_uncertainty


def with_board_frame(
    measurement: Measurement, session: Session, progress: Progress | None = None
) -> Measurement:
    """Add the result in the frame of the board under ``reference/``, where there is one.

    A board that moved, or that the cameras do not agree on, gives no frame: a finding says so,
    with the names of the views, and the result in the camera's frame stands.
    """
    files = list(session.fixed_board_images("reference"))
    if not files:
        return measurement
    calibration = measurement.calibration
    if isinstance(calibration, ImportedRig):
        finding = Finding(
            "warning",
            "no result in the reference board's frame: the rig was imported without its "
            "uncertainty and noise, which the pose of that board rests on",
            "calibrate with board images of this session",
        )
        return replace(measurement, findings=(*measurement.findings, finding))
    reads = in_threads(read, files, "reading the reference board", progress)
    sizes = {camera.name: (camera.width, camera.height) for camera in calibration.rig.cameras}
    found = in_threads(
        lambda one: corners(one, session, sizes[one.file.camera]),
        reads,
        "finding the reference board",
        progress,
    )
    measurement = replace(measurement, inputs={**measurement.inputs, **hashes(reads)})
    views = [view for view in found if isinstance(view, BoardView)]
    missing = tuple(view for view in found if isinstance(view, RejectedView))
    try:
        fixed = fixed_board(views, session.board, calibration.rig, noise_px=calibration.noise_px)
    except CalibrationError as error:
        why = "".join(f"; {one.view}, {one.camera}: {one.reason}" for one in missing[:3])
        finding = Finding(
            "warning",
            f"no result in the reference board's frame: {error.what}{why}",
            error.next_step,
        )
        return replace(measurement, findings=(*measurement.findings, finding))
    frame = _board_frame(measurement, calibration, fixed, missing)
    return replace(measurement, board_frame=frame)


def _board_frame(
    measurement: Measurement,
    calibration: Calibration,
    fixed: FixedBoard,
    missing: tuple[RejectedView, ...],
) -> BoardFrame:
    rcm = measurement.rcm
    board_from_reference = fixed.reference_from_board.inverse()
    uncertainty, covariance = board_frame_uncertainty(
        [pose.edges for pose in measurement.used],
        calibration.rig,
        calibration.covariance,
        fixed,
        calibration.board,
    )
    return BoardFrame(
        reference_from_board=fixed.reference_from_board,
        covariance=covariance,
        minimax_point_mm=board_from_reference @ rcm.minimax.point_mm,
        least_squares_point_mm=board_from_reference @ rcm.least_squares.point_mm,
        uncertainty=uncertainty,
        centerlines=tuple(
            BoardCenterline(
                pose.pose,
                board_from_reference @ pose.centerline.point_mm,
                board_from_reference.rotate(pose.centerline.direction),
            )
            for pose in measurement.used
        ),
        views=fixed.views,
        rejected=missing,
        rms_px=fixed.rms_px,
        note=fixed.note,
    )
