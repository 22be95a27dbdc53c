"""Which results of a folder still hold, the worst views, and the live pictures of poses."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pivometer import pipeline
from pivometer.calibration import BoardView, Calibration, RejectedView
from pivometer.errors import ImageError
from pivometer.geometry.rigid import RigidTransform
from pivometer.io.atomic import write_file, write_files
from pivometer.io.live import Frame
from pivometer.io.result import result_text, rig_text
from pivometer.io.session import Session
from pivometer.io.settings import Settings
from pivometer.measurement import Measurement, RejectedPose
from pivometer.pipeline import watching
from pivometer.pipeline.calibrating import corners
from pivometer.pipeline.reading import read
from pivometer.report.pose_map import pose_map, shrinking_chart

DOT = np.zeros((4, 4), np.uint8)


@pytest.fixture(scope="module")
def measurement(make_measurement: Callable[..., Measurement]) -> Measurement:
    made = make_measurement()
    poses = sorted(made.poses[:8], key=lambda pose: pose.pose)
    return replace(made, poses=tuple(poses), inputs={}, structure=None)


@pytest.fixture(scope="module")
def texts(measurement: Measurement) -> dict[str, str]:
    """What the two results are, of three board views."""
    calibration = measurement.calibration
    assert isinstance(calibration, Calibration)
    names = [f"board/{name}/{k:03d}.png" for name in ("left", "right") for k in range(3)]
    known = replace(calibration, inputs=dict.fromkeys(names, "0" * 64))
    return {"rig.json": rig_text(known, software="x"), "result.json": result_text(measurement)}


@pytest.fixture
def session(tmp_path: Path, measurement: Measurement, texts: dict[str, str]) -> Session:
    """A folder with board views, the poses of a measurement, and the results of both."""
    board = measurement.setup.board
    settings = Settings(board, 10.0, ("left", "right"), "left", {}, {}, "")
    session = pipeline.describe(tmp_path / "s", settings)
    for _ in range(3):
        pipeline.capture(session, "board", {"left": DOT, "right": DOT})
    for pose in measurement.poses:
        for name in session.cameras:
            (session.folder / "shaft" / name / f"{pose.pose}.png").write_bytes(b"not looked at")
    write_files(session.folder / "results", texts)
    return pipeline.load(session.folder)


def calibration_of(session: Session) -> Calibration | None:
    return pipeline.StandingResults(session.folder).calibration(session)


def measurement_of(session: Session) -> Measurement | None:
    return pipeline.StandingResults(session.folder).measurement(session)


def test_results_are_read_again_only_when_they_change(session: Session) -> None:
    results = pipeline.StandingResults(session.folder)
    first = results.calibration(session)
    assert first is not None
    assert results.calibration(session) is first
    write_file(session.folder / "results" / "rig.json", "{")
    assert results.calibration(session) is None


def test_results_hold_until_pictures_come_or_go(session: Session) -> None:
    assert calibration_of(session) is not None
    assert measurement_of(session) is not None
    (session.folder / "shaft" / "left" / "999.png").write_bytes(b"x")
    more = pipeline.load(session.folder)
    assert calibration_of(more) is not None
    assert measurement_of(more) is None
    pipeline.capture(session, "board", {"left": DOT})
    assert calibration_of(pipeline.load(session.folder)) is None


def test_results_hold_until_the_description_changes_or_empty_frames_come(
    session: Session, measurement: Measurement
) -> None:
    described = hashlib.sha256((session.folder / "session.toml").read_bytes()).hexdigest()
    made = replace(measurement, inputs={"session.toml": described})
    assert pipeline.is_of_now(made, session)
    pipeline.capture(session, "background", {"left": DOT})
    assert not pipeline.is_of_now(made, pipeline.load(session.folder))
    with (session.folder / "session.toml").open("a", encoding="utf-8") as file:
        file.write("# another word\n")
    assert not pipeline.is_of_now(made, session)


def test_results_hold_until_a_view_is_taken_out_and_again_when_it_is_back(
    session: Session,
) -> None:
    out = pipeline.exclude(session, "board/001", "blurred")
    assert calibration_of(out) is None
    back = pipeline.exclude(out, "board/001", None)
    assert calibration_of(back) is not None
    stem = next(iter(session.shaft))
    out = pipeline.exclude(back, f"shaft/{stem}", "a hand")
    assert measurement_of(out) is None
    assert measurement_of(pipeline.exclude(out, f"shaft/{stem}", None)) is not None


def test_a_board_view_that_is_taken_out_is_rejected_unlooked_at(session: Session) -> None:
    out = pipeline.exclude(session, "board/001", "blurred")
    found = corners(read(out.board_views["001"]["left"]), out, (4, 4))
    assert isinstance(found, RejectedView)
    assert (found.camera, found.view) == ("left", "board/001")
    assert found.reason == "excluded by hand: blurred"


def test_results_made_without_an_excluded_view_hold(
    session: Session, measurement: Measurement
) -> None:
    calibration = calibration_of(session)
    assert calibration is not None
    reason = "excluded by hand: blurred"
    lost = [RejectedView(name, "board/001", reason) for name in session.cameras]
    without = replace(calibration, rejected=(*calibration.rejected, *lost))
    write_file(session.folder / "results" / "rig.json", rig_text(without, software="x"))
    out = pipeline.exclude(session, "board/001", "blurred")
    assert calibration_of(out) is not None
    first, *rest = measurement.poses
    gone = RejectedPose(first.pose, "excluded by hand: a hand", "take it back", first.edges)
    made = replace(measurement, poses=(gone, *rest))
    assert not pipeline.is_of_now(made, out)
    assert pipeline.is_of_now(made, pipeline.exclude(out, f"shaft/{first.pose}", "a hand"))


@pytest.mark.parametrize("name", ["rig.json", "result.json"])
@pytest.mark.parametrize("content", ["", "{", "[]", '{"schema": "pivometer/rig/9"}', "\x00"])
def test_spoilt_results_do_not_hold(session: Session, name: str, content: str) -> None:
    write_file(session.folder / "results" / name, content)
    assert measurement_of(session) is None


def test_the_view_that_fits_worst_comes_first(measurement: Measurement) -> None:
    calibration = measurement.calibration
    assert isinstance(calibration, Calibration)
    rig, board = calibration.rig, calibration.board
    views = []
    for number in range(3):
        pose = RigidTransform.from_rotation_vector(
            [0.2 * number, -0.7, 0.1], [-60.0, -40.0, 480.0 + 10 * number]
        )
        for camera, place in zip(rig.cameras, rig.reference_from_camera, strict=True):
            pixels = camera.project(place.inverse() @ (pose @ board.corners_mm))
            if number == 1:
                pixels = pixels + np.random.default_rng(0).normal(0, 0.5, pixels.shape)
            sigma = np.full(len(pixels), 0.05)
            name = f"board/{number}"
            views.append(BoardView(camera.name, name, np.arange(len(pixels)), pixels, sigma))
    alone = replace(views[0], view="intrinsics/left/0")
    known = pipeline.view_qualities(replace(calibration, views=(*views, alone)))
    assert known[0].view == "board/1"
    assert known[0].rms_mm > 0.05
    assert [one.rms_mm for one in known[1:]] == pytest.approx([0, 0, 0], abs=1e-6)
    assert {one.view: one.cameras for one in known}["intrinsics/left/0"] == ("left",)


def test_devices_are_shown_with_a_picture_where_they_give_one(monkeypatch) -> None:
    class Fake:
        def __init__(self, text: str) -> None:
            self.text = text

        def read(self) -> Frame:
            if self.text == "device 1":
                raise ImageError("no picture", next_step="-")
            return Frame(np.full((30, 40), 9, np.uint8), 0.0, 0)

        def close(self) -> None:
            pass

    monkeypatch.setattr(watching, "open_source", Fake)
    shown = pipeline.device_thumbnails(["device 0", "device 1"])
    assert list(shown) == ["device 0"]
    assert shown["device 0"].startswith("data:image/jpeg;base64,")


def test_a_camera_check_says_what_to_mend() -> None:
    rng = np.random.default_rng(0)
    board = np.kron(np.indices((12, 16)).sum(axis=0) % 2, np.ones((40, 40))) * 150 + 40
    sharp = np.clip(board + rng.normal(0, 2, board.shape), 0, 255).astype(np.uint8)
    good = watching.check_camera("left", sharp, 15.0)
    assert good.faults == ()
    assert good.size == (640, 480)
    dull = watching.cv2.GaussianBlur(sharp, None, 4.0)
    for image, rate, says in (
        (dull, 15.0, "out of focus"),
        (np.where(sharp > 100, 255, sharp).astype(np.uint8), 15.0, "overexposed: 50 %"),
        (np.zeros((480, 640), np.uint8), 15.0, "no edge at all"),
        (sharp, 2.0, "only 2.0 pictures a second"),
    ):
        assert any(says in fault for fault in watching.check_camera("left", image, rate).faults)


def test_the_live_drawings_hold_what_they_show() -> None:
    tilted = np.radians([[0, 0], [10, 0], [20, 120], [25, 240]])
    directions = np.stack(
        [
            np.sin(tilted[:, 0]) * np.cos(tilted[:, 1]),
            np.sin(tilted[:, 0]) * np.sin(tilted[:, 1]),
            np.cos(tilted[:, 0]),
        ],
        axis=1,
    )
    drawn = pose_map(directions, now=directions[1])
    assert drawn.count('class="have"') == 4
    assert drawn.count('class="next"') == 3
    assert drawn.count('class="now"') == 1
    assert "57°" in drawn
    assert pose_map(directions[:1]).count('class="have"') == 1
    chart = shrinking_chart([3, 4, 6], [0.2, 0.15, 0.1])
    assert chart.count("<circle") == 3
    assert "from 3 to 6 poses" in chart
