"""Live pictures of the app in a headless Chromium: rate, overlays, first frame, memory.

Run: python -m benchmarks.app [--frames 10000]

Folders of two board pictures play the cameras at 60 pictures a second, faster than the page can
show them, so that what is counted is what the app and the browser do. Beside each rate stands the
processor time that server and browser took, in cores, and the computer's load before: other work on
the machine lowers the rates.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pivometer import pipeline
from pivometer.calibration import Board
from pivometer.calibration.glimpse import glimpse
from pivometer.io.images import Image, read_image, write_image
from pivometer.io.settings import Settings
from pivometer.pipeline.watching import reduced
from pivometer.simulation import simulate

CAMERAS = ("left", "right")
RATE_HZ = 60.0
SECONDS = 10.0
TICK = os.sysconf("SC_CLK_TCK")
FRAMES = "Array.from(document.images, (i) => Number(i.dataset.frames || 0))"


def board_pictures(width: int, height: int) -> dict[str, Image]:
    """Return a rendered board for each camera, enlarged to the size."""
    session = simulate("gold", poses=3, board_pairs=1, single_views=0)
    return {
        name: np.asarray(
            cv2.resize(session.image(f"board/{name}/000.png"), (width, height)), dtype=np.uint8
        )
        for name in CAMERAS
    }


def make_session(folder: Path, width: int, height: int) -> None:
    """Describe a session whose cameras are folders of two pictures."""
    for name, image in board_pictures(width, height).items():
        write_image(folder / "play" / name / "0.png", image)
        write_image(folder / "play" / name / "1.png", np.roll(image, 1, axis=1))
    board = Board("checkerboard", (9, 7), 15.0)
    pipeline.describe(folder / "session", Settings(board, 10.0, CAMERAS, "left", {}, {}, ""))
    sources = {name: str(folder / "play" / name) for name in CAMERAS}
    pipeline.save_sources(folder / "session", sources, rate_hz=RATE_HZ)


def start(folder: Path) -> tuple[subprocess.Popen[str], str, float]:
    """Start the app; return it, its address, and when it said so."""
    process = subprocess.Popen(  # noqa: S603 – our own program
        [sys.executable, "-m", "pivometer", "app", str(folder / "session"), "--no-browser"],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    found = re.search(r"http\S+", process.stdout.readline())
    assert found is not None
    return process, found[0], time.monotonic()


def processor_s(root: int) -> float:
    """Return the processor time of a process and of all that descend from it, s."""
    total, parents = 0, {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        except OSError:
            continue
        parents[int(path.parent.name)] = int(fields[1]), int(fields[11]) + int(fields[12])
    for number, (_, ticks) in parents.items():
        line = number
        while line in parents and line != root:
            line = parents[line][0]
        total += ticks if line == root else 0
    return total / TICK


def memory_mb(process: int) -> float:
    """Return the resident memory of a process, MB."""
    text = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
    return int(text.partition("VmRSS:")[2].split()[0]) / 1000


def opened(page: Any, url: str) -> None:
    """Open the app's second step, where corners are looked for and drawn."""
    page.goto(url)
    page.goto(url.partition("?")[0] + "calibrate")
    page.wait_for_selector("img[data-frames]")


def rates(page: Any, process: subprocess.Popen[str]) -> None:
    """Print the rates of the previews with corners drawn, and the processor time they took."""
    page.wait_for_timeout(2000)
    before, taken = page.evaluate(FRAMES), processor_s(os.getpid())
    own, began = processor_s(process.pid), time.monotonic()
    page.wait_for_timeout(1000 * SECONDS)
    passed = time.monotonic() - began
    shown = np.subtract(page.evaluate(FRAMES), before) / passed
    server = (processor_s(process.pid) - own) / passed
    browser = (processor_s(os.getpid()) - taken) / passed - server
    print(
        f"    previews {' and '.join(f'{rate:.0f}' for rate in shown)} a second and camera; ",
        end="",
    )
    print(f"server {server:.2f}, browser {browser:.2f} cores")


def looking(folder: Path) -> None:
    """Print how long it takes to look at a moment of both cameras, processor time of one core."""
    session = pipeline.load(folder / "session")
    images = [read_image(folder / "play" / name / "0.png") for name in CAMERAS]
    times = []
    for _ in range(20):
        began = time.process_time()
        for image in images:
            reduced(image)
            glimpse(image, session.board)
        times.append(time.process_time() - began)
    typical = float(np.median(times))
    print(
        f"    a moment is looked at in {1000 * typical:.0f} ms: {1 / typical:.0f} a second and core"
    )


def memory(page: Any, process: subprocess.Popen[str], frames: int) -> None:
    """Print the memory of server and page as previews go by."""
    heap = "performance.memory.usedJSHeapSize / 1e6"
    at = [frames // 10, frames // 4, frames // 2, 3 * frames // 4, frames]
    for count in at:
        page.wait_for_function(f"{FRAMES}.reduce((a, b) => a + b) >= {count}", timeout=0)
        print(
            f"    after {count:6} previews: server {memory_mb(process.pid):6.1f} MB, "
            f"page {page.evaluate(heap):5.1f} MB"
        )


def first_frame(playwright: Any, chromium: str) -> None:
    """Print how long after the server is up a camera's first frame is seen, three times."""
    with tempfile.TemporaryDirectory() as name:
        make_session(Path(name), 640, 480)
        for _ in range(3):
            browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
            page = browser.new_page()
            process, url, up = start(Path(name))
            try:
                opened_at_once(page, url)
                print(f"    first frame {time.monotonic() - up:.2f} s after the server is up")
            finally:
                process.terminate()
                process.wait()
                browser.close()


def opened_at_once(page: Any, url: str) -> None:
    """Open the first step, trying until the server listens."""
    from playwright.sync_api import Error

    while True:
        try:
            page.goto(url)
            break
        except Error:
            time.sleep(0.02)
    page.wait_for_selector("img[data-frames]")


def main() -> None:
    """Print all tables."""
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10_000)
    frames = parser.parse_args().frames
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("there is no chromium to look with")
    print(f"load of the machine before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    with sync_playwright() as playwright:
        first_frame(playwright, chromium)
        for width, height in ((640, 480), (2448, 2048)):
            print(f"two cameras of {width}×{height} px, corners looked for and drawn:")
            browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
            with tempfile.TemporaryDirectory() as name:
                make_session(Path(name), width, height)
                looking(Path(name))
                process, url, _ = start(Path(name))
                try:
                    page = browser.new_page()
                    opened(page, url)
                    rates(page, process)
                    if width == 640:
                        memory(page, process, frames)
                finally:
                    process.terminate()
                    process.wait()
                    browser.close()


if __name__ == "__main__":
    main()
