"""What the app knows: the session folder, read again whenever something was written to it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

from pivometer import pipeline
from pivometer.app.feeds import Feed, same_moment
from pivometer.calibration import Calibration
from pivometer.calibration.glimpse import BoardGlimpse
from pivometer.errors import PivometerError, UsageError
from pivometer.io.live import Frame
from pivometer.io.session import Session
from pivometer.io.sources import USUAL_RATE_HZ, open_source
from pivometer.measurement import Measurement
from pivometer.pipeline.live_shaft import LiveShaft
from pivometer.pipeline.reading import Progress


def fault_text(error: PivometerError) -> str:
    """Say what was refused, where, and what to do.

    Examples
    --------
    >>> fault_text(UsageError("no such source", next_step="name another", path="/data/left"))
    '/data/left: no such source. Next: name another.'
    """
    where = "" if error.path is None else f"{error.path}: "
    return f"{where}{error.what}. Next: {error.next_step}."


class Work:
    """One session in work: its folder and its cameras.

    Parameters
    ----------
    folder
        The session folder.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.session: Session | None = None
        self.fault: str | None = None
        self.feeds: dict[str, Feed] = {}
        self._shaft: tuple[int, LiveShaft] | None = None
        self.added = 0
        self.measured: Measurement | None = None
        self.limit_mm: float | None = None
        self.notes: dict[str, str] = {}
        self._results = pipeline.StandingResults(folder)
        self._seen: tuple[object, pipeline.SeenShafts] | None = None
        self.glimpses: dict[Path, tuple[BoardGlimpse, tuple[int, int]] | None] = {}
        self.reload()

    def reload(self) -> None:
        """Read the folder again."""
        try:
            self.session, self.fault = pipeline.load(self.folder), None
        except PivometerError as error:
            self.session = None
            self.fault = str(error) if (self.folder / "session.toml").exists() else None

    def calibration(self) -> Calibration | None:
        """Return the calibration in the folder, if it is of the pictures there are."""
        return None if self.session is None else self._results.calibration(self.session)

    def shaft(self) -> LiveShaft | None:
        """Return what is known of the shaft; `None` without a calibration that holds."""
        made = self.calibration()
        if made is None:
            return None
        written = (self.folder / "results" / "rig.json").stat().st_mtime_ns
        if self._shaft is None or self._shaft[0] != written:
            self._shaft = written, LiveShaft(made)
        return self._shaft[1]

    def measure(self, progress: Progress | None = None) -> Measurement:
        """Measure the session as it is now, without looking again at pictures already looked at.

        Raises
        ------
        PivometerError
            If it cannot be measured.
        """
        self.reload()
        session = self.session
        if session is None:
            raise UsageError(self.fault or "no session yet", next_step="describe it in step 1")
        made = self.calibration()
        if made is None:
            made = pipeline.calibrate(session, progress=progress)
            pipeline.write_calibration(made, self.folder / "results")
        session.require("shaft")
        written = [self.folder / name for name in ("results/rig.json", "session.toml")]
        key = (tuple(session.shaft), tuple(session.background), *map(_written_ns, written))
        if self._seen is None or self._seen[0] != key:
            self._seen = key, pipeline.see_shafts(session, made.rig, progress=progress)
        self.measured = None  # what held before does not any more, whatever comes of it
        measured = pipeline.measure_seen(session, made, self._seen[1])
        if self.limit_mm is not None:
            measured = pipeline.with_decision(measured, self.limit_mm)
        self.measured = measured
        return measured

    def decide(self, limit_mm: float) -> Measurement | None:
        """Hold the result against a limit, from now on; `None` where there is no result."""
        measured = self.result()
        if measured is not None:
            self.measured = pipeline.with_decision(measured, limit_mm)
            self.limit_mm = limit_mm
        return self.measured

    def result(self) -> Measurement | None:
        """Return the measurement that holds: made here, or in the session's results."""
        self.reload()
        if self.session is None:
            return None
        if self.measured is None or not pipeline.is_of_now(self.measured, self.session):
            self.measured = self._results.measurement(self.session)
            if self.measured is not None and self.measured.decision is not None:
                self.limit_mm = self.measured.decision.limit_mm
        return self.measured

    def look_around(self) -> None:
        """Read the folder again, which others may have changed, and note how far each step is."""
        measured = self.result()
        session = self.session
        if session is None:
            self.notes = {}
            return
        reported = (self.folder / "results" / "report.html").is_file()
        holds = self._results.measurement(session) is not None
        self.notes = {
            "/": "✓",
            "/calibrate": _note(len(session.board_views), self.calibration() is not None),
            "/poses": _note(len(session.shaft), False),
            "/result": _note(0, measured is not None),
            "/report": _note(0, reported and holds),
        }

    def open_cameras(self, sources: Mapping[str, str], rate_hz: float) -> None:
        """Open the cameras in place of those that are open.

        Raises
        ------
        PivometerError
            If one cannot be opened; then none is.
        """
        self.close_cameras()
        start, opened = time.monotonic(), {}
        try:
            for name, text in sources.items():
                opened[name] = open_source(text, rate_hz=rate_hz, start_s=start)
        except PivometerError:
            for source in opened.values():
                source.close()
            raise
        self.feeds = {name: Feed(name, source) for name, source in opened.items()}

    def open_saved_cameras(self) -> str | None:
        """Open the cameras that the session folder names; return why not, where that fails."""
        sources, rate_hz = pipeline.saved_sources(self.folder)
        if self.session is None or not sources:
            return None
        wanted = {name: sources[name] for name in self.session.cameras if name in sources}
        try:
            self.open_cameras(wanted, rate_hz or USUAL_RATE_HZ)
        except PivometerError as error:
            return str(error)
        return None

    def close_cameras(self) -> None:
        """Close all cameras."""
        for feed in self.feeds.values():
            feed.close()
        self.feeds = {}

    def lost(self) -> str:
        """Say which cameras are lost, and why; empty where none is."""
        lost = [f"Camera {n} is lost: {f.fault}." for n, f in self.feeds.items() if f.fault]
        return " ".join([*lost, "Open the cameras again in step 1."] if lost else [])

    def moment(self) -> dict[str, Frame] | None:
        """Return every camera's frame of the newest moment that all have."""
        return same_moment(self.feeds)


def _written_ns(path: Path) -> int:
    return path.stat().st_mtime_ns


def _note(count: int, done: bool) -> str:
    return " ".join([*([str(count)] if count else []), *(["✓"] if done else [])])
