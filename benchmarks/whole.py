"""The whole `measure` of a session with a rig given, beside decoding the same images.

Run with ``python -m benchmarks.whole [FOLDER] [--preset davinci] [--profile]``. A session of 70
pairs of 640 × 480 is rendered into FOLDER (or taken from there) and calibrated; then it is measured
with that rig, without a report, and its shaft images are decoded, both with threads as by default,
in turns, and the least times count. The stages are those that the progress tells of.
"""

from __future__ import annotations

import argparse
import cProfile
import os
import pstats
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

from pivometer import pipeline
from pivometer.calibration import Calibration
from pivometer.io.result import read_rig, rig_text
from pivometer.io.session import Session
from pivometer.measurement import ImportedRig
from pivometer.pipeline import reading

REPEATS = 5
Rig = Calibration | ImportedRig


def prepared(folder: Path, preset: str) -> tuple[Session, Rig]:
    """Return the session in a folder and its calibration, made where they are not there yet."""
    root, rig = folder / preset, folder / f"{preset}-rig.json"
    if not root.exists():
        pipeline.simulate(preset, root, poses=70)
    session = pipeline.load(root)
    if not rig.exists():
        known = pipeline.calibrate(session)
        rig.write_text(rig_text(known, software="benchmark"), encoding="utf-8")
    return session, read_rig(rig)


def decode(files: list[Path], threads: int | None) -> None:
    """Decode all files."""
    with ThreadPoolExecutor(max_workers=threads) as pool:
        for _ in pool.map(lambda file: cv2.imread(str(file), cv2.IMREAD_UNCHANGED), files):
            pass


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """Return wall and CPU time of one run, s."""
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - cpu


def stages(session: Session, rig: Rig) -> dict[str, float]:
    """Return the wall time that ends with each stage that the progress tells of, s."""
    begin = time.perf_counter()
    last: dict[str, float] = {}

    def tell(stage: str, _: int, __: int) -> None:
        last[stage] = time.perf_counter() - begin

    pipeline.measure(session, rig=rig, progress=tell)
    last["RCM, uncertainty and checks"] = time.perf_counter() - begin
    times, before = {}, 0.0
    for stage, at in last.items():
        times[stage], before = at - before, at
    return times


class AtOnce(ThreadPoolExecutor):
    """Does the work when it is submitted, so that the profile sees it."""

    def submit(self, work: Callable[..., Any], /, *inputs: Any, **options: Any) -> Future[Any]:
        """Do the work."""
        done: Future[Any] = Future()
        done.set_result(work(*inputs, **options))
        return done


def profile(session: Session, rig: Rig) -> None:
    """Print where one run without threads spends its time."""
    with patch.object(reading, "ThreadPoolExecutor", AtOnce):
        watch = cProfile.Profile()
        watch.runcall(pipeline.measure, session, rig=rig)
    pstats.Stats(watch).sort_stats("cumulative").print_stats(70)


def main() -> None:
    """Print the ratio, the times and the stages."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--preset", choices=("davinci", "gold"), default="davinci")
    parser.add_argument("--profile", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.folder or Path(scratch)
        session, rig = prepared(folder, options.preset)
        if options.profile:
            profile(session, rig)
            return
        files = [f.path for name in session.cameras for f in session.shaft_images(name)]
        threads = os.cpu_count()
        runs = [
            (
                timed(lambda: pipeline.measure(session, rig=rig)),
                timed(lambda: decode(files, threads)),
            )
            for _ in range(REPEATS)
        ]
        (wall, cpu), (decode_wall, decode_cpu) = np.min(runs, axis=0)
        print(
            f"{len(files)} images: measure {wall:.2f} s ({cpu:.2f} s of CPU), decoding "
            f"{decode_wall:.3f} s ({decode_cpu:.3f} s): {wall / decode_wall:.1f}× by the clock, "
            f"{cpu / decode_cpu:.1f}× by CPU time"
        )
        for stage, seconds in stages(session, rig).items():
            print(f"  {stage:34}{seconds:7.2f} s{seconds / decode_wall:7.1f}×")


if __name__ == "__main__":
    main()
