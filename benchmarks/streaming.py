"""Memory of searching a video: how far its later frames raise the peak.

Run with ``python -m benchmarks.streaming``. Holding every frame would raise it by 0.31 MB each.
"""

from __future__ import annotations

import resource
import tempfile
from pathlib import Path

import cv2
import numpy as np

from pivometer.cameras import Camera
from pivometer.io.session import load
from pivometer.pipeline import shafts

TOML = '[board]\nkind = "checkerboard"\nsquares = [9, 7]\nsquare_mm = 15.0\n'
CAMERA = Camera("left", 640, 480, np.full(2, 800.0), np.array([320.0, 240.0]), np.zeros(2))


def write_video(file: Path, count: int) -> None:
    """Draw a shaft that swings about one pixel."""
    video = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"MJPG"), 30, (640, 480))
    for k in range(count):
        image = np.full((480, 640, 3), 30, dtype=np.uint8)
        top = (int(320 + 200 * np.sin(2 * np.pi * k / count)), 0)
        video.write(cv2.line(image, (320, 440), top, (200, 200, 200), 24, cv2.LINE_AA))
    video.release()


def peak_mb() -> float:
    """Return the process's peak of memory so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def main() -> None:
    """Print how far the frames after the first thirty raise the peak, a frame."""
    peaks: dict[int, float] = {}

    def tell(stage: str, done: int, _: int) -> None:
        if stage.startswith("fitting"):
            peaks[done] = peak_mb()

    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        (root / "session.toml").write_text(TOML, encoding="utf-8")
        (root / "shaft").mkdir()
        for camera in ("left", "right"):
            write_video(root / f"shaft/{camera}.avi", 150)
        shafts.camera_shafts(load(root), CAMERA, hint=None, progress=tell)
    growth = (peaks[150] - peaks[30]) / 120
    print(f"30 frames {peaks[30]:.0f} MB, 150 frames {peaks[150]:.0f} MB: {growth:.3f} MB a frame")


if __name__ == "__main__":
    main()
