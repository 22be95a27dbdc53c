"""Whether a camera stood still: drawn sessions, as they are and with one camera knocked by 1 px.

Run with ``OMP_NUM_THREADS=1 python -m benchmarks.stillness [--sessions N] [--first SEED]``. In the
rooms of `_stress_sessions`, with moving shadows and flicker in every other one, each camera's
pictures are compared: how many cameras can be judged, how far the scenery of one that stood still
seems to shift at most, and by how much the shift of a knocked one is off. Told of are shifts over
`LEAST_SHIFT_PX`. The CPU time of a picture is beside that of decoding it from PNG.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import cv2
import numpy as np

from benchmarks._stress_sessions import stress_session
from pivometer.shaft.finding.background import Image
from pivometer.shaft.stillness import CameraMovement, Scenery, camera_movement

POSES = 18
KNOCK_PX = 1


def compared(images: Sequence[Image]) -> CameraMovement | None:
    """Return what a camera's pictures tell."""
    scenery = Scenery(images[0])
    views = [f"shaft/{i:03d}" for i in range(len(images))]
    return camera_movement("camera", views, [scenery.shift_px(image) for image in images])


def decode(images: Sequence[Image]) -> float:
    """Return the CPU time of decoding these images from PNG, s."""
    files = [cv2.imencode(".png", image)[1] for image in images]
    start = time.process_time()
    for file in files:
        cv2.imdecode(file, cv2.IMREAD_UNCHANGED)
    return time.process_time() - start


def main() -> None:
    """Print one row for sessions with and without shadows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sessions", type=int, default=12)
    parser.add_argument("--first", type=int, default=6000)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    print("room                      judged   still, at most   knock off by, at most   decodes")
    for hard in (False, True):
        judged, still, off, spent, decoding = [], [0.0], [0.0], 0.0, 0.0
        for seed in range(options.first, options.first + options.sessions):
            for frames in stress_session(seed, count=POSES, hard=hard).frames.values():
                start = time.process_time()
                stood = compared(frames)
                spent += time.process_time() - start
                decoding += decode(frames)
                half = len(frames) // 2
                rolled = [np.roll(image, KNOCK_PX, axis=1) for image in frames[half:]]
                knocked = compared([*frames[:half], *rolled])
                judged.append(stood is not None and knocked is not None)
                if stood is not None and knocked is not None:
                    still.append(stood.shift_px)
                    off.append(abs(knocked.shift_px - KNOCK_PX))
        name = "with shadows and flicker" if hard else "still light"
        print(
            f"{name:25}{100 * np.mean(judged):6.1f} %{max(still):14.3f} px{max(off):18.3f} px"
            f"{spent / decoding:14.1f}"
        )


if __name__ == "__main__":
    main()
