"""The shaft in all frames of a camera: from image files or from a video."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pivometer.cameras import Camera
from pivometer.errors import CalibrationError, ImageError, SessionError, ShaftNotFoundError
from pivometer.io.session import Session, load
from pivometer.pipeline import shafts
from pivometer.pipeline.shafts import camera_shafts, moved_camera
from pivometer.shaft.backdrop import backdrop_of
from pivometer.shaft.edges import ShaftEdges
from pivometer.shaft.hint import ShaftHint

CAMERA = Camera("left", 320, 240, [400, 400], [160, 120], [0, 0])
TOML = '[board]\nkind = "checkerboard"\nsquares = [9, 7]\nsquare_mm = 15.0\n'
PIVOT = (160, 220)


def frame(place: int, *, width: int = 14) -> NDArray[np.uint8]:
    """Draw a bright shaft that turns about PIVOT; `place` is where it leaves the image above."""
    image = np.full((240, 320), 20, dtype=np.uint8)
    return np.asarray(cv2.line(image, PIVOT, (place, 0), 200, width, cv2.LINE_AA), dtype=np.uint8)


FRAMES = [frame(x) for x in (70, 100, 130, 190, 220, 250)]


def write_images(root: Path, camera: str, frames: list[NDArray[np.uint8]]) -> None:
    folder = root / "shaft" / camera
    folder.mkdir(parents=True)
    for number, image in enumerate(frames):
        cv2.imwrite(str(folder / f"{number}.png"), image)


def write_video(file: Path, frames: list[NDArray[np.uint8]]) -> None:
    """Write a video, .avi and .mkv without loss, so that its frames are those of the images."""
    file.parent.mkdir(parents=True, exist_ok=True)
    codec = {".avi": "MPNG", ".mkv": "FFV1", ".mp4": "mp4v"}[file.suffix]
    video = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*codec), 10, (320, 240))
    assert video.isOpened()
    for image in frames:
        video.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    video.release()


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "session.toml").write_text(TOML, encoding="utf-8")
    return tmp_path


def edges_of(root: Path, hint: ShaftHint | None = None) -> dict[str, ShaftEdges]:
    seen = camera_shafts(load(root), CAMERA, hint=hint, progress=None).edges
    return {pose: edges for pose, edges in seen.items() if isinstance(edges, ShaftEdges)}


def video_session(root: Path, counts: tuple[int, int] = (6, 6), kind: str = "avi") -> Path:
    for camera, count in zip(("left", "right"), counts, strict=True):
        write_video(root / f"shaft/{camera}.{kind}", FRAMES[:count])
    return root


def image_session(root: Path, frames: list[NDArray[np.uint8]]) -> Path:
    for camera in ("left", "right"):
        write_images(root, camera, frames)
    return root


@pytest.mark.parametrize("kind", ["avi", "mkv", "mp4"])
def test_a_video_gives_what_its_frames_give(kind: str, root: Path, tmp_path_factory) -> None:
    folder = tmp_path_factory.mktemp("images")
    (folder / "session.toml").write_text(TOML, encoding="utf-8")
    one, two = edges_of(video_session(root, kind=kind)), edges_of(image_session(folder, FRAMES))
    assert list(one) == list(two) == ["0", "1", "2", "3", "4", "5"]
    allowed = 0.5 / 400 if kind == "mp4" else 0.0  # a lossy frame is the same to half a pixel
    for pose, edges in one.items():
        mine, other = (np.sort(x.normals, axis=0) for x in (edges, two[pose]))  # in either order
        assert np.abs(mine - other).max() <= allowed


def test_the_second_pass_reads_again_what_was_not_kept(root: Path, monkeypatch) -> None:
    monkeypatch.setattr(shafts, "KEPT_BYTES", FRAMES[0].nbytes)
    assert len(edges_of(video_session(root))) == 6


def test_frames_beyond_the_samples_are_found(root: Path, monkeypatch) -> None:
    monkeypatch.setattr(shafts, "MOST_SAMPLES", 4)
    assert len(edges_of(image_session(root, FRAMES))) == 6


def test_the_video_is_an_input(root: Path) -> None:
    import hashlib

    seen = camera_shafts(load(video_session(root)), CAMERA, hint=None, progress=None)
    digest = hashlib.sha256((root / "shaft/left.avi").read_bytes()).hexdigest()
    assert seen.inputs == {"shaft/left.avi": digest}


def test_videos_of_different_lengths_are_refused(root: Path) -> None:
    with pytest.raises(SessionError, match=r"left\.avi 6, right\.avi 5"):
        load(video_session(root, (6, 5)))


def test_a_video_beside_images_is_refused(root: Path) -> None:
    write_video(root / "shaft/left.avi", FRAMES)
    write_images(root, "right", FRAMES)
    with pytest.raises(SessionError, match="a video of one camera and images of another"):
        load(root)


def test_a_video_and_images_of_one_camera_are_refused(root: Path) -> None:
    image_session(root, FRAMES)
    write_video(root / "shaft/left.avi", FRAMES)
    with pytest.raises(SessionError, match=r"left\.avi and other frames of the same camera"):
        load(root)


def test_what_is_no_video_is_refused(root: Path) -> None:
    (video_session(root) / "shaft/right.avi").write_bytes(b"no video")
    with pytest.raises(SessionError, match="is no video that OpenCV reads"):
        load(root)


def test_a_video_that_ends_early_says_so_in_its_last_frames(root: Path) -> None:
    session = load(video_session(root))
    file = root / "shaft/left.avi"
    write_video(file, FRAMES[:4])
    seen = camera_shafts(session, CAMERA, hint=None, progress=None).edges
    late = [seen["4"], seen["5"]]
    assert all(isinstance(error, ImageError) for error in late)
    assert "no frame after number 3" in str(late[0])


def test_one_frame_is_found_with_a_hint_only(root: Path) -> None:
    image_session(root, FRAMES[:1])
    assert edges_of(root) == {}
    found = edges_of(root, ShaftHint(*PIVOT, 14))
    assert list(found) == ["0"]


def test_a_hint_chooses_between_two_that_turn(root: Path) -> None:
    thin = [frame(x, width=8)[:, ::-1] for x in (40, 290, 90, 240, 60, 200)]
    both = [np.maximum(f, np.roll(t, -60, axis=1)) for f, t in zip(FRAMES, thin, strict=True)]
    image_session(root, both)
    for x, width in ((PIVOT[0], 14.0), (319 - PIVOT[0] - 60, 8.0)):
        found = edges_of(root, ShaftHint(x, PIVOT[1], width))
        assert len(found) >= 5
        for edges in found.values():
            assert edges.width_px == pytest.approx(width, abs=1.5)


def test_hints_are_read_from_the_session(root: Path) -> None:
    image_session(root, FRAMES)
    toml = TOML + "[shaft.hint]\nleft = [160, 220, 14]\nright = [1.5, 2]\n"
    (root / "session.toml").write_text(toml, encoding="utf-8")
    hints = load(root).hints
    assert hints["left"] == ShaftHint(160, 220, 14)
    assert hints["right"].width_px is None


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("left = [1]", "for each camera the pixel about which the shaft turns"),
        ("left = [1, 2, -3]", "wants"),
        ("middle = [1, 2]", "'middle' is no camera; they are left, right"),
    ],
)
def test_a_wrong_hint_is_named(root: Path, line: str, message: str) -> None:
    image_session(root, FRAMES[:1])
    (root / "session.toml").write_text(f"{TOML}[shaft.hint]\n{line}\n", encoding="utf-8")
    with pytest.raises(SessionError, match=message):
        load(root)


def metal(place: int, room: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Draw a shaft as bright as the clutter behind it, brighter towards its axis."""
    image = room.copy()
    for width, grey in ((16, 90), (11, 110), (5, 130)):
        image = np.asarray(cv2.line(image, PIVOT, (place, 0), grey, width, cv2.LINE_AA))
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.7), dtype=np.uint8)


def test_what_stands_behind_the_shaft_is_found_out_once_and_only_where_needed(
    root: Path, tmp_path_factory, monkeypatch
) -> None:
    asked = []

    def counting(*given: object) -> object:
        asked.append(given)
        return backdrop_of(*given)

    monkeypatch.setattr(shafts, "backdrop_of", counting)
    assert len(edges_of(image_session(root, FRAMES))) == 6
    assert not asked  # flat levels before a plain background
    rng = np.random.default_rng(5)
    room = np.full((240, 320), 80, dtype=np.uint8)
    for _ in range(150):
        x, y = rng.integers(0, 320), rng.integers(0, 240)
        cv2.circle(room, (int(x), int(y)), int(rng.integers(3, 15)), int(rng.integers(20, 150)), -1)
    other = tmp_path_factory.mktemp("metal")
    (other / "session.toml").write_text(TOML, encoding="utf-8")
    frames = [metal(x, room) for x in range(15, 310, 13)]
    told = edges_of(image_session(other, frames))
    assert len(asked) == 1
    monkeypatch.setattr(shafts, "backdrop_of", lambda *_: None)
    untold = edges_of(other)
    assert told.keys() > untold.keys()  # where lanes may be the edges, nothing but that tells
    widths = [np.array([e.width_px for e in edges.values()]) for edges in (told, untold)]
    spread = [np.median(np.abs(w - np.median(w))) for w in widths]
    assert spread[0] < spread[1] / 2, spread


def before_scenery(frames: list[NDArray[np.uint8]], *, knocked_px: int) -> list[NDArray[np.uint8]]:
    """Draw a shaft before boxes, which the last half of the frames show elsewhere."""
    rng = np.random.default_rng(1)
    room = np.full((260, 340), 40, dtype=np.uint8)
    boxes = rng.uniform((0, 0, 8, 8, 20), (340, 260, 60, 60, 110), (60, 5)).astype(int)
    for x, y, w, h, grey in boxes.tolist():
        cv2.rectangle(room, (x, y), (x + w, y + h), grey, -1)
    room = cv2.GaussianBlur(room, (0, 0), 0.8)
    drawn = []
    for number, shaft in enumerate(frames):
        shift = 8 + (knocked_px if number >= len(frames) / 2 else 0)
        scene = room[:240, shift : shift + 320].astype(float)
        scene = np.where(shaft > 20, shaft, scene) + rng.normal(0, 1.0, scene.shape)
        drawn.append(np.clip(np.round(scene), 0, 255).astype(np.uint8))
    return drawn


PLACES = (70, 90, 110, 130, 190, 210, 230, 250)


@pytest.mark.parametrize("knocked_px", [0, 1])
def test_a_camera_that_is_knocked_is_told_from_the_scenery(knocked_px: int, root: Path) -> None:
    frames = [frame(x, width=18) for x in PLACES]
    session = load(image_session(root, before_scenery(frames, knocked_px=knocked_px)))
    seen = camera_shafts(session, CAMERA, hint=None, progress=None)
    assert any(isinstance(edges, ShaftEdges) for edges in seen.edges.values())
    moved = moved_camera(session, "left", seen.shifts_px)
    assert moved is not None
    assert moved.views == len(frames)
    assert moved.significant == bool(knocked_px)
    if knocked_px:
        assert (moved.before, moved.after) == ("shaft/3", "shaft/4")
        assert moved.shift_px == pytest.approx(knocked_px, abs=0.05)
    without = replace(session, excluded={"shaft/4": "taken out", "shaft/5": "taken out"})
    fewer = moved_camera(without, "left", seen.shifts_px)
    assert fewer is not None
    assert fewer.views == len(frames) - 2


def with_boards(root: Path, turn: Callable[[NDArray[np.uint8]], NDArray[np.uint8]]) -> Session:
    """Write a session whose board pictures show the same scenery, turned somehow."""
    image_session(root, before_scenery([frame(x, width=18) for x in PLACES], knocked_px=0))
    for camera in ("left", "right"):
        (root / "board" / camera).mkdir(parents=True)
        for number, board in enumerate(before_scenery([frame(160, width=50)] * 4, knocked_px=0)):
            cv2.imwrite(str(root / f"board/{camera}/{number}.png"), turn(board))
    return load(root)


def test_the_board_pictures_tell_a_knock_before_the_shaft_pictures(root: Path) -> None:
    session = with_boards(root, lambda board: np.roll(board, 1, axis=1))
    seen = camera_shafts(session, CAMERA, hint=None, progress=None)
    moved = moved_camera(session, "left", seen.shifts_px)
    assert moved is not None
    assert (moved.before, moved.after) == ("board/3", "shaft/0")
    assert moved.shift_px == pytest.approx(1, abs=0.05)


def test_board_pictures_that_are_mirrored_are_refused(root: Path) -> None:
    session = with_boards(root, lambda board: np.ascontiguousarray(board[:, ::-1]))
    with pytest.raises(CalibrationError, match="camera left are mirrored, left for right"):
        camera_shafts(session, CAMERA, hint=None, progress=None)


def test_if_nothing_can_be_told_since_the_camera_moved_that_is_the_reason(root: Path) -> None:
    frames = before_scenery([frame(x, width=10) for x in PLACES[:6]], knocked_px=12)
    with pytest.raises(ShaftNotFoundError, match=r"camera left moved by 12\.. px between shaft/2"):
        camera_shafts(load(image_session(root, frames)), CAMERA, hint=None, progress=None)
