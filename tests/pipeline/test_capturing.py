"""A session that grows in the app: what is written, what is refused, what the others honour."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from pivometer import pipeline
from pivometer.calibration import Board
from pivometer.errors import ImageError, SessionError, UsageError
from pivometer.io.images import read_image
from pivometer.io.session import Session
from pivometer.io.settings import MOST_BYTES, Settings, read_settings
from pivometer.pipeline import capturing

BOARD = Board("checkerboard", (9, 7), 15.02)
SETTINGS = Settings(
    BOARD,
    8.0,
    ("left", "right"),
    "right",
    {"name": 'a "quoted" \\ robot', "serial no": 7, "nested": {"on": True}},
    {"name": "Ω"},
    "two\nlines",
)


@pytest.fixture
def session(tmp_path: Path) -> Session:
    return pipeline.describe(tmp_path / "s", SETTINGS)


def png(level: int = 9) -> bytes:
    return cv2.imencode(".png", np.full((5, 7), level, np.uint8))[1].tobytes()


def test_a_description_is_read_as_it_was_said(session: Session) -> None:
    read = read_settings(session.folder / "session.toml")
    for name in ("device", "operator", "notes", "camera_names", "reference", "diameter_mm"):
        assert getattr(read, name) == getattr(SETTINGS, name)
    assert (str(read.board), read.board.form) == (str(BOARD), BOARD.form)
    assert session.cameras == ("right", "left")
    assert not session.shaft


def test_a_wrong_description_changes_nothing(session: Session) -> None:
    before = (session.folder / "session.toml").read_bytes()
    with pytest.raises(SessionError, match="lists 1 camera"):
        pipeline.describe(session.folder, replace(SETTINGS, camera_names=("right",)))
    with pytest.raises(SessionError, match="no folder name"):
        pipeline.describe(session.folder, replace(SETTINGS, camera_names=("right", "../x")))
    assert (session.folder / "session.toml").read_bytes() == before
    assert sorted(p.name for p in session.folder.iterdir()) == ["board", "session.toml", "shaft"]


def test_a_description_that_does_not_fit_the_pictures_changes_nothing(session: Session) -> None:
    pipeline.capture(session, "board", {"left": np.zeros((4, 4), np.uint8)})
    before = {path: path.is_file() and path.read_bytes() for path in session.folder.rglob("*")}
    with pytest.raises(SessionError, match="pictures of camera left, which is not among"):
        pipeline.describe(session.folder, replace(SETTINGS, camera_names=("right", "lefty")))
    assert {p: p.is_file() and p.read_bytes() for p in session.folder.rglob("*")} == before


def test_moments_are_numbered_on_and_keep_their_depth(session: Session) -> None:
    deep = np.array([[0, 65535], [1, 256]], dtype=np.uint16)
    assert pipeline.capture(session, "shaft", {"left": deep, "right": deep}) == "000"
    assert pipeline.capture(session, "shaft", {"left": deep}) == "001"
    (session.folder / "shaft" / "left" / "041.png").write_bytes(png())
    assert pipeline.capture(session, "shaft", {"right": deep}) == "042"
    assert (read_image(session.folder / "shaft" / "left" / "000.png") == deep).all()
    assert list(pipeline.load(session.folder).shaft) == ["000", "001", "041", "042"]
    assert not list(session.folder.rglob(".*"))


@pytest.mark.parametrize(
    "name",
    [
        "../x.png",
        "a/b.png",
        "..\\x.png",
        ".x.png",
        "x.png\0",
        "c:x.png",
        "x" * 99 + ".png",
        "/x.png",
    ],
)
def test_a_name_that_leads_elsewhere_is_refused(session: Session, name: str) -> None:
    with pytest.raises(UsageError, match="no plain file name"):
        pipeline.add_picture(session, "board", "left", name, png())
    assert not list(session.folder.parent.rglob("*.png"))


def test_what_is_no_picture_or_too_large_or_there_already_is_refused(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    add = pipeline.add_picture
    for group, camera in (("results", "left"), ("board", "middle"), ("../board", "left")):
        with pytest.raises(UsageError):
            add(session, group, camera, "0.png", png())
    for data in (b"", b"not an image", png()[:-9]):
        with pytest.raises(ImageError):
            add(session, "board", "left", "0.png", data)
    with pytest.raises(UsageError, match="no picture"):
        add(session, "board", "left", "0.py", png())
    monkeypatch.setattr(capturing, "MOST_PICTURE_BYTES", len(png()) - 1)
    with pytest.raises(ImageError, match="pictures up to"):
        add(session, "board", "left", "0.png", png())
    monkeypatch.undo()
    assert not list(session.folder.rglob("*.png"))
    add(session, "board", "left", "0.png", png())
    with pytest.raises(UsageError, match="already"):
        add(session, "board", "left", "0.tif", png())


def test_an_oversized_description_is_refused_unread(session: Session) -> None:
    with (session.folder / "session.toml").open("r+b") as file:
        file.truncate(MOST_BYTES + 1)
    with pytest.raises(SessionError, match="more than any session"):
        pipeline.load(session.folder)


def test_a_pose_that_the_table_of_poses_does_not_know_is_refused(session: Session) -> None:
    image = np.zeros((4, 4), np.uint8)
    pipeline.capture(session, "shaft", {"left": image, "right": image})
    (session.folder / "poses.csv").write_text("pose,q1_deg\n000,1.5\n", encoding="utf-8")
    session = pipeline.load(session.folder)
    for attempt in (
        lambda: pipeline.capture(session, "shaft", {"left": image}),
        lambda: pipeline.add_picture(session, "shaft", "left", "7.png", png()),
    ):
        with pytest.raises(UsageError, match=r"none named (001|7)"):
            attempt()
    assert list(pipeline.load(session.folder).shaft) == ["000"]
    assert pipeline.capture(session, "board", {"left": image}) == "000"


def test_brackets_without_end_are_refused(session: Session) -> None:
    (session.folder / "session.toml").write_text("a = " + "[" * 50_000, encoding="utf-8")
    with pytest.raises(SessionError, match=r"deeper than any|not valid TOML"):
        pipeline.load(session.folder)


def test_only_views_that_exist_are_excluded_and_come_back(session: Session) -> None:
    pipeline.capture(session, "shaft", {"left": np.zeros((4, 4), np.uint8)})
    session = pipeline.load(session.folder)
    with pytest.raises(UsageError, match="no view 'shaft/7'"):
        pipeline.exclude(session, "shaft/7", "why not")
    out = pipeline.exclude(session, "shaft/000", "a hand")
    assert out.excluded == {"shaft/000": "a hand"}
    assert list(out.shaft) == ["000"]  # still listed: an exclusion deletes nothing
    assert not pipeline.exclude(out, "shaft/000", None).excluded


def test_a_spoilt_note_of_the_sources_is_no_reason_to_stop(session: Session) -> None:
    pipeline.save_sources(session.folder, {"left": "device 0"}, rate_hz=12.5)
    assert pipeline.saved_sources(session.folder) == ({"left": "device 0"}, 12.5)
    for text in (
        "",
        "[",
        "[" * 100_000,
        '{"sources": 3, "rate_hz": "x"}',
        '{"rate_hz": -1}',
        "\xff",
    ):
        (session.folder / "sources.json").write_bytes(text.encode("latin-1"))
        assert pipeline.saved_sources(session.folder) == ({}, None)
