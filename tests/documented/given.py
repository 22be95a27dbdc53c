"""What the pages take for granted: small simulated sessions, rendered once and measured once."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.documented.pages import Step

from pivometer import pipeline
from pivometer.cameras import Rig
from pivometer.io.codec import jsonable
from pivometer.io.session import Session
from pivometer.pipeline import simulating
from pivometer.pipeline.simulating import DEMO

FEWER = {"poses": 10, "seed": 1, "board_pairs": 0, "single_views": 0, "reference_views": 1}
"""The second session's pictures: its cameras and their board views are those of the first."""

LIMIT_MM = 0.5

SESSIONS = {
    "my-session": 0,
    "bench-session": 0,
    "next-session": 0,
    "other-session": 1,
    "before-service": 0,
    "after-service": 1,
    "arm-1": 0,
    "arm-2": 1,
    "arm-3": 1,
    "all-sessions/january": 0,
    "all-sessions/february": 1,
}
"""Sessions that pages name, and which of the robot's two sets of poses each shows."""

MEASURED = frozenset(SESSIONS) - {"my-session", "bench-session", "next-session"}
"""Those that have results when the page begins."""

FILES = {
    "archive/report.pdf": "report.pdf",
    "last-release/result.json": "result.json",
    "baseline/result.json": "result.json",
}
"""Files that pages name, from the results of the first set of poses."""


@dataclass
class Once:
    """Does what gives the same for the same content only once.

    What is rendered, calibrated and seen is the same to the last bit for the same options and
    pictures, as `pivometer verify` tells its users, and as its own tests hold.
    """

    store: Path
    known: dict[str, Any] = field(default_factory=dict)

    def simulate(self, work: Callable[..., Path]) -> Callable[..., Path]:
        def once(preset: str, folder: Path | str, **options: Any) -> Path:
            options = {"poses": None, "seed": 0} | options
            options.pop("progress", None)
            key = f"simulate {preset} {sorted(options.items())}"
            made = self._get(
                key, lambda: work(preset, self.store / str(len(self.known)), **options)
            )
            if (Path(folder) / "truth.json").is_file():  # a simulated session is replaced
                shutil.rmtree(folder)
            return Path(shutil.copytree(made, folder))

        return once

    def calibrate(self, work: Callable[..., Any]) -> Callable[..., Any]:
        def once(session: Session, **options: Any) -> Any:
            options = {"method": "joint", "distortion": "radial2"} | options
            options.pop("progress", None)
            files = _content(session.folder, "board", "intrinsics")
            key = f"calibrate {files} {sorted(options.items())}"
            return self._get(key, lambda: work(session, **options))

        return once

    def see_shafts(self, work: Callable[..., Any]) -> Callable[..., Any]:
        def once(session: Session, rig: Rig, *, hints: Any = None, **_: Any) -> Any:
            files = _content(session.folder, "shaft", "background")
            key = f"see {files} {json.dumps(jsonable(rig))} {hints or {}}"
            return self._get(key, lambda: work(session, rig, hints=hints))

        return once

    def plan(self, work: Callable[..., Any]) -> Callable[..., Any]:
        def once(*arguments: Any, **options: Any) -> Any:
            key = f"plan {json.dumps(jsonable([arguments, options]))}"
            return self._get(key, lambda: work(*arguments, **options))

        return once

    def _get(self, key: str, work: Callable[[], Any]) -> Any:
        if key not in self.known:
            self.known[key] = work()
        return self.known[key]


def _content(folder: Path, *groups: str) -> str:
    """Return a digest of a session's description and of its images of some groups."""
    digest = hashlib.sha256()
    inside = (path for group in groups for path in sorted((folder / group).rglob("*")))
    kept = [path for path in folder.iterdir() if path.suffix in (".toml", ".csv")]
    for path in (*sorted(kept), *inside):
        if path.is_file():
            digest.update(f"{path.relative_to(folder)} ".encode() + path.read_bytes())
    return digest.hexdigest()


@dataclass
class Given:
    """Makes what pages take for granted."""

    store: Path
    made: dict[int, Path] = field(default_factory=dict)

    def __call__(self, step: Step, folder: Path) -> None:
        """Put into a folder what a step names and what is not there."""
        if step.kind not in ("sh", "python", "yaml") or "pivometer simulate" in step.text:
            return
        for name, part in SESSIONS.items():
            root = folder / name
            if _named(name, step.text) and not (root / "session.toml").is_file():
                if name == "next-session" and (folder / "bench-session" / "session.toml").is_file():
                    shutil.copytree(folder / "bench-session", root, ignore=_no_results)
                    continue
                ignore = shutil.ignore_patterns() if name in MEASURED else _no_results
                shutil.copytree(self.part(part), root, ignore=ignore, dirs_exist_ok=True)
        for name, file in FILES.items():
            if name in step.text and not (folder / name).is_file():
                own = folder / "results" / file  # an earlier result of the page's own robot
                found = own if own.is_file() else self.part(0) / "results" / file
                (folder / name).parent.mkdir(parents=True)
                shutil.copy(found, folder / name)

    def part(self, number: int) -> Path:
        """Return the measured session of one set of poses."""
        if not self.made:
            self._render()
        root = self.made[number]
        if not (root / "results").is_dir():
            session = pipeline.load(root)
            decided = pipeline.with_decision(pipeline.measure(session), LIMIT_MM)
            pipeline.write_measurement(decided, session, root / "results")
        return root

    def _render(self) -> None:
        """Make two sessions of one kind of robot with the same cameras and board pictures."""
        first = simulating.simulate("gold", self.store / "first", **DEMO)
        second = simulating.simulate("gold", self.store / "second", **FEWER)
        for group in ("board", "intrinsics"):
            shutil.copytree(first / group, second / group)
        shutil.copytree(second / "reference", first / "reference")
        self.made = {0: first, 1: second}


def _named(name: str, text: str) -> bool:
    return name in text or (name.partition("/")[0] in text and "/" in name)


def _no_results(_: str, names: list[str]) -> list[str]:
    return [name for name in names if name == "results"]
