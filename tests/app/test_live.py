"""What the app is told of live pictures, and what its threads do with them."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from pivometer import pipeline
from pivometer.app.feeds import CYAN, Feed, Mark, preview, same_moment
from pivometer.app.watcher import HOLD_S, Watcher
from pivometer.app.work import Work
from pivometer.errors import ImageError
from pivometer.io.images import write_image
from pivometer.io.live import Frame


class Scripted:
    """A source that gives listed frames, then waits, or is pulled."""

    def __init__(self, frames: list[Frame], *, pulled: bool = False) -> None:
        self.frames, self.pulled, self.closed = list(frames), pulled, False

    def read(self) -> Frame:
        if self.frames:
            return self.frames.pop(0)
        if self.pulled:
            raise ImageError("gives no more pictures", next_step="check its plug")
        time.sleep(0.01)
        return Frame(np.zeros((4, 4), np.uint8), 1e9, 10**6)

    def close(self) -> None:
        self.closed = True


def frames(times: list[float], level: int = 0) -> list[Frame]:
    return [Frame(np.full((48, 64), level, np.uint8), t, i) for i, t in enumerate(times)]


def wait_for(condition) -> None:
    end = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_a_camera_that_is_pulled_is_told_and_its_source_given_back() -> None:
    source = Scripted(frames([0.0, 0.1]), pulled=True)
    feed = Feed("left", source)
    wait_for(lambda: feed.fault is not None)
    assert "check its plug" in str(feed.fault)
    assert feed.rate_hz == 0
    wait_for(lambda: source.closed)
    assert same_moment({"left": feed}) is None
    feed.close()


def test_the_frames_nearest_in_time_are_of_one_moment() -> None:
    left = Feed("left", Scripted(frames([0.0, 0.1, 0.2, 0.3]), pulled=True))
    right = Feed("right", Scripted(frames([0.04, 0.16]), pulled=True))
    wait_for(lambda: left.fault and right.fault)
    left.fault = right.fault = None  # as it was a moment before
    moment = same_moment({"left": left, "right": right})
    assert moment is not None
    assert (moment["right"].time_s, moment["left"].time_s) == (0.16, 0.2)


def test_a_preview_is_small_eight_bit_and_shows_the_marks() -> None:
    image = np.full((2048, 2448), 30000, dtype=np.uint16)
    mark = Mark(np.array([[100.0, 1024.0], [2300.0, 1024.0]]), "line", CYAN)
    shown = cv2.imdecode(np.frombuffer(preview(image, [mark]), np.uint8), cv2.IMREAD_COLOR)
    assert shown.shape == (682, 816, 3)  # a third of both sides
    assert np.abs(shown[341, 400].astype(int) - CYAN).max() < 25
    assert np.abs(shown[200, 400].astype(int) - 30000 / 256).max() < 6
    far = Mark(np.array([[np.nan, 0.0], [1e12, 5.0]]))
    assert preview(image, [far])  # nonsense is left out, not drawn


def test_only_a_scene_that_rests_and_is_another_than_before_is_worth_a_picture(
    tmp_path: Path,
) -> None:
    watcher = Watcher(Work(tmp_path))
    rng = np.random.default_rng(1)

    def feel(level: int, at: float) -> bool:
        image = np.full((240, 320), 60, np.uint8)
        cv2.rectangle(image, (level, 60), (level + 60, 200), 200, -1)
        noisy = np.clip(image + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)
        still = watcher._feel({"left": Frame(noisy, at, 0)})
        if still:
            watcher.captured()
        return still

    steps = [0.1 * i for i in range(8)]
    at_rest = [feel(100, t) for t in steps]
    assert at_rest == [t - steps[0] >= HOLD_S for t in steps][:5] + [False] * 3  # taken once
    moving = [feel(100 + 3 * i, 1.0 + 0.1 * i) for i in range(8)]
    assert not any(moving)  # 3 px a frame, under noise of 3 grey levels
    assert [feel(124, 2.0 + 0.1 * i) for i in range(6)].count(True) == 1


@pytest.fixture
def boards(tmp_path: Path) -> Path:
    board = np.full((480, 640), 230, np.uint8)
    for row in range(7):
        for column in range(9):
            if (row + column) % 2 == 0:
                board[60 + 50 * row : 110 + 50 * row, 95 + 50 * column : 145 + 50 * column] = 25
    for number in range(3):
        turn = cv2.getRotationMatrix2D((320, 240), 25.0 * number, 0.75)
        shown = cv2.warpAffine(board, turn, (640, 480), borderValue=230)
        for name in ("left", "right"):
            write_image(tmp_path / "play" / name / f"{number}.png", shown)
    return tmp_path / "play"


def test_every_picture_is_on_the_disk_before_it_is_counted(
    boards: Path, tmp_path: Path, monkeypatch
) -> None:
    from pivometer.app.board_task import BoardTask
    from pivometer.calibration import Board
    from pivometer.io.settings import Settings
    from pivometer.io.sources import PlayedImages

    folder = tmp_path / "session"
    names = ("left", "right")
    board = Board("checkerboard", (9, 7), 10.0)
    pipeline.describe(folder, Settings(board, None, names, "left", {}, {}, ""))
    work = Work(folder)
    watcher = Watcher(work)
    task = BoardTask(work, watcher)
    task.prepare()
    assert task.gathering is not None
    assert task.gathering.shared.views == 0
    source = PlayedImages(boards / "left", 1000.0, time.monotonic())
    frame = source.read()
    moment = dict.fromkeys(names, frame)

    order: list[str] = []
    write, count = pipeline.capture, task.count
    monkeypatch.setattr(pipeline, "capture", lambda *a: (order.append("written"), write(*a))[1])
    monkeypatch.setattr(task, "count", lambda: (order.append("counted"), count())[1])
    task.look(moment, still=True)
    assert order == ["written", "counted"]
    assert task.gathering.shared.views == 1
    task.look(moment, still=True)  # says nothing new
    assert order == ["written", "counted"]

    # The folder is the only truth: another process knows as much.
    again = BoardTask(Work(folder), watcher)
    again.prepare()
    assert again.gathering is not None
    assert again.gathering.shared == task.gathering.shared
    monkeypatch.undo()

    # A picture that was cut off is not counted, and stops nothing.
    whole = (folder / "board" / "left" / "000.png").read_bytes()
    for name in names:
        (folder / "board" / name / "001.png").write_bytes(whole[:-20])
    again.count()
    assert again.gathering.shared.views == 1

    # A view that is taken out is not counted any more; its pictures stay.
    pipeline.exclude(pipeline.load(folder), "board/000", "too near")
    again.count()
    assert again.gathering.shared.views == 0
    assert (folder / "board" / "left" / "000.png").is_file()


def test_a_task_that_fails_is_told_and_not_tried_for_ever(tmp_path: Path) -> None:
    class Failing:
        calls = 0

        def prepare(self) -> None:
            self.calls += 1
            raise ImageError("is cut off", next_step="copy it again")

        def look(self, *_: object) -> None:
            raise AssertionError

    watcher, task = Watcher(Work(tmp_path)), Failing()
    watcher.set_task(task)
    for _ in range(5):
        watcher._step_or_tell()
    assert task.calls == 1
    assert "is cut off" in watcher.told()
    assert watcher.told() == ""


def test_a_watcher_that_dies_says_so(tmp_path: Path, monkeypatch) -> None:
    watcher = Watcher(Work(tmp_path))

    def broken() -> bool:
        raise KeyError("what nobody foresaw")

    monkeypatch.setattr(watcher, "_step", broken)
    with pytest.raises(KeyError):
        watcher.run()
    assert "start the app again" in watcher.told()
