"""From an empty folder to a downloaded report, by keyboard alone, in a real browser.

Image folders play the cameras. On the way the app is killed, as by a power cut, and goes on.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from pivometer import pipeline
from pivometer.cameras import Camera, Rig
from pivometer.io.result import read_result, read_rig
from pivometer.pipeline.measuring import measure
from pivometer.simulation.presets import gold

pytest.importorskip("playwright", reason="Playwright is not installed")
pytest.importorskip("axe_playwright_python", reason="axe is not installed")
CHROMIUM = shutil.which("chromium")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium to look with")

from axe_playwright_python.sync_playwright import Axe  # noqa: E402
from playwright.sync_api import Page, sync_playwright  # noqa: E402

POSES, PAIRS = 6, 8
WAIT_MS = 90_000


def half(camera: Camera) -> Camera:
    """The same view on a quarter of the pixels: pixel centres at (x + 1/2)/2 − 1/2."""
    centre = (camera.principal_point_px + 0.5) / 2 - 0.5
    return Camera(camera.name, 320, 240, camera.focal_px / 2, centre, camera.distortion)


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    preset = gold()
    rig = Rig([half(camera) for camera in preset.rig.cameras], preset.rig.reference_from_camera)
    folder = tmp_path_factory.mktemp("rendered") / "gold"
    return pipeline.simulate(
        replace(preset, rig=rig), folder, poses=POSES, board_pairs=PAIRS, single_views=0, seed=3
    )


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"]
        )
        context = browser.new_context(viewport={"width": 1280, "height": 900})
        context.set_default_timeout(WAIT_MS)
        yield context.new_page()
        browser.close()


@pytest.fixture(scope="module")
def noise(page: Page) -> list[str]:
    """What the browser complained of, and every request to another host."""
    heard: list[str] = []
    page.on("pageerror", lambda error: heard.append(f"error: {error}"))
    page.on(
        "console",
        lambda said: heard.append(said.text) if said.type in ("error", "warning") else None,
    )
    page.on(
        "request",
        lambda asked: (
            None
            if re.match(r"http://127\.0\.0\.1:|blob:|data:", asked.url)
            else heard.append(f"asked {asked.url}")
        ),
    )
    return heard


NAMED = """() => { const e = document.activeElement; if (!e) return "";
  const label = e.labels && e.labels[0] ? e.labels[0].innerText : "";
  return (e.getAttribute("aria-label") || label || e.innerText || "").trim(); }"""


def tab_to(page: Page, name: str) -> None:
    """Press Tab until something of that name has the focus."""
    for _ in range(200):
        page.keyboard.press("Tab")
        if page.evaluate(NAMED).startswith(name):
            return
    raise AssertionError(f"no way by Tab to {name!r}")


def type_into(page: Page, name: str, content: str) -> None:
    tab_to(page, name)
    page.keyboard.press("Control+A")
    page.keyboard.type(content)


def go_to(page: Page, step: str) -> None:
    tab_to(page, step)
    page.keyboard.press("Enter")
    page.wait_for_selector(f"a[aria-current]:has-text('{step}')")
    page.wait_for_function("window.socket && window.socket.connected")


def accessible(page: Page) -> None:
    found = Axe().run(page).response["violations"]
    assert not [(one["id"], [node["html"][:200] for node in one["nodes"]]) for one in found]


def count(folder: Path) -> int:
    return len(list(folder.glob("*.png")))


def wait_for(page: Page, condition: Callable[[], bool]) -> None:
    for _ in range(WAIT_MS // 100):
        if condition():
            return
        page.wait_for_timeout(100)
    raise AssertionError("it did not happen")


def test_the_whole_journey(
    start_app, rendered: Path, page: Page, noise: list[str], tmp_path: Path
) -> None:
    folder = tmp_path / "session"
    app = start_app(folder)
    page.goto(app.url)
    page.wait_for_function("window.socket && window.socket.connected")
    assert "token" not in page.url

    # 1 Set up
    type_into(page, "Side of a square, measured, mm", "15")
    type_into(page, "Diameter of the shaft, mm", "10")
    for number, name in enumerate(("left", "right"), 1):
        type_into(page, f"Source of camera {number}", str(rendered / "board" / name))
    type_into(page, "Pictures a second of folders", "1.5")
    type_into(page, "Standard uncertainty of that side", "15")
    tab_to(page, "Save and open the cameras")
    page.keyboard.press("Enter")
    page.wait_for_selector("text=the uncertainty of the square size is 15.0 mm")
    assert not (folder / "session.toml").exists()
    type_into(page, "Standard uncertainty of that side", "0.01")
    tab_to(page, "Save and open the cameras")
    page.keyboard.press("Enter")
    page.wait_for_selector("img[data-frames]")
    assert pipeline.load(folder).board.square_u_mm == 0.01
    page.wait_for_selector("text=All checks pass.")

    # 2 Calibrate: views take themselves, each with both cameras
    go_to(page, "2 Calibrate")
    wait_for(page, lambda: count(folder / "board" / "right") >= PAIRS - 2)
    page.wait_for_selector("button:has-text('Calibrate'):not([disabled])")
    page.keyboard.press("k")
    page.wait_for_selector("text=Calibrated;")
    page.wait_for_selector("text=/The calibration is (good|usable|weak)/")
    accessible(page)
    assert count(folder / "board" / "left") == count(folder / "board" / "right")

    # 3 Poses
    go_to(page, "1 Set up")
    for number, name in enumerate(("left", "right"), 1):
        type_into(page, f"Source of camera {number}", str(rendered / "shaft" / name))
    tab_to(page, "Save and open the cameras")
    page.keyboard.press("Enter")
    page.wait_for_selector("text=Saved.")
    accessible(page)
    go_to(page, "3 Poses")
    wait_for(page, lambda: count(folder / "shaft" / "right") >= POSES - 1)
    page.wait_for_selector("text=largest miss")
    accessible(page)

    # The power fails; what was taken is there.
    assert noise == []
    app.process.kill()
    app.process.wait()
    taken = count(folder / "shaft" / "left")
    app = start_app(folder)
    page.goto(app.url)
    page.wait_for_function("window.socket && window.socket.connected")
    noise.clear()  # the browser complained of the lost connection, rightly
    assert page.get_by_role("link", name=f"3 Poses {taken}").count() == 1

    # 4 Result
    go_to(page, "4 Result")
    page.keyboard.press("m")
    page.wait_for_selector("text=Measured.")
    type_into(page, "Limit of the largest miss, mm", "0.5")
    tab_to(page, "Check the limit")
    page.keyboard.press("Enter")
    page.wait_for_selector("text=No decision, a condition")  # too few poses for one
    tab_to(page, "Look at shaft/")
    page.keyboard.press("Enter")
    page.wait_for_selector(".photo img")
    tab_to(page, "Take out: shaft/")
    view = page.evaluate(NAMED).removeprefix("Take out: ")
    page.keyboard.press("Enter")
    page.wait_for_selector("text=without a reason")
    type_into(page, "Reason for taking one out", "a shadow <b>on</b> it")
    tab_to(page, f"Take out: {view}")
    page.keyboard.press("Enter")
    page.wait_for_selector(f"text={view} is taken out.")
    page.wait_for_selector("text=1 of")
    accessible(page)

    # 5 Report
    go_to(page, "5 Report")
    page.keyboard.press("w")
    page.wait_for_selector("text=Written into")
    shown_report = page.frame_locator("iframe[title='The report']")
    shown_report.get_by_text("excluded by hand: a shadow").first.wait_for(state="attached")
    page.emulate_media(color_scheme="dark")
    accessible(page)
    tab_to(page, "Report (")
    with page.expect_download() as download:
        page.keyboard.press("Enter")
    report = Path(download.value.path()).read_text(encoding="utf-8")
    assert "a shadow &lt;b&gt;on&lt;/b&gt; it" in report
    assert noise == []

    # The command line says the same of this folder, to the last bit.
    session = pipeline.load(folder)
    assert session.excluded == {view: "a shadow <b>on</b> it"}
    shown = read_result(folder / "results" / "result.json")
    again = measure(session, rig=read_rig(folder / "results" / "rig.json"))
    for name in ("minimax", "least_squares"):
        ours, theirs = getattr(shown.rcm, name), getattr(again.rcm, name)
        assert ours.point_mm.tolist() == theirs.point_mm.tolist()
    assert [pose.reason for pose in again.rejected] == [pose.reason for pose in shown.rejected]
    assert shown.decision is not None
    assert (shown.decision.decision, shown.decision.limit_mm) == ("invalid", 0.5)
    assert any("excluded by hand: a shadow" in pose.reason for pose in shown.rejected)

    # And it is near the truth of the poses used: inside twice its 95 % half-widths.
    used = {pose.pose for pose in shown.used}
    assert len(used) >= 3
    truth = json.loads((rendered / "truth.json").read_text(encoding="utf-8"))
    pivot = pipeline.true_rcm(rendered, poses=[pose["pose"] for pose in truth["poses"]])
    off = shown.rcm.least_squares.point_mm - pivot.least_squares.point_mm
    assert (abs(off) <= 2 * shown.uncertainty.expanded_mm).all()
