"""A thread that looks at every moment the cameras see, and lets a task draw, tell and capture."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from typing import Protocol

import cv2
import numpy as np

from pivometer.app.work import Work
from pivometer.errors import PivometerError
from pivometer.io.images import Image
from pivometer.io.live import Frame
from pivometer.pipeline.watching import Small, Stillness, differ, motion, offset_s, reduced

HOLD_S = 0.4
"""A hand that holds a board still does so for half a second."""
_PAUSE_S = 0.005
_MEMORY = 600
"""Moments whose motion is remembered: 20 s at 30 frames a second."""


class Task(Protocol):
    """What is done with every moment in one step of the app."""

    def prepare(self) -> None:
        """Get ready; called once, in the watcher's thread."""

    def look(self, moment: Mapping[str, Frame], still: bool) -> None:
        """Look at a moment; `still` says that the scene rests and differs from the last picture."""


class Watcher(threading.Thread):
    """Looks at every moment, with one task at a time."""

    def __init__(self, work: Work) -> None:
        super().__init__(name="watcher", daemon=True)
        self.fault: str | None = None
        self.dead = ""
        self.still_s = 0.0
        self._work = work
        self._task: Task | None = None
        self._prepared: Task | None = None
        self._ended = threading.Event()
        self._numbers: dict[str, int] = {}
        self._stillness: dict[str, Stillness] = {}
        self._last: dict[str, Small] = {}
        self._images: dict[str, Image] = {}
        self._captured: dict[str, Small] = {}
        self._motion: dict[str, deque[tuple[float, float]]] = {}

    def set_task(self, task: Task | None) -> None:
        """Change what is done with the moments from now on."""
        self._captured = {}
        self._task = task
        for feed in self._work.feeds.values():
            feed.marks = ()

    def drop_task(self, task: Task) -> None:
        """Do nothing more with the moments, if this is still what is done."""
        if self._task is task:
            self.set_task(None)

    def captured(self) -> None:
        """Remember that the moment just seen was taken: the scene must change before the next."""
        self._captured = dict(self._last)

    def stop(self) -> None:
        """Stop after the moment that is being looked at."""
        self._ended.set()

    def told(self) -> str:
        """Return what went wrong since this was asked last; empty where nothing did."""
        fault, self.fault = self.fault, None
        return self.dead or fault or ""

    def offsets_s(self) -> dict[str, float | None]:
        """Return by how much each camera is late against the first, where motion tells."""
        series = {name: list(values) for name, values in self._motion.items()}
        names = [name for name in self._work.feeds if name in series]
        return {name: offset_s(series[names[0]], series[name]) for name in names[1:]}

    def run(self) -> None:
        """Look until stopped; what goes wrong with a moment is told and the next one looked at."""
        try:
            while not self._ended.is_set():
                self._step_or_tell()
        finally:
            if not self._ended.is_set():
                self.dead = "Nothing looks at the pictures any more: start the app again."

    def _step_or_tell(self) -> None:
        try:
            if not self._step():
                self._ended.wait(_PAUSE_S)
        except PivometerError as error:
            self.fault = str(error)
        except (cv2.error, np.linalg.LinAlgError) as error:  # of a picture nobody foresaw
            self.fault = f"a moment could not be looked at: {error}"

    def _step(self) -> bool:
        task = self._task
        if task is not None and self._prepared is not task:
            self._prepared = task  # before it fails: it is not tried for ever
            task.prepare()
        moment = self._work.moment()
        if moment is None:
            return False
        numbers = {name: frame.number for name, frame in moment.items()}
        if numbers == self._numbers:
            return False
        self._numbers = numbers
        still = self._feel(moment)
        if task is not None:
            task.look(moment, still)
        return True

    def _feel(self, moment: Mapping[str, Frame]) -> bool:
        """Follow motion and stillness; tell whether the scene rests and is another than before."""
        rests = []
        for name, frame in moment.items():
            before = self._last.get(name)
            old = self._images.get(name)
            small = before if before is not None and old is frame.image else reduced(frame.image)
            self._images[name] = frame.image
            if before is not None and before.shape == small.shape:
                series = self._motion.setdefault(name, deque(maxlen=_MEMORY))
                series.append((frame.time_s, motion(small, before)))
            self._last[name] = small
            rests.append(self._stillness.setdefault(name, Stillness()).update(small, frame.time_s))
        self.still_s = min(rests)
        other = not self._captured or any(
            name not in self._captured or differ(self._last[name], self._captured[name])
            for name in moment
        )
        return self.still_s >= HOLD_S and other
