"""Whether more distortion coefficients are justified, judged by edges of boards left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration.bundle import BundleProblem, BundleSolution, adjust, rig_from_state
from pivometer.calibration.joint_route import JointFit
from pivometer.calibration.paper_route import UsedViews
from pivometer.calibration.quality import HeldOut, held_out_lengths
from pivometer.cameras import Camera, Rig
from pivometer.cameras.distortion import MODELS, full_length
from pivometer.errors import DataError

LEAST_GAIN = 0.1
"""Fraction by which the held-out error must fall. Of 14 simulated sets whose lens has two
coefficients (0.03 and 0.1 px of noise) five made it 0 to 5 % worse; p₁ = −p₂ = 1e-3, several times
what real lenses have, gained 2 to 5 %, which no one needs."""
SIGNIFICANCE = 0.05
"""Of the paired one-sided t-test over the folds."""
WORTH_A_LOOK = 1e-3
"""Of the F-test on the fit itself that saves the folds where the wider model does not even fit
better. Errors common to a view only raise F, so it errs on the side of looking."""

EXACT_PX = 1e-4
"""Corners that fit this well leave nothing to explain."""


def wider_model_note(joint: JointFit, used: UsedViews, held_out: HeldOut) -> tuple[str, ...]:
    """Say so where the next wider distortion model reconstructs boards left out better.

    More coefficients always fit better; whether they measure better only boards show that took no
    part. The wider model must lower the held-out rms error by more than a tenth, and the mean
    squares of the folds in a paired t-test.

    Parameters
    ----------
    joint
        The joint adjustment with the model in use.
    used
        The views.
    held_out
        Its held-out edges.
    """
    names = list(MODELS)
    now = joint.rig.cameras[0].model
    if now == names[-1]:
        return ()
    wider = names[names.index(now) + 1]
    try:
        other = _with_model(joint, MODELS[wider])
        if not _fits_better(joint.problem, joint.solution, other.solution):
            return ()
        theirs = held_out_lengths(
            used.views, used.board, lambda kept: _rig(other, kept, used), folds=10
        )
    except DataError:  # the views do not determine the wider model, or it folds
        return ()
    edge = used.board.square_mm
    ours_mm, theirs_mm = held_out.error(edge).rms_mm, theirs.error(edge).rms_mm
    gains = held_out.mean_squares_mm2(edge) - theirs.mean_squares_mm2(edge)
    if theirs_mm > (1 - LEAST_GAIN) * ours_mm or not _positive(gains):
        return ()
    note = (
        f"the {wider} distortion model reconstructs held-out boards to {theirs_mm:.3f} mm rms, "
        f"{now} to {ours_mm:.3f} mm: more coefficients are justified; calibrate with "
        f"--distortion {wider}"
    )
    return (note,)


def _rig(fit: JointFit, moments: Sequence[str], used: UsedViews) -> Rig:
    return fit.rig_from(moments, used.board, weighted=used.weighted)


def _with_model(joint: JointFit, count: int) -> JointFit:
    """Adjust again from where it is, with `count` distortion coefficients."""
    cameras = [_widened(camera, count) for camera in joint.rig.cameras]
    state = replace(
        joint.solution.state, intrinsics=np.array([camera.parameters for camera in cameras])
    )
    solution = adjust(joint.problem, state, tolerance=1e-6)
    return replace(joint, rig=rig_from_state(solution.state, cameras), solution=solution)


def _widened(camera: Camera, count: int) -> Camera:
    """Return the same camera in a model of more coefficients, the new ones zero."""
    return replace(camera, distortion=full_length(camera.distortion)[:count])


def _fits_better(problem: BundleProblem, now: BundleSolution, wider: BundleSolution) -> bool:
    """Whether the wider model fits the corners better than by chance, by the F-test."""
    from scipy.stats import f as f_distribution

    ours, theirs = (
        float(np.sum((s.residuals_px * problem.weights[..., None]) ** 2)) for s in (now, wider)
    )
    more = now.degrees_of_freedom - wider.degrees_of_freedom
    if wider.degrees_of_freedom < 1 or ours < EXACT_PX**2 * wider.degrees_of_freedom:
        return False
    ratio = (ours - theirs) / more / (theirs / wider.degrees_of_freedom)
    return bool(f_distribution.sf(ratio, more, wider.degrees_of_freedom) < WORTH_A_LOOK)


def _positive(gains: Floats) -> bool:
    """Whether the mean of the gains is above zero, by a one-sided t-test."""
    from scipy.stats import t as t_distribution

    if len(gains) < 3:
        return False
    spread = float(np.std(gains, ddof=1)) / np.sqrt(len(gains))
    least = spread * float(t_distribution.ppf(1 - SIGNIFICANCE, len(gains) - 1))
    return bool(float(np.mean(gains)) > least)
