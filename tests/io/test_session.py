import unicodedata
from collections.abc import Callable
from pathlib import Path

import pytest

from pivometer.errors import SessionError
from pivometer.io.session import load, natural_order

MakeSession = Callable[..., Path]
BOARD = '[board]\nkind = "checkerboard"\nsquares = [9, 7]\nsquare_mm = 15.0\n'


def test_a_session_lists_its_images_by_moment(make_session: MakeSession) -> None:
    session = load(make_session())
    assert session.cameras == ("left", "right")
    assert session.reference == "left"
    assert list(session.shaft) == ["000", "001"]
    assert session.shaft["001"]["right"].path.read_bytes()
    assert session.shaft["001"]["right"].name == "shaft/right/001.png"
    assert session.shaft["001"]["right"].view == "shaft/001"
    assert [image.view for image in session.shaft_images("left")] == ["shaft/000", "shaft/001"]
    assert session.board.squares == (9, 7)
    assert session.diameter_mm is None
    assert session.notes == ""


def test_board_images_are_shared_views_then_single_ones(make_session: MakeSession) -> None:
    board = ("board/l/0.png", "board/r/0.png", "intrinsics/r/0.png")
    root = make_session(images=(*board, "shaft/l/0.png", "shaft/r/0.png", "background/l/e.png"))
    session = load(root)
    assert [(image.camera, image.view) for image in session.board_images()] == [
        ("l", "board/0"),
        ("r", "board/0"),
        ("r", "intrinsics/r/0"),
    ]
    assert [image.view for image in session.background_images("l")] == ["background/l/e"]
    assert list(session.background_images("r")) == []


def test_every_key_of_session_toml_arrives(make_session: MakeSession) -> None:
    toml = (
        'notes = "first"\n[board]\nkind = "charuco"\nsquares = [5, 4]\nsquare_mm = 20\n'
        'square_u_mm = 0.01\ndictionary = "DICT_4X4_50"\nmarker_mm = 15.0\n'
        '[shaft]\ndiameter_mm = 10\n[cameras]\nnames = ["left", "right"]\nreference = "right"\n'
        '[device]\nserial = "A1"\ncalibrated = 2026-01-31\n[operator]\nname = "Ø"\n'
    )
    session = load(make_session(toml))
    assert session.cameras == ("right", "left")
    assert (session.board.kind, session.board.dictionary) == ("charuco", "DICT_4X4_50")
    assert (session.board.square_mm, session.board.square_u_mm) == (20, 0.01)
    assert session.board.marker_mm == 15.0
    assert session.diameter_mm == 10
    assert dict(session.device) == {"serial": "A1", "calibrated": "2026-01-31"}
    assert dict(session.operator) == {"name": "Ø"}
    assert session.notes == "first"


def test_without_a_stated_reference_the_alphabet_decides(make_session: MakeSession) -> None:
    toml = BOARD + '[cameras]\nnames = ["right", "left"]\n'
    assert load(make_session(toml)).cameras == ("left", "right")


def test_a_byte_order_mark_is_no_mistake(make_session: MakeSession) -> None:
    assert load(make_session("\ufeff" + BOARD)).board.square_mm == 15.0


def test_a_session_without_shaft_can_still_be_calibrated(make_session: MakeSession) -> None:
    session = load(make_session(images=("board/a/0.png", "board/b/0.png")))
    assert session.cameras == ("a", "b")
    session.require("board")
    with pytest.raises(SessionError, match="no shaft images in this session"):
        session.require("shaft")


def test_a_pose_of_one_camera_only_is_kept(make_session: MakeSession) -> None:
    root = make_session(images=("shaft/a/0.png", "shaft/a/1.png", "shaft/b/1.png"))
    session = load(root)
    assert {pose: list(images) for pose, images in session.shaft.items()} == {
        "0": ["a"],
        "1": ["a", "b"],
    }


def test_poses_stand_in_natural_order(make_session: MakeSession) -> None:
    names = ["pose10", "pose9", "pose1"]
    root = make_session(images=tuple(f"shaft/{c}/{n}.png" for c in "ab" for n in names))
    assert list(load(root).shaft) == ["pose1", "pose9", "pose10"]
    assert sorted(["b2", "b10", "a", "B1", "", "7"], key=natural_order) == [
        "",
        "7",
        "a",
        "B1",
        "b2",
        "b10",
    ]


def test_clutter_is_passed_over_and_other_files_are_named(make_session: MakeSession) -> None:
    root = make_session()
    for name in (".DS_Store", "Thumbs.db", "desktop.ini", "._000.png", "notes.txt", "clip.mp4"):
        (root / "shaft/left" / name).write_bytes(b"?")
    (root / "shaft/left/old").mkdir()
    (root / "shaft/.cache").mkdir()
    session = load(root)
    assert list(session.shaft) == ["000", "001"]
    assert session.ignored == (
        "shaft/left/clip.mp4",
        "shaft/left/notes.txt",
        "shaft/left/old",
    )


@pytest.mark.parametrize("ending", ["PNG", "JPG", "jpeg", "Tif", "tiff", "bmp", "pgm", "webp"])
def test_endings_in_any_case(make_session: MakeSession, ending: str) -> None:
    root = make_session(images=(f"shaft/a/0.{ending}", f"shaft/b/0.{ending}"))
    assert len(load(root).shaft["0"]) == 2


def test_names_spelled_with_composed_and_with_combining_accents_match(
    make_session: MakeSession,
) -> None:
    left, right = unicodedata.normalize("NFC", "é"), unicodedata.normalize("NFD", "é")
    root = make_session(images=(f"shaft/a/{left}.png", f"shaft/b/{right}.png"))
    assert {pose: list(images) for pose, images in load(root).shaft.items()} == {left: ["a", "b"]}


def test_a_linked_session_and_a_linked_camera_folder(
    make_session: MakeSession, tmp_path: Path
) -> None:
    root = make_session(images=("shaft/a/0.png", "elsewhere/0.png"))
    (root / "shaft/b").symlink_to(root / "elsewhere", target_is_directory=True)
    (tmp_path / "link").symlink_to(root, target_is_directory=True)
    assert list(load(tmp_path / "link").shaft["0"]) == ["a", "b"]


def test_listed_cameras_may_be_fewer_than_the_folders(make_session: MakeSession) -> None:
    toml = BOARD + '[cameras]\nnames = ["left", "right"]\n'
    root = make_session(toml)
    (root / "shaft/overview").mkdir()
    assert load(root).cameras == ("left", "right")
