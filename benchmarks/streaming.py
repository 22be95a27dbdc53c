"""Memory of searching a video: the peak after a short one, and how far a longer one raises it.

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


def peak_mb(count: int) -> float:
    """Return the process's peak of memory, MB, after a video of so many frames is searched."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        (root / "session.toml").write_text(TOML, encoding="utf-8")
        (root / "shaft").mkdir()
        for camera in ("left", "right"):
            write_video(root / f"shaft/{camera}.avi", count)
        session = load(root)
        shafts.camera_shafts(session, CAMERA, hint=None, progress=None)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def main() -> None:
    """Print the peak after a short video, and how far a longer one raises it a frame."""
    short, long = peak_mb(60), peak_mb(180)
    print(
        f"60 frames {short:.0f} MB, 180 frames {long:.0f} MB: {(long - short) / 120:.3f} MB a frame"
    )


if __name__ == "__main__":
    main()
