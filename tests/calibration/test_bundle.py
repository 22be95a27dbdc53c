from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from pivometer.calibration.board import BoardView
from pivometer.calibration.bundle import (
    adjust,
    adjust_wary,
    bundle_problem,
    bundle_state,
    covariance,
    gross_view,
    inverse_information,
    jacobian,
    normal_equations,
    residual_variance,
    residuals,
    rig_from_state,
    view_inflation,
)
from pivometer.errors import CalibrationError


def laid_out(scene, views):
    names = [c.name for c in scene.rig.cameras]
    problem = bundle_problem(views, scene.board, names)
    poses = [scene.camera_from_board(v.camera, v.view) for v in views]
    return problem, bundle_state(problem, scene.rig, poses)


def partial(view, rng):
    keep = np.sort(rng.choice(len(view.ids), 30, replace=False))
    return BoardView(view.camera, view.view, view.ids[keep], view.pixels[keep], view.sigma_px[keep])


def test_residuals_of_the_truth_are_zero(three_cameras):
    problem, state = laid_out(three_cameras, three_cameras.views())
    assert np.abs(residuals(problem, state)).max() < 1e-9


def test_jacobian_agrees_with_central_differences(three_cameras):
    rng = np.random.default_rng(0)
    views = [partial(v, rng) for v in three_cameras.views(0.3, 0)]
    problem, state = laid_out(three_cameras, views)
    J = jacobian(problem, state)
    found = problem.weights > 0
    for column in range(18):
        step = 1e-3 if column in (0, 1, 2, 3, 9, 10, 11, 15, 16, 17) else 1e-6
        for camera in range(3):
            shared, local = np.zeros(30), np.zeros((problem.moment_count, 6))
            if column < 6:
                shared[6 * camera + column] = step
            elif column < 12 and camera > 0:
                shared[18 + 6 * (camera - 1) + column - 6] = step
            elif column >= 12:
                local[:, column - 12] = step
            plus, minus = (
                residuals(problem, state.moved(sign * shared, sign * local)) for sign in (1, -1)
            )
            mine = found & (problem.camera == camera)[:, None]
            numeric, got = ((plus - minus) / (2 * step))[mine], J[..., column][mine]
            # central differences: rounding of 1e-13 px over a step of 1e-6
            np.testing.assert_allclose(got, numeric, atol=3e-7 * max(1, np.abs(got).max()))


def test_schur_step_solves_the_full_normal_equations(scene):
    problem, state = laid_out(scene, scene.views(0.1, 1))
    equations = normal_equations(problem, state)
    moments, d = equations.shared_gradient.shape
    H = np.zeros((d + 6 * moments,) * 2)
    H[:d, :d] = equations.shared.sum(axis=0)
    g = np.concatenate([equations.shared_gradient.sum(axis=0), equations.local_gradient.ravel()])
    for m in range(moments):
        at = slice(d + 6 * m, d + 6 * m + 6)
        H[:d, at] = equations.coupling[m]
        H[at, :d] = equations.coupling[m].T
        H[at, at] = equations.local[m]
    damping = 1e-3
    full = -np.linalg.solve(H + damping * np.diag(np.diag(H)), g)
    shared, local = equations.step(damping)
    np.testing.assert_allclose(shared, full[:d], rtol=1e-6)
    np.testing.assert_allclose(local.ravel(), full[d:], rtol=1e-5, atol=1e-12)


def test_exact_corners_give_back_the_truth_from_a_wrong_start(three_cameras):
    scene = three_cameras
    names = [c.name for c in scene.rig.cameras]
    views = scene.views()
    problem = bundle_problem(views, scene.board, names)
    rng = np.random.default_rng(3)
    spread = np.array(
        [20, 20, 10, 10, 0.05, 0.05] * 3 + [0.02] * 3 + [5] * 3 + [0.02] * 3 + [5] * 3
    )
    start_rig = scene.rig.perturbed(spread * rng.standard_normal(30))
    poses = [scene.camera_from_board(v.camera, v.view) for v in views]
    solution = adjust(problem, bundle_state(problem, start_rig, poses))
    rig = rig_from_state(solution.state, scene.rig.cameras)
    u = np.sqrt(np.diag(inverse_information(solution)))  # of 1 px of noise
    assert (np.abs(scene.rig.difference(rig)) < 1e-6 * u).all()


def test_errors_follow_the_stated_covariance(scene):
    """Mahalanobis² of the rig's 18 parameters over 15 calibrations is χ² of 270."""
    total, trials = 0.0, 15
    for seed in range(trials):
        problem, state = laid_out(scene, scene.views(0.1, 100 + seed))
        solution = adjust(problem, state)
        C = residual_variance(problem, solution) * inverse_information(solution)
        delta = scene.rig.difference(rig_from_state(solution.state, scene.rig.cameras))
        total += float(delta @ np.linalg.solve(C, delta))
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 18 * trials)
    assert low < total < high


def test_errors_common_to_a_view_are_found_and_counted(scene):
    """Corner errors smooth over a view: 6-fold variance of the result, seen in the residuals."""
    X = scene.board.corners_mm[:, :2]
    u = (X - X.mean(axis=0)) / np.abs(X - X.mean(axis=0)).max()
    smooth = np.stack([np.ones(len(u)), *u.T, *(u**2).T, u.prod(axis=1)], axis=1)
    total, trials = [], 6
    for seed in range(trials):
        rng = np.random.default_rng(seed)
        views = [
            replace_pixels(v, v.pixels + 0.05 * smooth @ rng.standard_normal((6, 2)))
            for v in scene.views(0.07, seed)
        ]
        problem, state = laid_out(scene, views)
        solution = adjust(problem, state)
        assert view_inflation(problem, solution) > 2
        delta = scene.rig.difference(rig_from_state(solution.state, scene.rig.cameras))
        total.append(float(delta @ np.linalg.solve(covariance(problem, solution), delta)))
    # one factor for all 18 parameters: right on average (1.04 over 60 sets), not for each of them
    assert 0.4 * 18 < np.mean(total) < 1.8 * 18


def replace_pixels(view, pixels):
    return BoardView(view.camera, view.view, view.ids, pixels, view.sigma_px)


def test_inflation_is_small_where_corners_err_independently(scene):
    found = []
    for seed in range(6):
        problem, state = laid_out(scene, scene.views(0.1, 50 + seed))
        found.append(view_inflation(problem, adjust(problem, state)))
    assert min(found) >= 1.0
    assert np.mean(found) < 1.4  # unbiased about 1 before the floor at 1


def test_huber_loss_keeps_one_wrong_view_from_bending_the_rest(scene):
    views = scene.views(0.05, 4)
    views[0] = replace_pixels(views[0], views[0].pixels[::-1])
    problem, state = laid_out(scene, views)
    plain = adjust(problem, state, tolerance=1e-3)
    robust, wrong = adjust_wary(problem, state)
    assert wrong in (0, 1)  # the two images of that moment
    error = [abs(s.state.intrinsics[0, 0] - 980) for s in (plain, robust)]
    assert error[1] < 0.3 * error[0]


def test_weights_follow_sigma(scene):
    views = scene.views(0.1, 0)
    sharp = [
        BoardView(v.camera, v.view, v.ids, v.pixels, np.full(len(v.ids), 0.01 if i % 2 else 0.03))
        for i, v in enumerate(views)
    ]
    problem = bundle_problem(sharp, scene.board, ["left", "right"], weighted=True)
    assert problem.weights[1, 0] / problem.weights[0, 0] == pytest.approx(3.0)
    assert np.mean(problem.weights**2) == pytest.approx(1.0)


def test_a_board_behind_the_camera_is_refused(scene):
    problem, state = laid_out(scene, scene.views())
    wrong = replace(state, board_translations_mm=-state.board_translations_mm)
    with pytest.raises(CalibrationError, match="behind a camera"):
        adjust(problem, wrong)


def test_gross_view_needs_both_ratio_and_size():
    assert gross_view([0.01, 0.01, 0.25]) is None
    assert gross_view([0.5, 0.5, 1.4]) is None
    assert gross_view([0.1, 0.1, 1.4]) == 2
