"""Finding the shaft without a click, in sequences drawn to provoke a wrong one.

Run with ``OMP_NUM_THREADS=1 python -m benchmarks.detection [--scenes N] [--development]``. Each row
is one camera alone: found is accepted by `find_shaft` and `fit_edges`; wrong is an accepted edge
more than 0.5 px from the truth anywhere along its fit; gross is more than 3 px. Seeds of the rows
are held out: thresholds were looked at with ``--development`` only. The time of finding is
beside that of decoding the same frame from PNG.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from benchmarks._stress_scenes import SHADINGS, Sequence, sequence
from pivometer.cameras import Camera
from pivometer.errors import DataError
from pivometer.shaft.detection import ShaftSeed, find_shaft
from pivometer.shaft.edges import fit_edges

HELD_OUT, DEVELOPMENT = 1000, 0
WRONG_PX, GROSS_PX = 0.5, 3.0


@dataclass
class Tally:
    """What became of the frames of one row."""

    frames: int = 0
    errors: list[float] = field(default_factory=list)
    finding: list[float] = field(default_factory=list)
    decoding: list[float] = field(default_factory=list)

    def row(self, name: str) -> str:
        """Return the printed row."""
        errors = np.array(self.errors) if self.errors else np.array([np.nan])
        wrong, gross = (100 * float((errors > limit).mean()) for limit in (WRONG_PX, GROSS_PX))
        found = 100 * len(self.errors) / self.frames
        finding, decoding = 1e3 * np.median(self.finding), 1e3 * np.median(self.decoding)
        return (
            f"{name:34}{self.frames:7}{found:9.1f}{wrong:9.1f}{gross:9.1f}"
            f"{finding:9.1f}{finding / decoding:9.1f}"
        )


def measure(scene: Sequence, tally: Tally, *, empty: bool) -> list[float | None]:
    """Find and fit the shaft in every frame; return the errors of the accepted ones."""
    height, width = scene.frames[0].shape
    camera = Camera(
        "c", width, height, np.full(2, 1000.0), np.array([width / 2, height / 2]), np.zeros(2)
    )
    start = time.process_time()
    seeds = find_shaft(scene.frames, background=scene.empty if empty else None)
    tally.finding.append((time.process_time() - start) / len(seeds))
    data = cv2.imencode(".png", scene.frames[0])[1]
    start = time.process_time()
    cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    tally.decoding.append(time.process_time() - start)
    outcome: list[float | None] = []
    for image, seed, truth in zip(scene.frames, seeds, scene.truth, strict=True):
        tally.frames += 1
        outcome.append(None)
        if isinstance(seed, ShaftSeed):
            try:
                points = fit_edges(image, camera, seed).points_px
            except DataError:
                continue
            outcome[-1] = truth.edge_error_px(points)
            tally.errors.append(float(outcome[-1] or 0.0))
    return outcome


ROWS: dict[str, dict[str, Any]] = {
    "36 poses": {"count": 36},
    "36 poses, one empty frame": {"count": 36, "empty": True},
    "12 poses": {"count": 12},
    "36 poses, shadows and flicker": {"count": 36, "hard": True},
    "12 poses, 5 px wide": {"count": 12, "width_px": 5.0},
    "12 poses, 200 px wide, 1920×1200": {"count": 12, "width_px": 200.0, "size": (1920, 1200)},
    "6 poses, 40 px wide, 4000×3000": {"count": 6, "width_px": 40.0, "size": (4000, 3000)},
}
LARGE = 2
"""Scenes of the rows with large images, whose drawing takes most of the time."""


def main() -> None:
    """Print one row for each kind of sequence."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=15)
    parser.add_argument("--development", action="store_true")
    parser.add_argument("--only", default="")
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    first = DEVELOPMENT if options.development else HELD_OUT
    head = ("frames", "found %", "wrong %", "gross %", "ms", "/decode")
    print(f"{'':34}{head[0]:>7}" + "".join(f"{word:>9}" for word in head[1:]))
    for name, choices in ROWS.items():
        if options.only not in name:
            continue
        drawing = dict(choices)
        empty = bool(drawing.pop("empty", False))
        tally = Tally()
        for k in range(LARGE if "size" in drawing else options.scenes):
            scene = sequence(first + k, **drawing)
            errors = measure(scene, tally, empty=empty)
            if options.verbose:
                shown = " ".join("-" if e is None else f"{e:.2f}" for e in errors)
                print(k, SHADINGS[k % 5], "rod" if scene.has_second_rod else "", shown)
        print(tally.row(name), flush=True)


if __name__ == "__main__":
    main()
