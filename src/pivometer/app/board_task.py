"""Step 2, behind the page: board views gathered by themselves, or when a key is pressed."""

from __future__ import annotations

from collections.abc import Mapping

from pivometer import pipeline
from pivometer.app.feeds import ORANGE, Mark
from pivometer.app.watcher import Watcher
from pivometer.app.work import Work
from pivometer.calibration.gathering import Gathering, Moment, gathering, says_something_new
from pivometer.calibration.glimpse import BoardGlimpse, glimpse
from pivometer.errors import ImageError
from pivometer.io.images import Image, read_image
from pivometer.io.live import Frame
from pivometer.io.session import ImageFile, Session

Seen = tuple[BoardGlimpse, tuple[int, int]]

LONELY_S = 1.0
"""A view that only some cameras see is waited for longer: the others may see it in a moment."""


class BoardTask:
    """Looks for the board in every moment and keeps those that say something new.

    Parameters
    ----------
    work
        The session in work; it must be described.
    watcher
        Who calls.
    """

    def __init__(self, work: Work, watcher: Watcher) -> None:
        self.automatic = True
        self.told = ""
        self.asked = False
        self.version = 0
        self.gathering: Gathering | None = None
        self._work, self._watcher = work, watcher
        self._glimpsed: dict[str, tuple[Image, BoardGlimpse | None]] = {}

    def prepare(self) -> None:
        """Look at the board pictures that are in the folder already."""
        self.count()

    def count(self) -> None:
        """Say how far the views that the folder holds carry."""
        self._work.reload()
        session = self._work.session
        if session is not None:
            self.gathering = gathering(self._moments(session), session.cameras)
            self.version += 1

    def _moments(self, session: Session) -> list[Moment]:
        """Return what the pictures in the folder show of the board, without those taken out."""
        moments: dict[str, dict[str, Seen]] = {}
        for file in session.board_images():
            seen = None if file.view in session.excluded else self._seen(session, file)
            if seen is not None:
                moments.setdefault(file.view, {})[file.camera] = seen
        return list(moments.values())

    def _seen(self, session: Session, file: ImageFile) -> Seen | None:
        known = self._work.glimpses
        if file.path not in known:
            known[file.path] = _glimpsed(file, session)
        return known[file.path]

    def look(self, moment: Mapping[str, Frame], still: bool) -> None:
        """Draw the corners, and take the moment if it is asked for or says something new."""
        session = self._work.session
        if session is None:
            return
        seen: dict[str, BoardGlimpse] = {}
        for name, frame in moment.items():
            board = self._glimpse(name, frame, session)
            if board is not None:
                seen[name] = board
        self.told = _told(seen, session, self._watcher.still_s)
        wanted = self.asked or (self.automatic and still and self._worth(seen, session))
        self.asked = False
        if wanted and seen:
            self._take(session, {name: moment[name] for name in seen})
        elif wanted:
            self.told = "No camera sees the whole board, so nothing was taken."

    def _glimpse(self, name: str, frame: Frame, session: Session) -> BoardGlimpse | None:
        """Look for the board and draw it, unless the picture is the very one looked at before."""
        known = self._glimpsed.get(name)
        feed = self._work.feeds.get(name)
        if known is not None and known[0] is frame.image and feed is not None and feed.marks:
            return known[1]
        board = glimpse(frame.image, session.board)
        self._glimpsed[name] = frame.image, board
        if feed is not None:
            feed.marks = () if board is None else (Mark(board.pixels, "dots", ORANGE),)
        return board

    def _worth(self, seen: Mapping[str, BoardGlimpse], session: Session) -> bool:
        """Tell whether what is seen is unlike everything before, for one of the cameras at least.

        What only some cameras see must rest longer.
        """
        if not seen or (len(seen) < len(session.cameras) and self._watcher.still_s < LONELY_S):
            return False
        before: list[Moment] = self._moments(session)
        if len(seen) == len(session.cameras):  # only moments that all share are alike
            before = [moment for moment in before if len(moment) == len(session.cameras)]
        return any(
            says_something_new(board, [m[name][0] for m in before if name in m])
            for name, board in seen.items()
        )

    def _take(self, session: Session, moment: Mapping[str, Frame]) -> None:
        """Write the pictures, and count them once they are on the disk."""
        images = {name: frame.image for name, frame in moment.items()}
        group: pipeline.Group = "board" if len(images) > 1 else "intrinsics"
        stem = pipeline.capture(session, group, images)
        self._watcher.captured()
        self.count()
        who = (
            "all cameras" if len(images) == len(session.cameras) else f"camera {', '.join(images)}"
        )
        self.told = f"View {stem} taken with {who}."


def _glimpsed(file: ImageFile, session: Session) -> Seen | None:
    """Look at a picture on the disk; one that cannot be read shows nothing."""
    try:
        image = read_image(file.path)
    except ImageError:
        return None
    board = glimpse(image, session.board)
    height, width = image.shape
    return None if board is None else (board, (width, height))


def _told(seen: Mapping[str, BoardGlimpse], session: Session, still_s: float) -> str:
    missing = [name for name in session.cameras if name not in seen]
    if len(missing) == len(session.cameras):
        return "No camera sees the whole board."
    if missing:
        return f"Camera {', '.join(missing)} does not see the whole board."
    return "All cameras see the board" + ("; it is at rest." if still_s > 0 else "; hold it still.")
