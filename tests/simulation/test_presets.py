"""Presets: the paper's set-up, whole sessions, and a truth that fits the pictures."""

import json
import tomllib

import cv2
import numpy as np
import pytest

from pivometer.errors import UsageError
from pivometer.geometry import tangent_plane_normals
from pivometer.simulation import PRESETS, simulate
from pivometer.simulation.boards import Pattern, marker_bits
from pivometer.simulation.scene import UP

FEW = {"poses": 3, "board_pairs": 1, "single_views": 1}


@pytest.fixture(scope="module")
def gold():
    return simulate("gold", **FEW)


def test_gold_and_davinci_have_the_papers_rig():
    for name, baseline, pivot in (
        ("gold", 525.65, [6.4, 65.7, 478.3]),
        ("davinci", 551.94, [-2.8, 37.9, 420.8]),
    ):
        setup = PRESETS[name]()
        assert setup.rig.baselines_mm[0] == pytest.approx(baseline, abs=1e-9)
        assert np.allclose(setup.reference_from_robot.translation_mm, pivot)
        axis = setup.rig.reference_from_camera[1].rotation[:, 2]
        assert 84 <= np.degrees(np.arccos(axis[2])) <= 90
        assert all((c.width, c.height) == (640, 480) for c in setup.rig.cameras)
        assert (setup.cone_deg, setup.poses, setup.pattern.squares) == (57.0, 70, (9, 7))


def test_default_session_has_the_papers_counts():
    session = simulate("gold")
    kinds = [path.split("/")[0] for path in session.paths]
    assert [kinds.count(kind) for kind in ("board", "intrinsics", "shaft")] == [40, 20, 140]
    assert kinds == sorted(kinds, key=["board", "intrinsics", "shaft"].index)
    assert session.image_count == 200


def test_iterating_yields_paths_and_images(gold):
    pairs = list(gold)
    assert [path for path, _ in pairs] == list(gold.paths)
    assert {(image.shape, image.dtype) for _, image in pairs} == {((480, 640), np.dtype(np.uint8))}
    path, image = pairs[-1]
    assert np.array_equal(image, simulate("gold", **FEW).image(path))
    assert not np.array_equal(image, simulate("gold", **FEW, seed=1).image(path))


def test_session_toml_and_truth(gold):
    settings = tomllib.loads(gold.session_toml)
    assert settings["board"] == {"kind": "checkerboard", "squares": [9, 7], "square_mm": 15.0}
    assert settings["shaft"] == {"diameter_mm": 10.0}
    assert settings["cameras"] == {"names": ["left", "right"], "reference": "left"}
    truth = json.loads(json.dumps(gold.truth))
    assert [pose["pose"] for pose in truth["poses"]] == ["000", "001", "002"]
    assert truth["design_pivot_mm"] == [6.4, 65.7, 478.3]
    assert truth["cameras"]["right"]["reference_from_camera"]["rotation"] != np.eye(3).tolist()


@pytest.mark.parametrize("name", list(PRESETS))
def test_every_board_corner_is_in_every_image(name):
    session = simulate(name, poses=1, board_pairs=8, single_views=4)
    pattern = session.pattern
    for path, picture in session.pictures.items():
        if path.startswith("shaft"):
            continue
        camera = session.rig.cameras[session.rig.index(picture.camera)]
        pixels = camera.project(picture.camera_from_board @ pattern.outline_mm(0.0))
        assert (pixels > 3).all(), path
        assert (pixels < [camera.width - 4, camera.height - 4]).all(), path


@pytest.mark.parametrize("name", list(PRESETS))
def test_both_edges_are_in_view_along_most_of_the_shaft(name):
    session = simulate(name, board_pairs=0, single_views=0)
    length = {"gold": 100.0, "davinci": 100.0, "micro": 7.0}[name]
    start = session.shaft.span_mm[0]
    places = np.linspace(start, start + length, 50)
    shares = []
    for camera, transform in zip(
        session.rig.cameras, session.rig.reference_from_camera, strict=True
    ):
        inverse = transform.inverse()
        for point, direction in zip(
            session.motion.points_mm, session.motion.directions, strict=True
        ):
            axis, foot = inverse.rotate(direction), inverse @ point
            radius = session.shaft.diameter_mm / 2
            contact = foot + radius * tangent_plane_normals(foot, axis, radius)
            pixels = camera.project(contact[:, None] + places[:, None] * axis)
            inside = (pixels > 3) & (pixels < np.array([camera.width, camera.height]) - 4)
            shares.append(inside.all(axis=(0, 2)).mean())
    assert np.min(shares) > 0.85


def test_the_shaft_stands_up_from_the_pivot(gold):
    image = gold.image("shaft/left/000.png").astype(float)
    pivot = gold.rig.cameras[0].project(gold.truth["design_pivot_mm"])
    above = gold.rig.cameras[0].project(gold.truth["design_pivot_mm"] + 80 * UP)
    u, v = np.rint(above).astype(int)
    assert image[v, u] > 100
    assert image[v, u + 30] < 20
    assert above[1] < pivot[1]


def test_real_detectors_find_the_boards():
    session = simulate("davinci", poses=1, board_pairs=2, single_views=0)
    for path, picture in session.pictures.items():
        if path.startswith("shaft"):
            continue
        found, corners = cv2.findChessboardCorners(session.image(path), (8, 6))
        assert found, path
        camera = session.rig.cameras[session.rig.index(picture.camera)]
        true = camera.project(picture.camera_from_board @ session.pattern.corners_mm())
        apart = np.linalg.norm(corners.reshape(-1, 1, 2) - true, axis=2).min(axis=1)
        assert np.median(apart) < 0.5


def test_charuco_markers_are_opencvs():
    pattern = Pattern(kind="charuco", squares=(9, 7), marker_mm=11.0)
    session = simulate("gold", poses=1, board_pairs=1, single_views=0, pattern=pattern)
    board = cv2.aruco.CharucoBoard(
        (9, 7), 15.0, 11.0, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    )
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(
        session.image("board/left/000.png")
    )
    picture = session.pictures["board/left/000.png"]
    true = session.rig.cameras[0].project(picture.camera_from_board @ pattern.corners_mm())
    assert len(ids) > 40
    assert np.abs(corners.reshape(-1, 2) - true[ids.ravel()]).max() < 0.7
    assert not marker_bits("DICT_4X4_50", 0)[0].any()
    settings = tomllib.loads(session.session_toml)["board"]
    assert settings["dictionary"] == "DICT_4X4_50"
    assert settings["marker_mm"] == 11.0


def test_options_reach_the_images():
    session = simulate(
        "gold",
        poses=1,
        board_pairs=0,
        single_views=0,
        background_frames=2,
        reference_views=1,
        shading="flat",
        noise=0.0,
        bits=16,
    )
    assert session.paths == (
        "shaft/left/000.png",
        "shaft/right/000.png",
        "background/left/000.png",
        "background/right/000.png",
        "background/left/001.png",
        "background/right/001.png",
        "reference/left/000.png",
        "reference/right/000.png",
    )
    image = session.image("shaft/left/000.png")
    assert image.dtype == np.uint16
    assert np.isclose(image.max(), (0.72 + 0.015) * 65535, atol=1)
    empty = [session.image(f"background/left/00{k}.png") for k in (0, 1)]
    assert np.array_equal(*empty)


def test_usage_errors_name_the_choices():
    with pytest.raises(UsageError, match="gold, davinci, micro"):
        simulate("golden")
    with pytest.raises(UsageError, match="shading"):
        simulate("gold", shading="phong")
    with pytest.raises(UsageError, match="hold the whole board"):
        simulate("micro", pattern=Pattern(square_mm=20.0))
    with pytest.raises(UsageError, match="no image"):
        simulate("gold", **FEW).image("board/top/000.png")
    with pytest.raises(UsageError, match="kind"):
        Pattern(kind="dots")
