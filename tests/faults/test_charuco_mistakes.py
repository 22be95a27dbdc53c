"""ChArUco boards printed inverted, and pictures taken in a mirror."""

import cv2
import numpy as np
import pytest

import pivometer
from pivometer.calibration import Board, find_corners
from pivometer.calibration.diagnosis import shows_inverted
from pivometer.errors import CalibrationError

BOARD = Board("charuco", (6, 5), 20.0, None, "DICT_4X4_50", 15.0)


def picture() -> np.ndarray:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    pattern = cv2.aruco.CharucoBoard((6, 5), 20.0, 15.0, dictionary)
    image = pattern.generateImage((480, 400), marginSize=0).astype(np.float64)
    image = np.pad(40 + 0.7 * image, 40, constant_values=200)
    return cv2.GaussianBlur(image, (0, 0), 1.0).astype(np.uint8)


@pytest.mark.parametrize("inverted", [False, True])
def test_an_inverted_board_is_found_and_recognised(inverted):
    image = 255 - picture() if inverted else picture()
    view = find_corners(image, BOARD, camera="left", view="board/000")
    assert len(view.ids) == BOARD.corner_count
    assert shows_inverted(image, view, BOARD) is inverted


def test_mirrored_markers_are_told_with_their_files(tmp_path):
    root = tmp_path / "session"
    for camera in ("left", "right"):
        folder = root / "board" / camera
        folder.mkdir(parents=True)
        for number in range(3):
            image = picture() if camera == "left" else picture()[:, ::-1]
            cv2.imwrite(str(folder / f"{number:03d}.png"), image)
    (root / "session.toml").write_text(
        '[board]\nkind = "charuco"\nsquares = [6, 5]\nsquare_mm = 20.0\n'
        'dictionary = "DICT_4X4_50"\nmarker_mm = 15.0\n'
    )
    with pytest.raises(CalibrationError, match="images of camera right are mirrored") as caught:
        pivometer.calibrate(pivometer.load(root))
    assert "board/right/000.png" in caught.value.what
