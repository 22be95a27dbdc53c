"""Least squares whose unknowns are a few shared ones and six for each board view.

The normal equations of a calibration have the form of an arrowhead: the shared block (cameras)
along two borders, and one 6×6 block per view on the diagonal. Eliminating the views (Schur
complement) makes the cost of a step linear in the number of views.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from pivometer._arrays import Floats
from pivometer.errors import CalibrationError

State = TypeVar("State")


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Gauss–Newton normal equations, view by view: H = JᵀJ and gradient Jᵀr.

    Parameters
    ----------
    shared
        Each view's part of the shared block, shape (v, d, d).
    coupling
        Blocks between the shared unknowns and each view's own, shape (v, d, 6).
    local
        Each view's own block, shape (v, 6, 6).
    shared_gradient, local_gradient
        Each view's part of the shared gradient, shape (v, d), and its own, shape (v, 6).
    """

    shared: Floats
    coupling: Floats
    local: Floats
    shared_gradient: Floats
    local_gradient: Floats

    def step(self, damping: float) -> tuple[Floats, Floats]:
        """Return Marquardt's step for the shared unknowns, (d,), and each view's own, (v, 6)."""
        scale = 1 + damping
        local = self.local * (1 + (scale - 1) * np.eye(6))
        total = self.shared.sum(axis=0)
        total = total + (scale - 1) * np.diag(np.diag(total))
        back = np.linalg.solve(local, np.swapaxes(self.coupling, 1, 2))
        mine = np.linalg.solve(local, self.local_gradient[..., None])[..., 0]
        reduced = total - np.einsum("vdi,vie->de", self.coupling, back, optimize=True)
        gradient = self.shared_gradient.sum(axis=0) - np.einsum("vdi,vi->d", self.coupling, mine)
        shared_step = -solve_scaled(reduced, gradient)
        return shared_step, -(mine + back @ shared_step)

    def reduced(self) -> tuple[Floats, Floats]:
        """Return each view's information on the shared unknowns, (v, d, d), and score, (v, d).

        Both are what remains of a view once its own six unknowns are eliminated.
        """
        back = np.linalg.solve(self.local, np.swapaxes(self.coupling, 1, 2))
        mine = np.linalg.solve(self.local, self.local_gradient[..., None])
        information = self.shared - self.coupling @ back
        score = self.shared_gradient - (self.coupling @ mine)[..., 0]
        return information, score


def solve_scaled(matrix: Floats, right: Floats) -> Floats:
    """Solve a positive definite system after scaling its diagonal to one.

    Shared unknowns mix pixels, radians and mm; scaling removes nine decades of conditioning.
    """
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    scaled = matrix * scale[:, None] * scale
    rows = scale if right.ndim == 1 else scale[:, None]
    solution: Floats = rows * np.linalg.solve(scaled, rows * right)
    return solution


def minimise(
    state: State,
    *,
    linearise: Callable[[State], NormalEquations],
    cost: Callable[[State], float],
    moved: Callable[[State, Floats, Floats], State],
    floor: float,
    tolerance: float,
) -> State:
    """Levenberg–Marquardt until a step lowers the cost by less than a fraction `tolerance`.

    Parameters
    ----------
    state
        The start.
    linearise, cost
        Normal equations and sum of squares at a state; an infinite cost refuses the state.
    moved
        The state after a step of the shared and of each view's unknowns.
    floor
        Cost below which the fit is exact to rounding.
    tolerance
        Relative fall of the cost at which to stop.

    Raises
    ------
    CalibrationError
        If it does not settle within 100 steps or the equations have no solution.

    References
    ----------
    Marquardt (1963), doi:10.1137/0111030; Triggs et al. (2000), doi:10.1007/3-540-44480-7_21.
    """
    damping, best = 1e-4, cost(state)
    for _ in range(100):
        equations = linearise(state)
        while damping < 1e8:
            trial = _trial(state, equations, damping, moved)
            value = np.inf if trial is None else cost(trial)
            if trial is not None and value <= best:
                break
            damping = max(10 * damping, 1e-8)
        else:
            return state  # no direction lowers the cost: rounding is all that is left
        settled = best - value <= tolerance * best or value <= floor
        state, best, damping = trial, value, 0.1 * damping if damping > 1e-10 else 0.0
        if settled:
            return state
    raise CalibrationError(
        "the least-squares fit of the board views did not settle within 100 steps",
        next_step="add board views that are tilted in several directions and fill the image, or "
        "choose a distortion model of fewer coefficients",
    )


def _trial(
    state: State,
    equations: NormalEquations,
    damping: float,
    moved: Callable[[State, Floats, Floats], State],
) -> State | None:
    try:
        return moved(state, *equations.step(damping))
    except np.linalg.LinAlgError:
        return None
