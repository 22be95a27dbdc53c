"""Corners against exactly rendered boards, on real pictures, and what bad pictures get."""

import json
import math
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
import pytest

from pivometer._arrays import Floats
from pivometer.calibration import corners as module
from pivometer.calibration import saddles
from pivometer.calibration.board import Board
from pivometer.calibration.corners import find_corners
from pivometer.calibration.grid import fit_grid_map
from pivometer.calibration.seeds import Seeds
from pivometer.cameras import Camera
from pivometer.errors import BoardNotFoundError, ImageError, UsageError
from pivometer.geometry.rigid import RigidTransform

FINE = 4  # samples a pixel and axis
CHECKER = Board("checkerboard", (10, 7), 1.0)


@dataclass
class Scene:
    """A board seen through a homography; pixels bend to ideal points by a polynomial."""

    board: Board
    ideal_from_board: Floats
    size: tuple[int, int] = (320, 240)
    bend: float = 0.0  # ideal = middle + (pixel − middle)(1 + bend r²), r in half-widths
    cut: float = 1.0  # width of the outermost squares

    def ideal(self, pixels):
        middle = (np.array(self.size) - 1) / 2
        off = pixels - middle
        square = ((off / middle[0]) ** 2).sum(axis=-1, keepdims=True)
        return middle + off * (1 + self.bend * square)

    def corners(self):
        flat = self.board.corners_mm[:, :2] / self.board.square_mm
        target = (np.c_[flat, np.ones(len(flat))]) @ self.ideal_from_board.T
        target = target[:, :2] / target[:, 2:]
        pixels = target.copy()
        for _ in range(100):
            pixels -= self.ideal(pixels) - target
        return pixels

    def grid(self, pixels):
        ideal = self.ideal(pixels)
        ones = np.ones((*ideal.shape[:-1], 1))
        grid = np.concatenate([ideal, ones], axis=-1) @ np.linalg.inv(self.ideal_from_board).T
        return grid[..., :2] / grid[..., 2:]

    def render(self, blur, *, dark=40.0, bright=210.0, slope=0.0):
        """Fine samples that each hold their share of either colour, blurred and averaged."""
        width, height = self.size
        y, x = np.mgrid[0 : height * FINE, 0 : width * FINE]
        points = (np.stack([x, y], axis=-1) + 0.5) / FINE - 0.5
        grid = self.grid(points)
        limit = np.array(self.board.squares) - 2 + self.cut
        inside = ((grid > -self.cut) & (grid < limit)).all(axis=-1)
        crossing = np.ones(x.shape)
        for part in (grid[..., 0], grid[..., 1]):
            rise = np.hypot(*np.gradient(part))
            nearest = np.rint(part)
            share = np.clip(2 * (part - nearest) / rise, -1, 1)
            crossing *= np.where(nearest % 2, -share, share)
        fine = np.where(inside, (bright + dark) / 2 - (bright - dark) / 2 * crossing, bright)
        fine *= 1 + slope * (points[..., 0] / width - 0.5)
        fine = cv2.GaussianBlur(fine, (0, 0), blur * FINE)
        return fine.reshape(height, FINE, width, FINE).mean(axis=(1, 3))


def homography(board, *, tilt=(0.0, 0.0), turn=0.0, side=27.0, size=(320, 240)):
    """Board in squares to pixels: centred, turned in its plane, and tilted."""
    middle = np.array(board.inner_corners) / 2 - 0.5
    spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    affine = np.eye(3)
    affine[:2, :2] = spin * side
    affine[:2, 2] = -side * spin @ middle
    perspective = np.eye(3)
    perspective[2, :2] = np.array(tilt) / (side * 10)
    perspective[:2, :2] *= np.array([1 - abs(tilt[0]), 1 - abs(tilt[1])])[:, None]
    shift = np.eye(3)
    shift[:2, 2] = (np.array(size) - 1) / 2
    return shift @ perspective @ affine


def noisy(clean, noise, seed=0, kind=np.uint8):
    values = clean + np.random.default_rng(seed).normal(0, noise, clean.shape)
    return np.clip(np.rint(values), 0, np.iinfo(kind).max).astype(kind)


def found(image, board=CHECKER):
    return find_corners(image, board, camera="left", view="board/000")


@pytest.fixture(scope="module")
def tilted():
    return Scene(CHECKER, homography(CHECKER, tilt=(0.15, -0.1), turn=0.2, side=25), bend=0.03)


@pytest.mark.parametrize(
    ("blur", "noise", "limit"), [(0.7, 2, 0.0067), (1.5, 8, 0.032), (3.0, 2, 0.040)]
)
def test_error_is_at_the_noise_limit_and_the_stated_uncertainty_is_right(
    tilted, blur, noise, limit
):
    # the limits are those that design/calibration asks for; the ratio of error and stated
    # uncertainty has 108 degrees of freedom, hence a standard deviation of 0.07
    view = found(noisy(tilted.render(blur), noise))
    assert len(view.ids) == 54
    error = view.pixels - tilted.corners()
    assert np.sqrt((error**2).mean()) <= limit
    ratio = error / view.sigma_px[:, None]
    assert np.sqrt((ratio**2).mean()) == pytest.approx(1, abs=0.3)


@pytest.mark.parametrize("filters", [(1.0, 0.9, 0.9, 0.7), (1.0, 0.88, 0.88, 0.62)])
def test_corners_in_a_mosaic_of_filters_are_as_good_as_in_grey(tilted, filters):
    clean = tilted.render(0.7)
    white = np.tile(np.reshape(filters, (2, 2)), (120, 160))
    for black in (white, 1.0):  # filters and light of one colour each, or black as grey everywhere
        part = (clean - 40) / 170
        view = found(noisy(40 * black * (1 - part) + 210 * white * part, 2))
        error = view.pixels - tilted.corners()
        # the limit without filters, over the contrast that they leave: rms of their reciprocals
        contrast = (210 * np.array(filters) - 40) / 170
        assert np.sqrt((error**2).mean()) <= 0.0067 * np.sqrt((contrast**-2.0).mean())
        ratio = error / view.sigma_px[:, None]
        assert np.sqrt((ratio**2).mean()) == pytest.approx(1, abs=0.3)


def test_slow_light_and_bent_lines_do_not_move_corners():
    scene = Scene(CHECKER, homography(CHECKER, turn=-0.1), bend=0.06)
    image = np.rint(scene.render(0.8, slope=0.4) * 200).astype(np.uint16)
    error = found(image).pixels - scene.corners()
    # what is left without noise is the renderer's own: edges of fine samples are linear ramps
    assert np.abs(error.mean(axis=0)).max() < 0.001
    assert np.sqrt((error**2).mean()) < 0.003


def test_the_model_derivative_matches_differences():
    rng = np.random.default_rng(1)
    x, y = (part.ravel()[None] for part in np.meshgrid(np.arange(-6.0, 7), np.arange(-6.0, 7)))
    places = np.stack([np.ones_like(x), x, y], axis=1)
    pixels = saddles._Pixels(rng.uniform(0, 200, x.shape), places, np.ones(1))
    state = np.array([[0.3, -0.2, 0.1, 1.5, 1.2, 120.0, 0.002, -0.001, 80.0]])
    bend = np.zeros((1, 2))
    terms = saddles._terms(state, pixels, bend)
    jacobian = saddles._by_state(state, bend) @ terms[:, :9]
    for k in range(9):
        # so small that no pixel passes from one cell of the table of the step into the next
        step = np.eye(9)[k] * 1e-8 * max(1.0, abs(state[0, k]))
        after, before = (saddles._terms(state + s * step, pixels, bend)[:, 9] for s in (1, -1))
        numeric = -(after - before) / (2 * step[k])
        assert np.allclose(jacobian[:, k], numeric, atol=1e-4 * (1 + np.abs(numeric).max()))


def test_the_table_of_the_step_is_exact_to_a_millionth():
    distance = np.random.default_rng(2).uniform(-9, 9, 5000)
    steps, rises = saddles._step_table()
    place = distance * saddles.CELLS_PER_BLUR + saddles.TABLE_HALF
    cell = np.floor(place).astype(int).clip(0, len(steps) - 1)
    exact = np.array([math.erf(value / math.sqrt(2)) for value in distance])
    assert np.abs(steps[cell] + rises[cell] * (place - np.floor(place)) - exact).max() < 1e-6


def test_cut_outer_squares_do_not_pull_the_outer_corners():
    scene = Scene(CHECKER, homography(CHECKER, turn=0.1), cut=0.45)
    view = found(noisy(scene.render(0.8), 1))
    error = np.abs(view.pixels - scene.corners())
    assert len(view.ids) == 54
    assert error.max() < 5 * view.sigma_px.max() < 0.05


@pytest.mark.parametrize("quarter", range(4))
def test_an_odd_and_even_board_is_numbered_alike_from_every_side(quarter):
    board = Board("checkerboard", (8, 7), 1.0)
    scene = Scene(board, homography(board, turn=quarter * np.pi / 2 + 0.1))
    view = found(noisy(scene.render(0.8), 1), board)
    assert np.abs(view.pixels - scene.corners()[view.ids]).max() < 0.1


@pytest.mark.parametrize("squares", [(9, 7), (8, 8), (7, 7), (7, 9)])
def test_symmetric_boards_get_one_of_their_numberings(squares):
    board = Board("checkerboard", squares, 1.0)
    scene = Scene(board, homography(board, turn=2.0, side=22))
    view = found(noisy(scene.render(0.8), 1), board)
    errors = [
        np.abs(view.renumbered(symmetry).pixels - scene.corners()).max()
        for symmetry in board.symmetries
    ]
    assert min(errors) < 0.1


def test_a_transposed_description_is_the_same_board():
    scene = Scene(CHECKER, homography(CHECKER))
    image = noisy(scene.render(0.8), 1)
    transposed = Board("checkerboard", (7, 10), 1.0)
    view = found(image, transposed)
    one = view.pixels.reshape(9, 6, 2)
    right, below = one[0, 1] - one[0, 0], one[1, 0] - one[0, 0]
    assert right[0] * below[1] - right[1] * below[0] > 0
    other = scene.corners()[:, None] - view.pixels[None]
    assert (np.linalg.norm(other, axis=2).min(axis=1) < 0.1).all()


def test_a_third_of_wrong_corners_does_not_move_the_grid(tilted):
    truth = tilted.corners()
    places, wrong = CHECKER.columns_rows.astype(float), truth.copy()
    wrong[::3] += np.random.default_rng(0).uniform(-60, 60, wrong[::3].shape)
    grid = fit_grid_map(places, wrong, (240, 320))
    # a third of a pixel: the polynomial of the scene is not exactly the radial one of the map
    assert np.linalg.norm(grid.pixels(places) - truth, axis=1).max() < 0.3


def test_wrong_seeds_are_put_right(tilted):
    image, truth = noisy(tilted.render(0.8), 2), tilted.corners()
    seeds = truth + np.random.default_rng(3).normal(0, 0.7, truth.shape)
    seeds[[0, 8, 20, 31, 47]] += 8.0
    measured = module._measured(image, CHECKER, Seeds(np.arange(54), seeds))
    assert measured.good.all()
    assert np.abs(measured.fits.pixels - truth).max() < 0.05


def test_seeds_that_form_no_grid_are_no_hypothesis(tilted):
    image = noisy(tilted.render(0.8), 2)
    rng = np.random.default_rng(4)
    for _ in range(20):
        seeds = Seeds(np.arange(54), rng.uniform(0, 240, (54, 2)))
        measured = module._measured(image, CHECKER, seeds)
        assert measured is None or measured.good.mean() < 0.5


def test_covered_corners_are_dropped_and_too_many_refused(tilted):
    image, truth = noisy(tilted.render(0.8), 2), tilted.corners()
    seeds = Seeds(np.arange(54), truth)
    few, many = image.copy(), image.copy()
    cv2.circle(few, tuple(int(v) for v in truth[12]), 14, 120, -1)
    measured = module._measured(few, CHECKER, seeds)
    assert not measured.good[12]
    assert 45 <= measured.good.sum() < 54
    many[:, 120:] = 120
    measured = module._measured(many, CHECKER, seeds)
    with pytest.raises(BoardNotFoundError, match=r"54 of the 54 .* only \d+ are real"):
        module._check_count(measured, CHECKER, "board/000")


def test_dark_16_bit_and_large_images_work(tilted):
    dark = noisy(tilted.render(0.8) * 20, 8, kind=np.uint16)
    assert len(found(dark).ids) == 54
    large = cv2.resize(noisy(tilted.render(0.8), 1), None, fx=6, fy=6)
    view = found(large)
    expected = (tilted.corners() + 0.5) * 6 - 0.5
    assert len(view.ids) == 54
    assert np.abs(view.pixels - expected).max() < 0.5


def test_another_size_is_named_in_the_next_step():
    scene = Scene(CHECKER, homography(CHECKER, turn=0.1))
    with pytest.raises(BoardNotFoundError) as caught:
        found(noisy(scene.render(0.8), 1), Board("checkerboard", (9, 7), 1.0))
    assert "board of 10×7 squares; session.toml says 9×7" in caught.value.next_step


@pytest.mark.parametrize(
    ("image", "text"),
    [
        (np.full((120, 160), 5, np.uint8), "too little contrast"),
        (np.tile(np.linspace(0, 200, 160).astype(np.uint8), (120, 1)), "edges are"),
        (np.where(np.arange(160) < 80, 255, 0) * np.ones((120, 1)), "saturated"),
    ],
)
def test_a_picture_without_a_board_says_what_is_wrong_with_it(image, text):
    with pytest.raises(BoardNotFoundError, match=text):
        found(image.astype(np.uint8))


@pytest.mark.parametrize("image", [np.zeros((20, 20, 3), np.uint8), np.zeros((40, 40))])
def test_colour_and_float_images_are_refused(image):
    with pytest.raises(ImageError, match="shape"):
        found(image)


def charuco_image(board, scene_homography, size=(320, 240)):
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    pattern = cv2.aruco.CharucoBoard(board.squares, 1.0, board.marker_mm, dictionary)
    side = 96
    flat = pattern.generateImage((board.squares[0] * side, board.squares[1] * side))
    # fine pixel centre → square units, inner corner 0 at the origin
    square_from_flat = np.array(
        [[1 / side, 0, 0.5 / side - 1], [0, 1 / side, 0.5 / side - 1], [0, 0, 1]]
    )
    fine = np.array([[8.0, 0, 3.5], [0, 8.0, 3.5], [0, 0, 1]])
    warp = fine @ scene_homography @ square_from_flat
    shape = (size[0] * 8, size[1] * 8)
    image = cv2.warpPerspective(flat, warp, shape, flags=cv2.INTER_LINEAR, borderValue=255)
    image = cv2.GaussianBlur(image.astype(float), (0, 0), 0.8 * 8)
    return 30 + 0.7 * image.reshape(size[1], 8, size[0], 8).mean(axis=(1, 3))


@pytest.mark.parametrize("negative", [False, True])
def test_charuco_corners_keep_their_numbers_when_part_is_covered(negative):
    board = Board("charuco", (7, 5), 1.0, dictionary="DICT_4X4_50", marker_mm=0.7)
    matrix = homography(board, turn=2.5, side=36, tilt=(0.05, 0.05))
    clean = charuco_image(board, matrix)
    image = noisy(255 - clean if negative else clean, 2)
    truth = Scene(board, matrix).corners()
    view = found(image, board)
    assert len(view.ids) == board.corner_count
    error = view.pixels - truth
    assert np.sqrt((error**2).mean()) < 0.02
    image[:, :150] = 128
    part = found(image, board)
    assert 6 <= len(part.ids) < board.corner_count
    assert np.abs(part.pixels - truth[part.ids]).max() < 0.1


def test_an_unknown_dictionary_is_named():
    board = Board("charuco", (7, 5), 1.0, dictionary="DICT_9X9", marker_mm=0.7)
    with pytest.raises(UsageError, match="DICT_9X9"):
        found(np.zeros((60, 60), np.uint8), board)


def read(path):
    return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)


@pytest.mark.parametrize(
    ("name", "side"), list(product(["arm_black_clutter", "bearing_white"], ["left", "right"]))
)
def test_rendered_boards_are_all_found_where_they_are(shared_data, name, side):
    folder = shared_data / "rendered" / name
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    K, k = truth["cameras"][side]["K"], truth["cameras"][side]["dist_k1k2p1p2k3"]
    camera = Camera(side, 640, 480, [K[0][0], K[1][1]], [K[0][2], K[1][2]], k[:2])
    board = Board("checkerboard", (9, 7), 15.0)
    move = truth["stereo"]["x_right_eq_R_x_left_plus_t"]
    side_from_left = (
        RigidTransform.identity() if side == "left" else RigidTransform(move["R"], move["t_mm"])
    )
    errors = []
    for pose in truth["board_poses"]["stereo"][::3]:
        rotation, translation = (v for key, v in pose.items() if key != "index")
        side_from_board = side_from_left @ RigidTransform(rotation, translation)
        expected = camera.project(side_from_board @ board.corners_mm)
        view = found(read(folder / "board" / side / f"{pose['index']}.png"), board)
        assert len(view.ids) == 48
        each = [view.renumbered(turn).pixels - expected for turn in board.symmetries]
        errors.append(min(each, key=lambda error: float((error**2).mean())))
    # 0.0075 px measured over all 64 pictures of the two sets, the largest error 0.031 px
    assert np.sqrt((np.array(errors) ** 2).mean()) < 0.012
    assert np.abs(errors).max() < 0.06


def test_real_boards_repeat_under_added_noise(shared_data):
    differences = []
    for name in ("left02", "right05", "left09", "right13"):
        image = read(shared_data / "opencv_stereo" / f"{name}.jpg")
        first, second = found(image), found(noisy(image, 3))
        assert len(first.ids) == len(second.ids) == 54
        differences.append(first.pixels - second.pixels)
    # the design asks for 0.006 px over the whole set (0.0057 measured); four pictures scatter
    assert np.sqrt(np.mean(np.square(differences))) < 0.0075
