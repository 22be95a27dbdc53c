import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pivometer.calibration.board import BoardView
from pivometer.calibration.metric_scale import (
    edge_lengths,
    length_error,
    metric_scale,
    reconstructed_edges,
    triangulate_points,
)
from pivometer.cameras import Rig
from pivometer.errors import CalibrationError
from pivometer.geometry.rigid import RigidTransform


def scaled(rig, factor):
    poses = [
        RigidTransform(t.rotation, factor * t.translation_mm) for t in rig.reference_from_camera
    ]
    return Rig(rig.cameras, poses)


@given(st.lists(st.floats(0.1, 10), min_size=1, max_size=20), st.floats(1, 100))
def test_scale_minimises_21(lengths, edge_mm):
    L = np.array(lengths)
    s = metric_scale(L, edge_mm)
    assert abs(L @ (L * s - edge_mm)) < 1e-9 * (L @ L) * s  # the normal equation of (21)


def test_no_edges_are_refused():
    with pytest.raises(CalibrationError, match="no board edge"):
        metric_scale([], 15.0)


def test_triangulation_is_exact_with_three_cameras(three_cameras):
    rig = three_cameras.rig
    X = np.random.default_rng(0).uniform([-60, -50, 420], [60, 60, 520], (20, 3))
    images = []
    for camera, pose in zip(rig.cameras, rig.reference_from_camera, strict=True):
        images.append(camera.normalized_from_pixels(camera.project(pose.inverse() @ X)))
    found = triangulate_points(images, rig.reference_from_camera)
    np.testing.assert_allclose(found, X, atol=1e-9)


def test_triangulation_minimises_image_errors(scene):
    """Gradient of the squared image errors vanishes at the triangulated point."""
    rng = np.random.default_rng(0)
    rig = scene.rig
    X = np.array([[5.0, 20, 470]])
    images = [
        (p.inverse() @ X)[:, :2] / (p.inverse() @ X)[:, 2:] + 1e-3 * rng.standard_normal((1, 2))
        for p in rig.reference_from_camera
    ]
    found = triangulate_points(images, rig.reference_from_camera)[0]

    def cost(point):
        total = 0.0
        for image, pose in zip(images, rig.reference_from_camera, strict=True):
            local = pose.inverse() @ point
            total += np.sum((local[:2] / local[2] - image[0]) ** 2)
        return total

    base = cost(found)
    for step in np.concatenate([np.eye(3), -np.eye(3)]) * 1e-3:
        assert cost(found + step) > base


def test_parallel_rays_are_refused():
    left = RigidTransform.identity()
    right = RigidTransform(np.eye(3), np.array([100.0, 0, 0]))
    with pytest.raises(CalibrationError, match="parallel"):
        triangulate_points([[[0.1, 0.0]], [[0.1, 0.0]]], [left, right])


def test_exact_corners_have_exact_edges_in_any_unit(scene):
    edges = reconstructed_edges(scene.views(), scene.board, scene.rig)
    assert len(edges) == 12 * len(scene.board.edges)
    np.testing.assert_allclose(edges, 15.0, atol=1e-9)
    unit = reconstructed_edges(scene.views(), scene.board, scaled(scene.rig, 1 / 500))
    assert metric_scale(unit, 15.0) == pytest.approx(500, rel=1e-12)


def test_partial_and_missing_views_lose_only_their_edges(three_cameras):
    scene = three_cameras
    views = scene.views()
    first = views[0]
    views[0] = BoardView(
        first.camera, first.view, first.ids[:8], first.pixels[:8], first.sigma_px[:8]
    )
    full = reconstructed_edges(scene.views(), scene.board, scene.rig)
    assert len(reconstructed_edges(views, scene.board, scene.rig)) == len(full)  # two others saw it
    pair = [v for v in views if v.camera != "top"]
    lost = len(scene.board.edges) - 7  # a row of eight corners has seven edges
    got = reconstructed_edges(
        pair, scene.board, Rig(scene.rig.cameras, scene.rig.reference_from_camera)
    )
    assert len(got) == len(full) - lost
    np.testing.assert_allclose(got, 15.0, atol=1e-9)


def test_length_error_counts_max_and_rms():
    error = length_error([15.3, 14.6, 15.0], 15.0)
    assert error.max_mm == pytest.approx(0.4)
    assert error.rms_mm == pytest.approx(np.sqrt((0.09 + 0.16) / 3))
    assert error.count == 3


def test_edge_lengths_follow_the_edges():
    np.testing.assert_allclose(
        edge_lengths([[0, 0, 0], [1, 0, 0], [1, 2, 0]], [[0, 1], [1, 2]]), [1, 2]
    )
