"""Calibration side by side with OpenCV: corners, held-out edges in mm, RCM location, cost.

Run with ``python benchmarks/calibration.py``. The columns differ in how corners are refined; the
OpenCV columns are calibrated by OpenCV's three calls (each camera, then the pair, two radial
coefficients), ours by the joint adjustment. Held-out edges are triangulated alike for all. Where a
column of OpenCV's numbers a symmetric board from the other end, it is given our numbering.
Data of others are looked for in ``PIVOMETER_DATA`` or ``../shared/data``; their rows are skipped
where they are absent. All times are from the same process: trust the ratios.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import pivometer
from pivometer import pipeline
from pivometer.calibration import Board, BoardView, calibrate_rig, find_corners
from pivometer.calibration.metric_scale import length_error, reconstructed_edges
from pivometer.calibration.quality import held_out_lengths
from pivometer.calibration.result import LengthError
from pivometer.calibration.seeds import board_hypotheses
from pivometer.cameras import Camera, Rig
from pivometer.errors import DataError
from pivometer.geometry import RigidTransform
from pivometer.simulation import simulate
from pivometer.uncertainty import lies_within

Image = NDArray[Any]
Find = Callable[[Image, Board, str, str], BoardView | None]

DATA = Path(os.environ.get("PIVOMETER_DATA", Path(__file__).parents[2] / "shared" / "data"))
A_BOARD = Board("checkerboard", (10, 7), 30.0)
A_BASELINE_MM, A_BASELINE_U_MM = 99.808, 0.142 / 3
"""Bouguet's toolbox on set A: |T| and its standard uncertainty (he states 3 sigma)."""
STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)


# --- Corners ---


def _view(pixels: Image | None, board: Board, camera: str, view: str) -> BoardView | None:
    if pixels is None:
        return None
    across, down = board.inner_corners
    grid = pixels.reshape(down, across, 2).astype(np.float64)
    (x1, y1), (x2, y2) = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if x1 * y2 - y1 * x2 < 0:
        grid = grid[:, ::-1]
    count = board.corner_count
    return BoardView(camera, view, np.arange(count), grid.reshape(-1, 2), np.full(count, 0.1))


def _classic(image: Image, board: Board, window: Callable[[Image], int]) -> Image | None:
    found, corners = cv2.findChessboardCorners(image, board.inner_corners)
    if not found:
        return None
    size = window(corners.reshape(board.inner_corners[1], board.inner_corners[0], 2))
    return np.asarray(cv2.cornerSubPix(image, corners, (size, size), (-1, -1), STOP))


def usual(image: Image, board: Board, camera: str, view: str) -> BoardView | None:
    """Refine as most tutorials do: cornerSubPix in a window of 11."""
    return _view(_classic(image, board, lambda _: 11), board, camera, view)


def scaled(image: Image, board: Board, camera: str, view: str) -> BoardView | None:
    """Use cornerSubPix in a window of 0.4 of the smallest square."""

    def window(grid: Image) -> int:
        sides = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1)]
        return max(2, int(0.4 * min(sides)))

    return _view(_classic(image, board, window), board, camera, view)


def sector(image: Image, board: Board, camera: str, view: str) -> BoardView | None:
    """Use findChessboardCornersSB, exhaustive and accurate."""
    flags = cv2.CALIB_CB_EXHAUSTIVE + cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(image, board.inner_corners, flags=flags)
    return _view(np.asarray(corners) if found else None, board, camera, view)


def ours(image: Image, board: Board, camera: str, view: str) -> BoardView | None:
    """Fit the saddle model."""
    try:
        return find_corners(image, board, camera=camera, view=view)
    except DataError:
        return None


METHODS: dict[str, Find] = {
    "usual recipe": usual,
    "scaled window": scaled,
    "SB": sector,
    "Pivometer": ours,
}


@dataclass
class Picture:
    """One board picture."""

    camera: str
    view: str
    image: Image


def all_corners(pictures: Sequence[Picture], board: Board) -> dict[str, list[BoardView]]:
    """Find the board by every method; all numbered as ours."""
    found: dict[str, list[BoardView]] = {name: [] for name in METHODS}
    for picture in pictures:
        model = ours(picture.image, board, picture.camera, picture.view)
        for name, find in METHODS.items():
            view = find(picture.image, board, picture.camera, picture.view)
            if view is not None and model is not None:
                found[name].append(_numbered_like(view, model, board))
    return found


def _numbered_like(view: BoardView, model: BoardView, board: Board) -> BoardView:
    def apart(turned: BoardView) -> float:
        _, a, b = np.intersect1d(turned.ids, model.ids, return_indices=True)
        return float(np.abs(turned.pixels[a] - model.pixels[b]).max())

    turns = [view.renumbered(np.roll(row, 0)) for row in board.symmetries]
    reverse = np.arange(board.corner_count)[::-1]
    return min([*turns, view.renumbered(reverse)], key=apart)


# --- OpenCV's three calls ---


def _f64(values: Any) -> NDArray[np.float64]:
    return np.array(values, dtype=np.float64)


def opencv_rig(views: Sequence[BoardView], board: Board, sizes: dict[str, tuple[int, int]]) -> Rig:
    """Calibrate each camera, then the pair with the cameras fixed; two radial coefficients."""
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    X = board.corners_mm.astype(np.float32)
    names = sorted(sizes)
    K, k = {}, {}
    for name in names:
        mine = [v for v in views if v.camera == name]
        _, K[name], k[name], _, _ = cv2.calibrateCamera(
            [X[v.ids] for v in mine],
            [v.pixels.astype(np.float32) for v in mine],
            sizes[name],
            None,
            None,
            flags=flags,
        )
    left, right = ({v.view: v for v in views if v.camera == name} for name in names)
    seen = [np.intersect1d(left[m].ids, right[m].ids) for m in left if m in right]
    moments = [m for m in left if m in right]

    def places(view: BoardView, ids: Image) -> Image:
        return view.pixels[np.searchsorted(view.ids, ids)].astype(np.float32)

    _, *_, R, T, _, _ = cv2.stereoCalibrate(
        [X[ids] for ids in seen],
        [places(left[m], ids) for m, ids in zip(moments, seen, strict=True)],
        [places(right[m], ids) for m, ids in zip(moments, seen, strict=True)],
        K[names[0]],
        k[names[0]],
        K[names[1]],
        k[names[1]],
        sizes[names[0]],
        flags=cv2.CALIB_FIX_INTRINSIC,
        criteria=STOP,
    )
    cameras = [
        Camera(
            n, *sizes[n], _f64([K[n][0, 0], K[n][1, 1]]), _f64(K[n][:2, 2]), _f64(k[n].ravel()[:2])
        )
        for n in names
    ]
    right_from_left = RigidTransform(_f64(R), _f64(T).ravel())
    return Rig(cameras, [RigidTransform.identity(), right_from_left.inverse()])


def opencv_held_out(
    views: Sequence[BoardView], board: Board, sizes: dict[str, tuple[int, int]]
) -> LengthError:
    """Return the error of edges held out of OpenCV's calls, in the same parts as ours."""

    def estimate(kept: Sequence[str]) -> Rig:
        return opencv_rig([v for v in views if v.view in set(kept)], board, sizes)

    return held_out_lengths(views, board, estimate).error(board.square_mm)


# --- Rows ---


@dataclass
class Row:
    """One line of the table; the target is for the last column."""

    what: str
    values: Sequence[float | None]
    target: str
    reached: bool | None
    digits: int = 3


def set_a() -> list[Picture]:
    """Return the pictures of the OpenCV stereo set, nothing where they are absent."""
    files = sorted((DATA / "opencv_stereo").glob("*.jpg"))
    return [
        Picture(name, f"board/{f.stem[-2:]}", np.asarray(cv2.imread(str(f), cv2.IMREAD_GRAYSCALE)))
        for f in files
        for name in ("left", "right")
        if f.stem.startswith(name)
    ]


def rows_of_a(pictures: Sequence[Picture]) -> list[Row]:
    """Held-out edges, repeatability and baseline on real pictures."""
    sizes = {"left": (640, 480), "right": (640, 480)}
    found = all_corners(pictures, A_BOARD)
    errors = [
        opencv_held_out(views, A_BOARD, sizes)
        for name, views in found.items()
        if name != "Pivometer"
    ]
    calibration = calibrate_rig(found["Pivometer"], A_BOARD, sizes, reference="left")
    errors.append(calibration.held_out)
    repeat = [repeatability(pictures, find) for find in METHODS.values()]
    baseline = float(calibration.rig.baselines_mm[0])
    shift = calibration.rig.reference_from_camera[1].translation_mm / baseline
    u = float(np.sqrt(shift @ calibration.covariance[-3:, -3:] @ shift))
    others = [
        float(opencv_rig(views, A_BOARD, sizes).baselines_mm[0])
        for views in list(found.values())[:-1]
    ]
    return [
        Row(
            "A: held-out edge rms, mm",
            [e.rms_mm for e in errors],
            "≤ .13",
            errors[-1].rms_mm <= 0.13,
        ),
        Row(
            "A: held-out edge max, mm",
            [e.max_mm for e in errors],
            "≤ .65",
            errors[-1].max_mm <= 0.65,
        ),
        Row("A: corners under σ = 3 noise, px", repeat, "≤ .006", (repeat[-1] or 1) <= 0.006, 4),
        Row(
            f"A: baseline, mm (reference {A_BASELINE_MM})",
            [*others, baseline],
            "± .1",
            abs(baseline - A_BASELINE_MM) <= 0.1,
        ),
        Row(
            f"A: its stated sd, mm (reference {A_BASELINE_U_MM:.4f})",
            [None, None, None, u],
            "± 15 %",
            abs(u / A_BASELINE_U_MM - 1) <= 0.15,
            4,
        ),
        Row(
            "A: the same by leaving out one moment at a time (ADR 8)",
            [None, None, None, jackknife_u(found["Pivometer"], sizes)],
            "",
            None,
            4,
        ),
    ]


def jackknife_u(views: Sequence[BoardView], sizes: dict[str, tuple[int, int]]) -> float:
    """Return the baseline's standard uncertainty by the delete-one-moment jackknife, mm.

    It assumes nothing of how the corners of one picture err together.
    """
    moments = sorted({view.view for view in views})
    baselines = [
        float(
            calibrate_rig(
                [view for view in views if view.view != moment], A_BOARD, sizes, reference="left"
            ).rig.baselines_mm[0]
        )
        for moment in moments
    ]
    return float(np.sqrt((len(moments) - 1) * np.var(baselines)))


def repeatability(pictures: Sequence[Picture], find: Find) -> float | None:
    """Return the rms movement of a corner coordinate under added noise of σ = 3 grey values, px."""
    random = np.random.default_rng(0)
    moves = []
    for picture in pictures:
        noisy = picture.image + random.normal(0, 3, picture.image.shape)
        image = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        before = find(picture.image, A_BOARD, "left", "clean")
        after = find(image, A_BOARD, "left", "noisy")
        if before is not None and after is not None:
            after = _numbered_like(after, before, A_BOARD)
            _, a, b = np.intersect1d(before.ids, after.ids, return_indices=True)
            moves.append((after.pixels[b] - before.pixels[a]).ravel())
    return float(np.sqrt(np.mean(np.concatenate(moves) ** 2))) if moves else None


def rows_of_replica() -> list[Row]:
    """Held-out edges of a rendered copy of the paper's rig, and the cost of its calibration."""
    session = simulate("gold", board_pairs=40, single_views=30, poses=3, seed=5)
    pictures = [
        Picture(path.split("/")[1], _moment(path), session.image(path))
        for path in session.paths
        if path.startswith(("board", "intrinsics"))
    ]
    board = Board("checkerboard", session.pattern.squares, session.pattern.square_mm)
    sizes = {"left": (640, 480), "right": (640, 480)}
    out = {f"board/{number:03d}" for number in range(20, 40)}
    found = all_corners(pictures, board)
    errors, seconds = [], []
    for name, views in found.items():
        kept = [v for v in views if v.view not in out]
        start = time.perf_counter()
        if name == "Pivometer":
            rig = calibrate_rig(kept, board, sizes, reference="left").rig
        else:
            rig = opencv_rig(kept, board, sizes)
        seconds.append(time.perf_counter() - start)
        lengths = reconstructed_edges([v for v in views if v.view in out], board, rig)
        errors.append(length_error(lengths, board.square_mm))
    pairs = [v for v in found["Pivometer"] if v.view.startswith("board")]
    pairs = [v for v in pairs if v.view < "board/030"]
    ratio = _median_s(lambda: joint_only(pairs, board, sizes)) / _median_s(
        lambda: opencv_rig(pairs, board, sizes)
    )
    refine = refinement_s([p.image for p in pictures[:20]], board)
    return [
        Row(
            "replica: held-out rms, mm",
            [e.rms_mm for e in errors],
            "≤ .006",
            errors[-1].rms_mm <= 0.006,
            4,
        ),
        Row(
            "replica: held-out max, mm",
            [e.max_mm for e in errors],
            "≤ .04",
            errors[-1].max_mm <= 0.04,
            4,
        ),
        Row("replica: whole calibration, s", seconds, "", None, 2),
        Row(
            "joint adjustment, 30 pairs / OpenCV's three calls",
            [None, None, None, ratio],
            "≤ 1.5",
            ratio <= 1.5,
            2,
        ),
        Row(
            "corner refinement of a board, ms",
            [None, None, None, 1e3 * refine],
            "≤ 10",
            refine <= 0.010,
            1,
        ),
    ]


def _moment(path: str) -> str:
    group, camera, name = path.removesuffix(".png").split("/")
    return f"board/{name}" if group == "board" else f"{group}/{camera}/{name}"


def joint_only(views: Sequence[BoardView], board: Board, sizes: dict[str, tuple[int, int]]) -> None:
    """Do what OpenCV's three calls do: each camera, then all together, without any statistics."""
    from pivometer.calibration.half_turn import PosedView, camera_tree, numbered_alike
    from pivometer.calibration.intrinsics import calibrate_camera
    from pivometer.calibration.joint_route import joint_fit

    alone = {
        name: calibrate_camera(
            [v for v in views if v.camera == name], board, sizes[name], camera=name
        )
        for name in sizes
    }
    posed = [
        PosedView(view, pose)
        for one in alone.values()
        for view, pose in zip(one.views, one.camera_from_board, strict=True)
    ]
    mine = {p.view.view: p for p in posed if p.view.camera == "left"}
    pair = next((mine[p.view.view], p) for p in posed if p.view.camera == "right")
    first = pair[0].camera_from_board @ pair[1].camera_from_board.inverse()
    rig = Rig([alone["left"].camera, alone["right"].camera], [RigidTransform.identity(), first])
    tree = camera_tree([p.view for p in posed], ["left", "right"])
    joint_fit(numbered_alike(posed, board, rig).views, board, rig, False, tree)


def _median_s(work: Callable[[], object]) -> float:
    taken = []
    for _ in range(5):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return float(np.median(taken))


def refinement_s(images: Sequence[Image], board: Board) -> float:
    """Return the median time from seeds to finished corners: the whole, less the detector, s."""
    taken = []
    for image in images:
        start = time.perf_counter()
        next(board_hypotheses(image, board))
        seeds = time.perf_counter()
        find_corners(image, board, camera="left", view="timed")
        taken.append(time.perf_counter() - seeds - (seeds - start))
    return float(np.median(taken))


def rows_of_rendered() -> list[Row]:
    """Location of the RCM in the camera's frame on pictures of another renderer."""
    rows = []
    for name, limit, plain in (("bearing_white", 0.20, 0.44), ("arm_black_clutter", 0.30, 1.04)):
        folder = DATA / "rendered" / name
        if not folder.is_dir():
            continue
        measured = pivometer.measure(pipeline.load(folder))
        truth = _true_point(folder)
        squares = measured.rcm.least_squares
        error = float(np.linalg.norm(squares.point_mm - truth))
        inside = lies_within(
            truth,
            squares.point_mm,
            squares.covariance_mm2,
            degrees_of_freedom=measured.uncertainty.degrees_of_freedom,
        )
        where = "inside" if inside else "outside"
        rows.append(
            Row(
                f"{name}: RCM location, mm ({where} its 95 %)",
                [None, plain, None, error],
                f"≤ {limit:.2f}, inside",
                error <= limit and inside,
            )
        )
    return rows


def _true_point(folder: Path) -> NDArray[np.float64]:
    content = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    return np.array(content["rcm"]["lsq"]["point_left_mm"])


def show(rows: Sequence[Row]) -> None:
    """Print the table."""
    print(f"{'':54}" + "".join(f"{name:>15}" for name in METHODS) + f"{'target':>15}")
    for row in rows:
        cells = "".join(
            f"{'–' if value is None else f'{value:.{row.digits}f}':>15}" for value in row.values
        )
        verdict = "" if row.reached is None else "  pass" if row.reached else "  FAIL"
        print(f"{row.what:54}{cells}{row.target:>15}{verdict}")


def main() -> None:
    """Print one table, with targets."""
    rows = []
    pictures = set_a()
    if pictures:
        rows += rows_of_a(pictures)
    else:
        print(f"set A is not in {DATA}: its rows are left out")
    rows += rows_of_replica()
    rendered = rows_of_rendered()
    if not rendered:
        print(f"the rendered sets are not in {DATA}: their rows are left out")
    show(rows + rendered)


if __name__ == "__main__":
    main()
