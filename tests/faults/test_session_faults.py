"""Every way a session can be wrong before an image is looked at: what the user reads, and the code.

The texts are snapshots: who changes one reads it here first, as the user will.
"""

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from pivometer.cli import main
from pivometer.errors import SessionError
from pivometer.io.session import load

BOARD = '[board]\nkind = "checkerboard"\nsquares = [9, 7]\nsquare_mm = 15.0\n'
CHARUCO = '[board]\nkind = "charuco"\nsquares = [9, 7]\nsquare_mm = 15.0\n'
KEYS = {
    "unknown key": (
        BOARD.replace("square_mm", "square"),
        (
            "line 4: board.square: unknown key. Did you mean 'square_mm' (edge length of one "
            "square, mm)?"
        ),
    ),
    "key of another table": (
        BOARD + "diameter_mm = 10\n",
        (
            "line 5: board.diameter_mm: unknown key. Did you mean 'shaft.diameter_mm' (nominal "
            "diameter of the shaft, mm)?"
        ),
    ),
    "key outside its table": (
        "square_mm = 15\n" + BOARD,
        (
            "line 1: square_mm: unknown key. Did you mean 'board.square_mm' (edge length of one "
            "square, mm)?"
        ),
    ),
    "missing key": (
        BOARD.replace("square_mm = 15.0", ""),
        "board.square_mm: missing (edge length of one square, mm; a number above 0)",
    ),
    "unknown table": (
        BOARD + "[camera]\nnames = []\n",
        "line 5: camera: unknown key. Did you mean 'cameras' (the cameras)?",
    ),
    "key like no other": (
        BOARD + "colour = 1\n",
        (
            "line 5: board.colour: unknown key. Known here: kind, squares, square_mm, square_u_mm, "
            "dictionary, marker_mm, form"
        ),
    ),
    "text for a number": (
        BOARD.replace("15.0", '"15 mm"'),
        (
            'line 4: board.square_mm: is "15 mm", but wants a number above 0 (edge length of one '
            "square, mm)"
        ),
    ),
    "true for a number": (
        BOARD + "[shaft]\ndiameter_mm = true\n",
        (
            "line 6: shaft.diameter_mm: is true, but wants a number above 0 (nominal diameter of "
            "the shaft, mm)"
        ),
    ),
    "number below zero": (
        BOARD.replace("15.0", "-15.0"),
        (
            "line 4: board.square_mm: is -15.0, but wants a number above 0 (edge length of one "
            "square, mm)"
        ),
    ),
    "no number": (
        BOARD.replace("15.0", "nan"),
        (
            "line 4: board.square_mm: is nan, but wants a number above 0 (edge length of one "
            "square, mm)"
        ),
    ),
    "squares as text": (
        BOARD.replace("[9, 7]", '"9x7"'),
        (
            'line 3: board.squares: is "9x7", but wants two whole numbers of 3 or more, as in [9, '
            "7] (number of squares across and down, counting the outer ones)"
        ),
    ),
    "too few squares": (
        BOARD.replace("[9, 7]", "[9, 2]"),
        (
            "line 3: board.squares: is [9, 2], but wants two whole numbers of 3 or more, as in [9, "
            "7] (number of squares across and down, counting the outer ones)"
        ),
    ),
    "wrong kind": (
        BOARD.replace("checkerboard", "chessboard"),
        "line 2: board.kind: is \"chessboard\". Did you mean 'checkerboard'?",
    ),
    "ChArUco without markers": (
        CHARUCO,
        (
            "2 problems\n"
            "  board.dictionary: missing (ArUco dictionary of a ChArUco board)\n"
            "  board.marker_mm: missing (edge length of one ChArUco marker, mm)"
        ),
    ),
    "unknown dictionary": (
        CHARUCO + 'dictionary = "4x4_50"\nmarker_mm = 11.0\n',
        (
            'line 5: board.dictionary: is "4x4_50", no dictionary of OpenCV\'s. Did you mean '
            "'DICT_4X4_50'?"
        ),
    ),
    "marker above square": (
        CHARUCO + 'dictionary = "DICT_4X4_50"\nmarker_mm = 20.0\n',
        (
            "line 6: board.marker_mm: is 20.0, not below square_mm, 15.0 (edge length of one "
            "ChArUco marker, mm)"
        ),
    ),
    "marker on a checkerboard": (
        BOARD + "marker_mm = 11.0\n",
        (
            "line 5: board.marker_mm: has no meaning here (edge length of one ChArUco marker, mm); "
            'kind is "checkerboard"'
        ),
    ),
    "no board": (
        "",
        (
            'board: missing (the calibration board). Write [board] kind = "checkerboard", squares '
            "= [9, 7], square_mm = 15.0"
        ),
    ),
    "board not a table": (
        'board = "9x7"\n',
        'line 1: board: is "9x7", not a table (the calibration board); write [board]',
    ),
    "one camera listed": (
        BOARD + '[cameras]\nnames = ["left"]\n',
        "line 6: cameras.names: lists 1 camera; at least two must see the shaft",
    ),
    "a camera twice": (
        BOARD + '[cameras]\nnames = ["left", "right", "left"]\n',
        "line 6: cameras.names: lists 'left' twice",
    ),
    "reference not listed": (
        BOARD + '[cameras]\nnames = ["left", "right"]\nreference = "lefft"\n',
        "line 7: cameras.reference: is \"lefft\", which is not among names, ['left', 'right']",
    ),
    "reference without a folder": (
        BOARD + '[cameras]\nreference = "lefft"\n',
        "cameras.reference: 'lefft' is no camera; they are left, right. Did you mean 'left'?",
    ),
    "a path as a camera": (
        BOARD + '[cameras]\nnames = ["left", "../right"]\n',
        "line 6: cameras.names: '../right' is no folder name",
    ),
    "infinity in a free table": (
        BOARD + "[device]\nlimits = [1.0, inf]\n",
        "line 6: device.limits: is inf, not a number that a result can hold; put it in quotes",
    ),
    "notes not text": (
        "notes = 3\n" + BOARD,
        "line 1: notes: is 3, but wants text (free text)",
    ),
    "text without quotes": (
        BOARD.replace('"checkerboard"', "checkerboard"),
        "is not valid TOML: Invalid value (at line 2, column 8)",
    ),
}


def png() -> bytes:
    return bytes(cv2.imencode(".png", np.zeros((6, 8), np.uint8))[1].tobytes())


@pytest.fixture
def session(tmp_path: Path) -> Path:
    root = tmp_path / "session"
    for group in ("board", "shaft"):
        for camera in ("left", "right"):
            (root / group / camera).mkdir(parents=True)
            (root / group / camera / "000.png").write_bytes(png())
    (root / "session.toml").write_text(BOARD, encoding="utf-8")
    return root


@pytest.mark.parametrize("fault", KEYS)
def test_a_mistake_in_session_toml(fault: str, session: Path) -> None:
    toml, message = KEYS[fault]
    (session / "session.toml").write_text(toml, encoding="utf-8")
    with pytest.raises(SessionError) as caught:
        load(session)
    assert caught.value.what == message
    assert caught.value.path == session / "session.toml"
    assert caught.value.next_step


def spoil_by_removing(name: str) -> Callable[[Path], None]:
    def spoil(root: Path) -> None:
        path = root / name
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()

    return spoil


def spoil_by_renaming(name: str, new: str) -> Callable[[Path], None]:
    def spoil(root: Path) -> None:
        (root / name).rename(root / new)

    return spoil


def spoil_by_adding(name: str, content: bytes = b"") -> Callable[[Path], None]:
    def spoil(root: Path) -> None:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(content)

    return spoil


def only_one_camera(root: Path) -> None:
    for group in ("board", "shaft"):
        shutil.rmtree(root / group / "right")


def images_without_camera_folders(root: Path) -> None:
    for camera in ("left", "right"):
        shutil.rmtree(root / "shaft" / camera)
    (root / "shaft/000.png").write_bytes(png())


def no_groups(root: Path) -> None:
    shutil.rmtree(root / "board")
    (root / "shaft").rename(root / "shafts")


def listed_camera_missing(root: Path) -> None:
    toml = BOARD + '[cameras]\nnames = ["left", "top"]\n'
    (root / "session.toml").write_text(toml, encoding="utf-8")


FOLDERS = {
    "no session.toml": (
        spoil_by_removing("session.toml"),
        "",
        "is not a session: it has no session.toml",
        'write session.toml: [board] kind = "checkerboard", squares = [9, 7], square_mm = 15.0',
    ),
    "session.toml.txt": (
        spoil_by_renaming("session.toml", "session.toml.txt"),
        "",
        "is not a session: it has no session.toml",
        "rename session.toml.txt to session.toml",
    ),
    "neither shaft nor board": (
        no_groups,
        "",
        "has neither a folder shaft nor a folder board",
        "rename shafts, or put the images into shaft/<camera>/<pose>.png",
    ),
    "one camera": (
        only_one_camera,
        "shaft",
        "has only one camera folder, left; at least two cameras must see the shaft",
        (
            "put each camera's images into a folder of its own: shaft/left/000.png, "
            "shaft/right/000.png"
        ),
    ),
    "no camera folders": (
        images_without_camera_folders,
        "shaft",
        "has no camera folders; at least two cameras must see the shaft",
        (
            "put each camera's images into a folder of its own: shaft/left/000.png, "
            "shaft/right/000.png"
        ),
    ),
    "misspelled camera folder": (
        spoil_by_renaming("board/right", "board/rigth"),
        "board/rigth",
        "is the folder of no camera; the cameras are left, right",
        "rename it to right",
    ),
    "stray camera folder": (
        spoil_by_adding("intrinsics/top/0.png"),
        "intrinsics/top",
        "is the folder of no camera; the cameras are left, right",
        "rename or remove it, or list the cameras in session.toml: [cameras] names = [...]",
    ),
    "camera folder missing": (
        spoil_by_removing("board/right"),
        "board/right",
        "no such folder, but right is one of the cameras: left, right",
        "add the images of right, or correct [cameras] names in session.toml",
    ),
    "listed camera missing": (
        listed_camera_missing,
        "board/top",
        "no such folder, but top is one of the cameras: left, top",
        "add the images of top, or correct [cameras] names in session.toml",
    ),
    "one image twice": (
        spoil_by_adding("shaft/left/000.jpg"),
        "shaft/left",
        "holds two files for one image: 000.jpg and 000.png",
        "keep one of them, or give them different names",
    ),
    "session.toml not text": (
        spoil_by_adding("session.toml", b"notes = '\xff'"),
        "session.toml",
        "is not UTF-8 text (byte 9)",
        "save it as UTF-8",
    ),
}


@pytest.mark.parametrize("fault", FOLDERS)
def test_a_mistake_in_the_folders(fault: str, session: Path) -> None:
    spoil, place, message, next_step = FOLDERS[fault]
    spoil(session)
    with pytest.raises(SessionError) as caught:
        load(session)
    assert caught.value.what == message
    assert caught.value.next_step == next_step
    assert caught.value.path == session / place


def test_paths_that_are_no_session(session: Path) -> None:
    wrong = {
        session.parent / "sesion": ("no such folder", f"did you mean {session}?"),
        session.parent / "x" / "y": ("no such folder", "check the path"),
        session / "session.toml": ("is a file, not a session folder", f"name {session}"),
        session / "shaft": (
            "is not a session: it has no session.toml",
            f"name the folder above: {session}",
        ),
        session.parent: (
            "is not a session: it has no session.toml",
            "name a session in it: session",
        ),
    }
    for path, (message, next_step) in wrong.items():
        with pytest.raises(SessionError) as caught:
            load(path)
        assert (caught.value.what, caught.value.next_step) == (message, next_step)
        assert caught.value.path == path


@pytest.mark.parametrize("command", ["calibrate", "measure"])
def test_the_command_line_tells_it_and_exits_with_2(
    command: str, session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(session.rglob("*"))
    toml = BOARD.replace("square_mm", "square").replace("[9, 7]", "[9.0, 7.0]")
    (session / "session.toml").write_text(toml, encoding="utf-8")
    assert main([command, str(session)]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err == (
        f"error: {session / 'session.toml'}\n"
        "       2 problems\n"
        "         line 3: board.squares: is [9.0, 7.0], but wants two whole numbers of 3 or more, "
        "as in [9, 7] (number of squares across and down, counting the outer ones)\n"
        "         line 4: board.square: unknown key. Did you mean 'square_mm' (edge length of one "
        "square, mm)?\n"
        "next:  correct session.toml\n"
    )
    assert sorted(session.rglob("*")) == before


def test_no_image_is_touched_by_loading(session: Path) -> None:
    for path in session.rglob("*.png"):
        path.chmod(0o000)  # not even opened: reading comes later, image by image
    assert load(session).cameras == ("left", "right")
