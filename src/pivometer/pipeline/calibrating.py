"""From a session's board images to its calibrated cameras."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from pivometer.calibration import (
    BoardView,
    Calibration,
    RejectedView,
    calibrate_rig,
    find_corners,
)
from pivometer.calibration.diagnosis import diagnosed, shows_inverted
from pivometer.cameras.distortion import DistortionModel
from pivometer.errors import BoardNotFoundError, CalibrationError, DataError, ImageError
from pivometer.io.session import Session
from pivometer.pipeline.reading import (
    Progress,
    ReadImage,
    hashes,
    in_threads,
    read,
    usable,
    usual_size,
)
from pivometer.pipeline.responding import with_responses

Method = Literal["joint", "paper"]
"""How to calibrate: everything adjusted together, or the paper's two steps."""


def calibrate(
    session: Session,
    *,
    method: Method = "joint",
    distortion: DistortionModel = "radial2",
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a session's cameras from its board views.

    Parameters
    ----------
    session
        What `load` returns.
    method
        ``"joint"`` adjusts all cameras and views together; ``"paper"`` is the paper's two steps,
        (17)–(21).
    distortion
        The distortion model: ``"none"``, ``"radial2"`` (the paper's β₁, β₂), ``"brown5"`` or
        ``"rational8"``.
    progress
        Called as ``progress(stage, done, total)``.

    Returns
    -------
    Calibration
        The rig in the reference camera's frame, its covariance and its quality; the views that were
        rejected, each with its reason.

    Raises
    ------
    CalibrationError
        If the views do not determine the cameras.
    ImageError
        If a camera has no readable image.

    References
    ----------
    Wilson et al., section IV, eqs. (17)–(22).
    """
    session.require("board")
    reads = in_threads(read, list(session.board_images()), "reading boards", progress)
    sizes = {
        name: usual_size(name, [read for read in reads if read.file.camera == name])
        for name in session.cameras
    }
    found = in_threads(
        lambda read: corners(read, session, sizes[read.file.camera]),
        reads,
        "finding boards",
        progress,
    )
    refuse_mirrored_markers(reads, found, session)
    views = [view for view in found if isinstance(view, BoardView)]
    unseen = tuple(view for view in found if isinstance(view, RejectedView))
    try:
        calibration = calibrate_rig(
            views,
            session.board,
            sizes,
            reference=session.reference,
            method=method,
            distortion=distortion,
        )
    except CalibrationError as error:
        if 2 * len(unseen) >= len(found):
            raise _with_reason(error, unseen, len(found)) from error
        raise diagnosed(error, views, session.board, sizes) from error
    calibration = with_responses(calibration, reads, progress)
    return replace(
        calibration,
        rejected=unseen + calibration.rejected,
        notes=calibration.notes + _inverted_note(reads, found, session),
        inputs=hashes(reads),
    )


def corners(read: ReadImage, session: Session, size: tuple[int, int]) -> BoardView | RejectedView:
    """Find the board in an image, or say why it is not there or does not count."""
    if read.file.view in session.excluded:
        reason = f"excluded by hand: {session.excluded[read.file.view]}"
        return RejectedView(read.file.camera, read.file.view, reason)
    try:
        image = usable(read, size)
        return find_corners(image, session.board, camera=read.file.camera, view=read.file.view)
    except DataError as error:
        reason = f"{error.what}; next: {error.next_step}"
        return RejectedView(read.file.camera, read.file.view, reason)


def _with_reason(
    error: CalibrationError, unseen: Sequence[RejectedView], count: int
) -> CalibrationError:
    """Add to a failed calibration why most of its images were thrown out."""
    reasons = Counter(view.reason.removeprefix(f"{view.view}: ") for view in unseen)
    (reason, times), *_ = reasons.most_common(1)
    reason, _, next_step = reason.partition("; next: ")
    what = (
        f"{error.what}; {len(unseen)} of {count} images were thrown out, {times} of them: {reason}"
    )
    return CalibrationError(what, next_step=next_step or error.next_step)


def refuse_mirrored_markers(
    reads: Sequence[ReadImage], found: Sequence[BoardView | RejectedView], session: Session
) -> None:
    """Refuse ChArUco images of a camera that show the board only when mirrored back.

    Markers cannot be read in a mirror, unlike a checkerboard; so where a camera shows no board at
    all, its first images are tried once more.

    Raises
    ------
    CalibrationError
        With the names of the files.
    """
    if session.board.kind != "charuco":
        return
    for camera in session.cameras:
        mine = [
            (one, view) for one, view in zip(reads, found, strict=True) if one.file.camera == camera
        ]
        if any(isinstance(view, BoardView) for _, view in mine):
            continue
        shown = [one.file.name for one, _ in mine[:5] if _readable_in_a_mirror(one, session)]
        if shown:
            raise CalibrationError(
                f"the images of camera {camera} are mirrored, left for right: the board's markers "
                f"can be read only in a mirror ({', '.join(shown)} and so on)",
                next_step="switch mirroring off in that camera's software, or mirror all of its "
                "images back, those of the shaft too",
            )


def _readable_in_a_mirror(one: ReadImage, session: Session) -> bool:
    if isinstance(one.outcome, ImageError):
        return False
    image = one.outcome.image[:, ::-1].copy()
    try:
        find_corners(image, session.board, camera=one.file.camera, view=one.file.view)
    except BoardNotFoundError:
        return False
    return True


def _inverted_note(
    reads: Sequence[ReadImage], found: Sequence[BoardView | RejectedView], session: Session
) -> tuple[str, ...]:
    """Say that the board is inverted, by the first view of each camera that shows it."""
    if session.board.kind != "charuco":
        return ()
    first: dict[str, str] = {}
    for one, view in zip(reads, found, strict=True):
        if isinstance(view, RejectedView) or isinstance(one.outcome, ImageError):
            continue
        if view.camera not in first:
            inverted = shows_inverted(one.outcome.image, view, session.board)
            first[view.camera] = one.file.name if inverted else ""
    names = [name for name in first.values() if name]
    if not names:
        return ()
    where = ", ".join(names)
    return (f"the board is inverted, bright where it should be dark ({where}); used as it is",)
