"""The location of the RCM in the frame of a board: errors of the cameras cancel, covered."""

import numpy as np
import pytest

from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.frame import fixed_board
from pivometer.geometry.rigid import RigidTransform
from pivometer.uncertainty import location_uncertainty, mahalanobis
from pivometer.uncertainty.carried_edges import rcm_of_points, thinned_points
from pivometer.uncertainty.frame import board_frame_uncertainty
from pivometer.uncertainty.propagation import square_root

POSE = RigidTransform.from_rotation_vector([0.05, -0.75, 0.06], [-40.0, 20.0, 480.0])


def board_views(rig, board, *, noise_px=0.0, seed=0):
    rng = np.random.default_rng(seed)
    views = []
    for camera, to in zip(rig.cameras, rig.reference_from_camera, strict=True):
        pixels = camera.project(to.inverse() @ (POSE @ board.corners_mm))
        pixels = pixels + noise_px * rng.standard_normal(pixels.shape)
        ids = np.arange(board.corner_count)
        sigma = np.full(len(ids), max(noise_px, 1e-3))
        views.append(BoardView(camera.name, "reference/000", ids, pixels, sigma))
    return views


def location(poses, fixed, rig):
    points = thinned_points(poses, [camera.name for camera in rig.cameras])
    return fixed.reference_from_board.inverse() @ rcm_of_points(points, rig).point_mm


@pytest.fixture
def board():
    return Board("checkerboard", (8, 7), 12.0)


def test_most_of_the_calibration_drops_out(rig, rig_covariance, view, board):
    poses = view(20)
    fixed = fixed_board(board_views(rig, board), board, rig, noise_px=0.1)
    inside, _ = board_frame_uncertainty(poses, rig, rig_covariance, fixed, board)
    outside = location_uncertainty(poses, rig, rig_covariance)
    assert np.trace(inside.calibration_mm2) < np.trace(outside.calibration_mm2) / 10


def test_wrong_rigs_stay_inside_the_stated_covariance(rig, rig_covariance, view, board):
    """The rig is off by 1 standard deviation at random; edges and corners have noise as well."""
    root = square_root(rig_covariance * 0.2**2)
    truth = POSE.inverse() @ np.array([6.4, 65.7, 478.3])
    rng = np.random.default_rng(3)
    squares = []
    for seed in range(60):
        wrong = rig.perturbed(root @ rng.standard_normal(root.shape[1]))
        poses = view(12, noise_px=0.1, seed=seed)
        seen = board_views(rig, board, noise_px=0.05, seed=seed)
        fixed = fixed_board(seen, board, wrong, noise_px=0.1)
        stated, _ = board_frame_uncertainty(poses, wrong, rig_covariance * 0.04, fixed, board)
        error = location(poses, fixed, wrong)
        squares.append(mahalanobis(error, truth, stated.total_mm2) ** 2)
    # the mean of 60 χ² of 3 degrees of freedom: 3 ± 0.32, and up to 10 % for estimated variances;
    # residuals that the wrong rig leaves count as noise too, so the stated value errs high
    assert 1.5 < np.mean(squares) < 4.2


def test_the_square_scales_board_and_rig_together(rig, rig_covariance, view):
    poses = view(20)
    exact = Board("checkerboard", (8, 7), 12.0)
    vague = Board("checkerboard", (8, 7), 12.0, 0.06)  # 0.5 %
    effect = np.zeros(18)
    effect[15:] = 0.005 * rig.reference_from_camera[1].translation_mm
    covariance = 1e-8 * rig_covariance + np.outer(effect, effect)
    fixed = fixed_board(board_views(rig, vague), vague, rig, noise_px=0.1)
    stated, _ = board_frame_uncertainty(poses, rig, covariance, fixed, vague)
    arm = location(poses, fixed, rig)
    assert np.allclose(stated.calibration_mm2, np.outer(arm, arm) * 0.005**2, atol=1e-6)
    alone, _ = board_frame_uncertainty(poses, rig, 1e-8 * rig_covariance, fixed, exact)
    assert np.trace(alone.calibration_mm2) < 1e-6


def test_a_covariance_without_the_squares_part_is_kept(rig, rig_covariance, view):
    vague = Board("checkerboard", (8, 7), 12.0, 0.06)
    fixed = fixed_board(board_views(rig, vague), vague, rig, noise_px=0.1)
    stated, pose = board_frame_uncertainty(view(12), rig, 1e-6 * rig_covariance, fixed, vague)
    assert np.isfinite(stated.total_mm2).all()
    assert pose.shape == (6, 6)
