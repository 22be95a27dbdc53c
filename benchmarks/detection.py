"""Finding the shaft without a click, in sessions drawn to provoke a wrong one.

Run with ``OMP_NUM_THREADS=1 python -m benchmarks.detection [--sessions N] [--development]``. Two
calibrated cameras see cluttered rooms: see `_stress_sessions`. Found is the part of the images in
which the shaft's edges were found and fitted; used the part that `measure` accepted after all of
its gates. Wrong is an edge more than 0.5 px from the truth anywhere along its fit, gross one more
than 3 px, both in per cent of what was found or used. Held is in how many per cent of the edges the
stated 95 % interval of their middle holds the truth. Refused counts the sessions that ended with a
reason instead of an answer. The CPU time of finding and fitting an image is beside that of decoding
it from PNG. Thresholds were looked at with ``--development`` only, which takes other seeds.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks._stress_scenes import Floats
from benchmarks._stress_sessions import StressSession, stress_session
from pivometer.errors import DataError
from pivometer.io.session import load
from pivometer.measurement import ImportedRig
from pivometer.pipeline.measuring import measure_edges
from pivometer.pipeline.shafts import session_shafts
from pivometer.shaft.edges import ShaftEdges

HELD_OUT, DEVELOPMENT = 1000, 0
WRONG_PX, GROSS_PX = 0.5, 3.0
HELD_SIGMAS = 1.96
AS_WIDE = (0.85, 1.18)

ROWS: dict[str, dict[str, Any]] = {
    "36 poses": {"count": 36},
    "36 poses, the diameter stated": {"count": 36, "stated": True},
    "36 poses, one empty frame": {"count": 36, "empty": True},
    "12 poses": {"count": 12},
    "36 poses, shadows and flicker": {"count": 36, "hard": True},
    "36 poses, a wider rail beside": {"count": 36, "rail": True},
    "36 poses, a rod about as wide": {"count": 36, "rod": AS_WIDE},
    "... with the diameter stated": {"count": 36, "rod": AS_WIDE, "stated": True},
    "4 poses, a rod about as wide": {"count": 4, "rod": AS_WIDE},
}


@dataclass(frozen=True)
class Off:
    """How far both edges of an image are off: at the worst, px, and at their middles, in sigmas."""

    worst_px: float
    middle_sigmas: tuple[float, float]


@dataclass
class Tally:
    """What became of the images of one row."""

    images: int = 0
    refused: int = 0
    found: list[Off] = field(default_factory=list)
    used: list[Off] = field(default_factory=list)
    finding: list[float] = field(default_factory=list)
    decoding: list[float] = field(default_factory=list)

    def row(self, name: str) -> str:
        """Return the printed row."""
        cells = []
        for found in (self.found, self.used):
            worst = np.array([off.worst_px for off in found] or [0.0])
            held = np.abs([off.middle_sigmas for off in found] or [(0.0, 0.0)]) < HELD_SIGMAS
            cells.append(f"{100 * len(found) / self.images:9.1f}")
            cells += [
                f"{100 * float((worst > limit).mean()):7.1f}" for limit in (WRONG_PX, GROSS_PX)
            ]
            cells.append(f"{100 * float(held.mean()):7.1f}")
        finding, decoding = 1e3 * np.median(self.finding), 1e3 * np.median(self.decoding)
        times = f"{finding:9.1f}{finding / decoding:8.1f}"
        return f"{name:32}{self.images:7}" + "".join(cells) + f"{self.refused:9}{times}"


def written(drawn: StressSession, root: Path, *, empty: bool, stated: bool) -> None:
    """Write a session folder."""
    text = '[board]\nkind = "checkerboard"\nsquares = [9, 7]\nsquare_mm = 15.0\n'
    if stated:
        text += f"[shaft]\ndiameter_mm = {drawn.diameter_mm:.2f}\n"
    (root / "session.toml").write_text(text, encoding="utf-8")
    for name, frames in drawn.frames.items():
        (root / "shaft" / name).mkdir(parents=True)
        for pose, image in enumerate(frames):
            cv2.imwrite(str(root / "shaft" / name / f"{pose:03}.png"), image)
        if empty:
            (root / "background" / name).mkdir(parents=True)
            cv2.imwrite(str(root / "background" / name / "0.png"), drawn.empty[name])


def decoding_s(root: Path) -> float:
    """Return the CPU time of decoding an image."""
    files = sorted(root.glob("shaft/*/*.png"))
    start = time.process_time()
    for file in files:
        cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    return (time.process_time() - start) / len(files)


def measure(drawn: StressSession, root: Path, tally: Tally) -> str:
    """Measure a written session without a click, count what came out, and say it in a line."""
    session = load(root)
    start = time.process_time()
    shafts = session_shafts(session, drawn.rig, hints={}, progress=None)
    images = sum(len(one.edges) for one in shafts.values())
    tally.finding.append((time.process_time() - start) / images)
    tally.decoding.append(decoding_s(root))
    errors = {
        (name, pose): _off(drawn.offsets_px(name, int(pose), edges.points_px), edges.sigma_px)
        for name, one in shafts.items()
        for pose, edges in one.edges.items()
        if isinstance(edges, ShaftEdges)
    }
    seen = {name: one.edges for name, one in shafts.items()}
    rig = ImportedRig(drawn.rig, "drawn", {})
    try:
        measured = measure_edges(session, rig, seen, {})
        used = [errors[name, pose.pose] for pose in measured.used for name in shafts]
        end = ""
    except DataError as error:
        used, end = [], error.what
        tally.refused += 1
    tally.images += images
    tally.found += errors.values()
    tally.used += used
    wrong = sorted(round(off.worst_px, 1) for off in used if off.worst_px > WRONG_PX)
    return f"{len(errors)} found, {len(used)} of {images} used, wrong {wrong} {end}"


def _off(offsets_px: Floats, sigma_px: Floats) -> Off:
    first, second = offsets_px[:, offsets_px.shape[1] // 2] / sigma_px
    return Off(float(np.abs(offsets_px).max()), (float(first), float(second)))


def main() -> None:
    """Print one row for each kind of session."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sessions", type=int, default=15)
    parser.add_argument("--development", action="store_true")
    parser.add_argument("--first", type=int, default=HELD_OUT)
    parser.add_argument("--only", default="")
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    first = DEVELOPMENT if options.development else options.first
    print(f"{'':32}{'':7}{'found':>9}{'':21}{'used':>9}")
    head = f"{'':32}{'images':>7}" + f"{'%':>9}{'wrong':>7}{'gross':>7}{'held':>7}" * 2
    print(f"{head}{'refused':>9}{'ms':>9}{'/decode':>8}")
    for name, choices in ROWS.items():
        if options.only not in name:
            continue
        drawing = dict(choices)
        given = {key: bool(drawing.pop(key, False)) for key in ("empty", "stated")}
        tally = Tally()
        for seed in range(first, first + options.sessions):
            drawn = stress_session(seed, **drawing)
            with tempfile.TemporaryDirectory() as folder:
                written(drawn, Path(folder), **given)
                told = measure(drawn, Path(folder), tally)
            if options.verbose:
                print(f"{seed} {drawn.shading} {'rod' if drawn.has_second_rod else ''}: {told}")
        print(tally.row(name), flush=True)


if __name__ == "__main__":
    main()
