"""Step 3, behind the page: poses taken by themselves, their edges, and the RCM so far."""

from __future__ import annotations

import threading
from collections.abc import Mapping

import numpy as np

from pivometer import pipeline
from pivometer._arrays import Floats
from pivometer.app.feeds import CYAN, ORANGE, Mark
from pivometer.app.watcher import Watcher
from pivometer.app.work import Work, fault_text
from pivometer.errors import PivometerError
from pivometer.io.images import Image
from pivometer.io.live import Frame
from pivometer.measurement import Measurement
from pivometer.pipeline.live_shaft import LivePose, LiveShaft, is_new_pose


class ShaftTask:
    """Follows the shaft in every moment and keeps poses that say something new.

    Parameters
    ----------
    work
        The session in work; its cameras must be calibrated.
    watcher
        Who calls.
    shaft
        What is known of the shaft; kept over page loads.
    """

    def __init__(self, work: Work, watcher: Watcher, shaft: LiveShaft) -> None:
        self.automatic = True
        self.told = ""
        self.taken = ""
        self.asked: pipeline.Group | None = None
        self.version = 0
        self.now: Floats | None = None
        self.directions: Floats = np.zeros((0, 3))
        self.measured: Measurement | None = None
        self.refused = ""
        self.history: list[tuple[int, float]] = []
        self._work, self._watcher, self._shaft = work, watcher, shaft
        self._glimpsed: tuple[int, Mapping[str, Image], LivePose] | None = None
        self._changed = threading.Event()
        self._measuring = threading.Lock()

    def prepare(self) -> None:
        """Take in the poses that the folder holds already."""
        self.count()

    def count(self) -> None:
        """Fit the poses that came, and measure again beside the live pictures."""
        self._work.reload()
        session = self._work.session
        if session is None:
            return
        self._shaft.follow(session)
        self.directions = self._shaft.directions(session)
        self.version += 1
        self._changed.set()
        threading.Thread(target=self._measure, name="live RCM", daemon=True).start()

    def _measure(self) -> None:
        """Measure the poses so far; of several requests that wait, one does for all."""
        with self._measuring:
            session = self._work.session
            if not self._changed.is_set() or session is None:
                return
            self._changed.clear()
            try:
                self.measured, self.refused = self._shaft.measured(session), ""
            except PivometerError as error:
                self.measured, self.refused = None, fault_text(error)
            except np.linalg.LinAlgError as error:  # of poses that nobody foresaw
                self.measured, self.refused = None, f"These poses cannot be solved: {error}."
            else:
                worst = float(self.measured.uncertainty.expanded_mm.max())
                count = len(self.measured.used)
                self.history = [entry for entry in self.history if entry[0] < count]
                self.history.append((count, worst))
            self.version += 1

    def look(self, moment: Mapping[str, Frame], still: bool) -> None:
        """Draw the edges, and take the moment if it is asked for or says something new."""
        pose = self._glimpse({name: frame.image for name, frame in moment.items()})
        self.told = self._said(pose)
        asked, self.asked = self.asked, None
        if asked is not None and asked != "shaft":
            self._take_other(moment, asked)
        elif asked or (self.automatic and still and self._worth(pose)):
            self._take(moment)

    def _glimpse(self, images: Mapping[str, Image]) -> LivePose:
        """Look for the shaft and draw it, unless these very pictures were looked at before."""
        known = self._glimpsed
        if known is not None and known[0] == self.version and _same(known[1], images):
            return known[2]
        if self._watcher.still_s == 0:  # rather no edges than those of a moment ago
            for feed in self._work.feeds.values():
                feed.marks = ()
        pose = self._shaft.glimpse(images)
        self._glimpsed = self.version, images, pose
        self.now = pose.direction
        for name, feed in self._work.feeds.items():
            feed.marks = _marks(pose.edges_px.get(name))
        return pose

    def _worth(self, pose: LivePose) -> bool:
        """Tell whether the shaft is turned unlike all poses; before that is known, all are."""
        if not self._shaft.ready:
            return True
        if pose.direction is None:  # the finder may not know enough yet; few are taken in vain
            return len(self.directions) < LEARNING
        return is_new_pose(pose.direction, self.directions)

    def _take(self, moment: Mapping[str, Frame]) -> None:
        session = self._work.session
        if session is None:
            return
        images = {name: frame.image for name, frame in moment.items()}
        stem = pipeline.capture(session, "shaft", images)
        self._watcher.captured()
        self.count()
        fault = self._shaft.fault_of(stem)
        self.told = f"Pose {stem} taken." if fault is None else f"Pose {stem} taken, but {fault}."

    def _take_other(self, moment: Mapping[str, Frame], group: pipeline.Group) -> None:
        """Take a picture that is no pose: of the empty scene, or of a board that stands there."""
        session = self._work.session
        if session is not None:
            images = {name: frame.image for name, frame in moment.items()}
            stem = pipeline.capture(session, group, images)
            self.taken = f"{group}/{stem} is taken."

    def _said(self, pose: LivePose) -> str:
        if not self._shaft.ready:
            return "Take three poses or more: they tell what moves."
        if pose.reasons:
            return "; ".join(f"Camera {name}: {reason}" for name, reason in pose.reasons.items())
        rest = "it is at rest" if self._watcher.still_s > 0 else "wait until it is at rest"
        return f"All cameras see the shaft; {rest}."


LEARNING = 6
"""Poses up to which a moment in which no shaft is found is taken all the same."""


def _same(a: Mapping[str, Image], b: Mapping[str, Image]) -> bool:
    return a.keys() == b.keys() and all(a[name] is b[name] for name in a)


def _marks(edges_px: Floats | None) -> tuple[Mark, ...]:
    """Return both edges, and the line midway between them."""
    if edges_px is None:
        return ()
    middle = Mark(edges_px.mean(axis=0), "dashed", ORANGE)
    return (Mark(edges_px[0], "line", CYAN), Mark(edges_px[1], "line", CYAN), middle)
