"""The shaft is found without a click, in drawn scenes and in independently rendered ones."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.cameras import Camera
from pivometer.errors import ShapeError
from pivometer.geometry import tangent_plane_normals
from pivometer.shaft.detection import SeedRejection, find_shaft, learn_shaft
from pivometer.shaft.seed import ShaftSeed

SHARP = 4
"""Supersampling of the drawn scenes; edges are then good to 1/8 px."""

PIVOT = np.array([310.0, 400.0])
SEED_ERROR_PX = 2.0
"""What `ShaftSeed` promises."""


def shaft_edges(angle_rad: float, width_px: float, *, taper: float = 0.01) -> Floats:
    """Two edges (2, 2, 2) of a shaft through PIVOT, from 40 to 300 px away from it."""
    along = np.array([np.sin(angle_rad), -np.cos(angle_rad)])
    across = np.array([np.cos(angle_rad), np.sin(angle_rad)])
    ends = [PIVOT + s * along for s in (40.0, 300.0)]
    half = [(width_px + taper * s) / 2 for s in (40.0, 300.0)]
    return np.array(
        [[e + side * h * across for e, h in zip(ends, half, strict=True)] for side in (-1, 1)]
    )


def polygon(image: NDArray[np.uint8], corners: Floats, grey: int) -> None:
    """Fill a polygon given in final pixels on the supersampled image."""
    fine = (np.asarray(corners) + 0.5) * SHARP - 0.5
    cv2.fillPoly(image, [np.rint(fine * 16).astype(np.int32)], grey, cv2.LINE_8, 4)


def scene(
    edges: Floats | None, shaft: int, behind: int, *, clutter: bool, seed: int
) -> NDArray[np.uint8]:
    """Draw one 640×480 frame; the clutter is the same in all frames, the noise is not."""
    image = np.full((480 * SHARP, 640 * SHARP), behind, dtype=np.uint8)
    if clutter:
        fixed = np.random.default_rng(11)
        for _ in range(30):
            one, other = fixed.uniform([0, 0], [640, 480], (2, 2))
            wide = fixed.uniform(2, 14) * np.array([1.0, 0.6])
            corners = np.stack([one - wide, other - wide, other + wide, one + wide])
            polygon(image, corners, int(fixed.integers(60, 250)))
    if edges is not None:
        polygon(image, np.concatenate([edges[0], edges[1][::-1]]), shaft)
    small = cv2.GaussianBlur(cv2.resize(image, (640, 480), interpolation=cv2.INTER_AREA), (0, 0), 1)
    noisy = small + np.random.default_rng(seed).normal(0, 2, small.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def poses(angles: Floats, width_px: float) -> list[Floats]:
    return [shaft_edges(float(a), width_px) for a in angles]


def error_px(seed: ShaftSeed | SeedRejection, edges: Floats) -> float:
    """Largest distance of the seed's four ends from the true edge lines."""
    assert isinstance(seed, ShaftSeed), seed
    along = edges[:, 1] - edges[:, 0]
    normals = along[:, ::-1] * [1, -1] / np.hypot(*along.T)[:, None]
    both = [
        np.abs(np.einsum("eki,ei->ek", order - edges[:, :1], normals)).max()
        for order in (seed.edges_px, seed.edges_px[::-1])
    ]
    return float(min(both))


SPREAD = np.linspace(-0.5, 0.55, 9)


@pytest.mark.parametrize(
    ("shaft", "behind", "clutter", "width"),
    [(220, 10, False, 20.0), (20, 140, True, 20.0), (235, 90, True, 8.0), (15, 150, True, 60.0)],
)
def test_a_shaft_is_found_in_every_frame(
    shaft: int, behind: int, clutter: bool, width: float
) -> None:
    truth = poses(SPREAD, width)
    frames = [scene(e, shaft, behind, clutter=clutter, seed=i) for i, e in enumerate(truth)]
    found = find_shaft(frames)
    assert max(error_px(s, e) for s, e in zip(found, truth, strict=True)) < SEED_ERROR_PX


def brushed(edges: Floats, lanes: Floats, *, grey: int, seed: int) -> NDArray[np.uint8]:
    """Draw a shaft before a wall of 140 with lanes along it: what they add, evenly across."""
    image = scene(edges, grey, 140, clutter=True, seed=seed).astype(np.float64)
    y, x = np.mgrid[0:480, 0:640]
    along = edges.mean(axis=0)[1] - edges.mean(axis=0)[0]
    normal = np.array([-along[1], along[0]]) / np.hypot(*along)
    place = np.stack([x, y], axis=-1) - edges.mean(axis=0)[0]
    across = place @ normal / np.hypot(*(edges[1, 0] - edges[0, 0])) + 0.5
    on = (place @ along > 0) & (place @ along < along @ along) & (np.abs(across - 0.5) < 0.5)
    image[on] += lanes[(across[on] * len(lanes)).astype(int)]
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def test_lanes_along_a_shaft_do_not_hide_its_edges_in_frames_that_taught_nothing() -> None:
    truth = poses(SPREAD, 90.0)
    lanes = -30 * np.cos(2 * np.pi * 8 * np.linspace(0, 1, 720))
    frames = [brushed(e, lanes, grey=90, seed=i) for i, e in enumerate(truth)]
    finder = learn_shaft(frames[:-2])
    for frame, edges in zip(frames[-2:], truth[-2:], strict=True):
        assert error_px(finder.find(frame), edges) < SEED_ERROR_PX


def test_three_poses_suffice_before_a_dark_background() -> None:
    truth = poses(np.array([-0.4, 0.05, 0.45]), 22.0)
    frames = [scene(e, 210, 12, clutter=False, seed=i) for i, e in enumerate(truth)]
    found = find_shaft(frames)
    assert max(error_px(s, e) for s, e in zip(found, truth, strict=True)) < SEED_ERROR_PX


def test_ends_stay_on_the_visible_shaft() -> None:
    truth = poses(SPREAD, 20.0)
    frames = [scene(e, 220, 10, clutter=False, seed=i) for i, e in enumerate(truth)]
    for seed, edges in zip(find_shaft(frames), truth, strict=True):
        assert isinstance(seed, ShaftSeed)
        away = np.hypot(*(seed.edges_px.mean(axis=0) - PIVOT).T)
        # Ends are known to one 4 px bin; a whole bin more for the slanted cap.
        assert sorted(away) == pytest.approx([40, 300], abs=8)
        assert edges.shape == seed.edges_px.shape


def test_a_frame_without_the_shaft_is_rejected_and_the_rest_go_on() -> None:
    truth = poses(SPREAD, 20.0)
    frames = [
        scene(None if i == 3 else e, 20, 140, clutter=True, seed=i) for i, e in enumerate(truth)
    ]
    found = find_shaft(frames)
    assert isinstance(found[3], SeedRejection)
    assert found[3].reason == "nothing differs from the background"
    others = [(s, e) for i, (s, e) in enumerate(zip(found, truth, strict=True)) if i != 3]
    assert max(error_px(s, e) for s, e in others) < SEED_ERROR_PX


def test_a_covered_shaft_is_rejected() -> None:
    truth = poses(SPREAD, 20.0)
    frames = [scene(e, 220, 10, clutter=False, seed=i) for i, e in enumerate(truth)]
    frames[5][:330] = 10
    found = find_shaft(frames)
    assert isinstance(found[5], SeedRejection)
    assert sum(isinstance(s, ShaftSeed) for s in found) == len(found) - 1


def test_a_static_shaft_is_refused_because_nothing_moves() -> None:
    frame = scene(shaft_edges(0.2, 20.0), 220, 30, clutter=True, seed=0)
    found = find_shaft([frame] * 6)
    assert all(isinstance(s, SeedRejection) and "nothing moves" in s.reason for s in found)


def test_one_frame_cannot_tell_what_moves() -> None:
    found = find_shaft([scene(shaft_edges(0.2, 20.0), 220, 30, clutter=False, seed=0)])
    assert len(found) == 1
    assert isinstance(found[0], SeedRejection)


def test_an_empty_frame_gives_the_background() -> None:
    truth = poses(np.array([0.1, 0.2, 0.3, 0.4]), 30.0)
    frames = [scene(e, 20, 140, clutter=True, seed=i) for i, e in enumerate(truth)]
    empty = scene(None, 20, 140, clutter=True, seed=99)
    found = find_shaft(frames, background=empty)
    assert max(error_px(s, e) for s, e in zip(found, truth, strict=True)) < SEED_ERROR_PX


def test_before_an_empty_frame_no_lane_of_a_shaft_as_bright_as_the_wall_is_its_edge() -> None:
    rough = np.random.default_rng(8).normal(0, 1, (1, 400))
    lanes = cv2.GaussianBlur(rough, (0, 0), 12)[0]
    truth = poses(SPREAD, 60.0)
    frames = [
        brushed(e, 10 + 8 * lanes / lanes.std(), grey=140, seed=i) for i, e in enumerate(truth)
    ]
    empty = scene(None, 0, 140, clutter=True, seed=99)
    found = find_shaft(frames, background=empty)
    assert max(error_px(s, e) for s, e in zip(found, truth, strict=True)) < SEED_ERROR_PX


def test_sixteen_bits_large_images_and_no_images() -> None:
    truth = poses(SPREAD[::2], 20.0)
    frames = [scene(e, 220, 10, clutter=False, seed=i) for i, e in enumerate(truth)]
    wide = [cv2.resize(f, (1920, 1440), interpolation=cv2.INTER_LINEAR) for f in frames]
    deep = [f.astype(np.uint16) * 100 for f in wide]
    found = find_shaft(deep)
    for seed, edges in zip(found, truth, strict=True):
        assert error_px(seed, (edges + 0.5) * 3 - 0.5) < SEED_ERROR_PX
    assert find_shaft([]) == []


def test_a_seed_has_two_edges_with_two_ends() -> None:
    with pytest.raises(ShapeError, match="edges_px has shape"):
        ShaftSeed(np.zeros((2, 3)))


def camera_and_edges(
    truth: dict[str, object], name: str
) -> tuple[Camera, list[NDArray[np.float64]]]:
    """The true camera and every pose's two coimage normals in its frame."""
    data = json.loads(json.dumps(truth))
    c = data["cameras"][name]
    K = np.array(c["K"])
    size = (c["width"], c["height"])
    camera = Camera(name, *size, [K[0, 0], K[1, 1]], K[:2, 2], c["dist_k1k2p1p2k3"][:2])
    R, t = np.eye(3), np.zeros(3)
    if name == "right":
        stereo = data["stereo"]["x_right_eq_R_x_left_plus_t"]
        R, t = np.array(stereo["R"]), np.array(stereo["t_mm"])
    radius = data["shaft"]["radius_mm"]
    normals = [
        tangent_plane_normals(
            R @ np.array(p["point_left_mm"]) + t, R @ np.array(p["direction"]), radius
        )
        for p in data["poses"]
    ]
    return camera, normals


def raw_error_px(seed: ShaftSeed, camera: Camera, normals: Floats) -> float:
    """Largest distance, raw px, of the seed's ends from the true, distorted edges."""

    def off(pixels: Floats, normal: Floats) -> Floats:
        rays = np.concatenate([camera.normalized_from_pixels(pixels), np.ones((2, 1))], axis=1)
        return np.asarray(rays @ normal)

    both = []
    for order in (normals, normals[::-1]):
        errors = []
        for ends, normal in zip(seed.edges_px, order, strict=True):
            steps = [off(ends + h, normal) - off(ends - h, normal) for h in np.eye(2) / 2]
            errors.append(np.abs(off(ends, normal)) / np.hypot(*steps))
        both.append(np.max(errors))
    return float(min(both))


@pytest.mark.parametrize("camera_name", ["left", "right"])
@pytest.mark.parametrize("name", ["bearing_white", "arm_black_clutter"])
def test_rendered_shafts_are_found(shared_data: Path, name: str, camera_name: str) -> None:
    folder = shared_data / "rendered" / name
    truth = json.loads((folder / "truth.json").read_text())
    camera, normals = camera_and_edges(truth, camera_name)
    files = [folder / "shaft" / camera_name / f"{p['pose']}.png" for p in truth["poses"]]
    found = find_shaft([cv2.imread(str(f), cv2.IMREAD_UNCHANGED) for f in files])
    errors = [
        raw_error_px(s, camera, n)
        for s, n in zip(found, normals, strict=True)
        if isinstance(s, ShaftSeed)
    ]
    assert len(errors) >= 0.95 * len(files)
    assert max(errors) < SEED_ERROR_PX
