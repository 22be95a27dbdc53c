"""How a session folder stands: which of its results still hold, and the worst board views."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import cast

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration import BoardView, Calibration
from pivometer.calibration.frame import pose_alone, projection_errors
from pivometer.calibration.metric_scale import reconstructed_edges
from pivometer.errors import DataError, PivometerError
from pivometer.io.result import read_result, read_rig
from pivometer.io.session import Session
from pivometer.measurement import Measurement
from pivometer.pipeline.provenance import SETTINGS, settings_hashes

_BY_HAND = "excluded by hand"


class StandingResults:
    """The results in a session's folder, which are read again only when their files change.

    Parameters
    ----------
    folder
        The session folder.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder / "results"
        self._known: dict[str, tuple[int, object]] = {}

    def calibration(self, session: Session) -> Calibration | None:
        """Return the calibration, if it is of the board pictures there are.

        A picture more, a picture less, an exclusion or its undoing makes it old.
        """
        known = self._read("rig.json", read_rig)
        fits = isinstance(known, Calibration) and calibration_is_of_now(known, session)
        return cast("Calibration", known) if fits else None

    def measurement(self, session: Session) -> Measurement | None:
        """Return the measurement, if it is of the poses there are."""
        known = self._read("result.json", read_result)
        if not isinstance(known, Measurement) or self.calibration(session) is None:
            return None
        return known if is_of_now(known, session) else None

    def _read(self, name: str, reader: Callable[[Path], object]) -> object:
        path = self._folder / name
        if not path.is_file():
            return None
        written = path.stat().st_mtime_ns
        if name not in self._known or self._known[name][0] != written:
            try:
                self._known[name] = written, reader(path)
            except PivometerError:  # spoilt, or of another version: as if it were not there
                self._known[name] = written, None
        return self._known[name][1]


def calibration_is_of_now(calibration: Calibration, session: Session) -> bool:
    """Tell whether a calibration is of the board and the board pictures that a session has now."""
    files = list(session.board_images())
    lost = {(one.camera, one.view): one.reason for one in calibration.rejected}
    out = {view for view, reason in lost.items() if reason.startswith(_BY_HAND)}
    wanted = {(file.camera, file.view) for file in files if file.view in session.excluded}
    unread = {(f.camera, f.view) for f in files if f.name not in calibration.inputs}
    return (
        set(calibration.inputs) <= {file.name for file in files}
        and unread <= set(lost)
        and out == wanted
        and astuple(calibration.board) == astuple(session.board)
    )


def is_of_now(measurement: Measurement, session: Session) -> bool:
    """Tell whether a measurement is of the description and poses that a session has now."""
    out = {pose.pose for pose in measurement.rejected if pose.reason.startswith(_BY_HAND)}
    wanted = {stem for stem in session.shaft if f"shaft/{stem}" in session.excluded}
    described = settings_hashes(session)[SETTINGS]
    with_empty = any(name.startswith("background/") for name in measurement.inputs)
    return (
        [pose.pose for pose in measurement.poses] == list(session.shaft)
        and out == wanted
        and measurement.inputs.get(SETTINGS, described) == described
        and with_empty == bool(session.background)
    )


@dataclass(frozen=True, slots=True)
class ViewQuality:
    """How well one board view fits the calibration.

    Parameters
    ----------
    view
        The view.
    cameras
        The cameras that saw it.
    rms_mm, max_mm
        Error of its edges reconstructed from all cameras, mm; of a single camera's view, by how
        much its corners miss, at the board's distance, mm.
    """

    view: str
    cameras: tuple[str, ...]
    rms_mm: float
    max_mm: float


def view_qualities(calibration: Calibration) -> tuple[ViewQuality, ...]:
    """Return how well every view fits, the worst first."""
    moments: dict[str, list[int]] = {}
    for row, view in enumerate(calibration.views):
        moments.setdefault(view.view, []).append(row)
    known = [_quality(calibration, view, rows) for view, rows in moments.items()]
    return tuple(sorted(known, key=lambda quality: -quality.rms_mm))


def _quality(calibration: Calibration, view: str, rows: list[int]) -> ViewQuality:
    views = [calibration.views[row] for row in rows]
    board, rig = calibration.board, calibration.rig
    cameras = tuple(one.camera for one in views)
    misses = np.abs(_lengths(calibration, views) - board.square_mm)
    if not len(misses):  # one camera alone, or no edge in common
        pose = pose_alone(views[0], board, rig)
        errors = projection_errors(views[:1], board.corners_mm, rig, pose)[0].reshape(-1, 2)
        row = rig.index(views[0].camera)
        middle = rig.reference_from_camera[row].inverse() @ (pose @ board.corners_mm.mean(axis=0))
        mm_per_px = float(middle[2]) / float(rig.cameras[row].focal_px.mean())
        misses = np.linalg.norm(errors, axis=1) * mm_per_px
    return ViewQuality(view, cameras, float(np.sqrt(np.mean(misses**2))), float(misses.max()))


def _lengths(calibration: Calibration, views: list[BoardView]) -> Floats:
    try:
        return reconstructed_edges(views, calibration.board, calibration.rig)
    except DataError:
        return np.zeros(0)
