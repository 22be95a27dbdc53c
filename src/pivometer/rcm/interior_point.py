"""The smallest t with ½‖Pᵢq − rᵢ‖² ≤ t for all i, and a proof that it is the smallest.

This is (3) without its τᵢ: four unknowns, q and t. A primal-dual interior point of O(n) a step
finds which constraints decide, Newton's method on their optimality conditions makes the point
exact, and their multipliers prove it. Lengths are in units of the largest ‖rᵢ‖.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.errors import DegenerateGeometryError

Indices = NDArray[np.intp]

GOOD_GAP = 2e-15
"""A relative duality gap at the level of rounding, at which there is nothing left to improve."""

CLOSE = 1e-4
"""Complementarity, relative to t, from which the deciding constraints show: √1e-4 ≪ weights."""

MOST_ACTIVE = 12
"""Four lines decide, unless several are at the same distance by symmetry or repetition."""

INTERIOR_STEPS = 80
"""Usual problems are close after 3 to 8 steps; symmetric ones go on to about 15."""


@dataclass(frozen=True, slots=True, eq=False)
class Optimum:
    """A point, the largest distance from it, and the weights that prove how small it can be.

    Parameters
    ----------
    point
        q, shape (3,).
    largest
        max ‖Pᵢq − rᵢ‖.
    active, weights
        The deciding constraints and their multipliers, which sum to 1, shape (k,) each.
    least
        What `largest` cannot be less than at any point.
    """

    point: Floats
    largest: float
    active: Indices
    weights: Floats
    least: float

    @property
    def gap(self) -> float:
        """How far `largest` may be above the least possible, relative to it."""
        return 1 - self.least / self.largest

    def times(self, scale: float, active: Indices | None = None) -> Optimum:
        """Return the optimum with lengths times `scale`, and its constraints renumbered."""
        return Optimum(
            self.point * scale,
            self.largest * scale,
            self.active if active is None else active[self.active],
            self.weights,
            self.least * scale,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Constraints:
    """The constraints ½‖Pᵢq − rᵢ‖² ≤ t.

    Parameters
    ----------
    projectors
        The Pᵢ, shape (n, 3, 3).
    offsets
        The rᵢ, shape (n, 3); the longest has length 1.
    guard
        A small positive definite matrix, shape (3, 3). It keeps Newton's matrix regular where the
        deciding lines leave a direction open, shortens the steps in that direction and does not
        move their goal.
    """

    projectors: Floats
    offsets: Floats
    guard: Floats

    def optimum(self) -> Optimum:
        """Approach the optimum from inside; once the deciding constraints show, jump to it."""
        best: Optimum | None = None
        for unknowns, weights, slacks in self._approach():
            for active in _deciding(weights, slacks):
                start = unknowns, weights[active]
                for trial_unknowns, trial_weights in (self._jump(*start, active), start):
                    found = self._certified(trial_unknowns[:3], active, trial_weights)
                    if best is None or found.gap < best.gap:
                        best = found
                    if best.gap <= GOOD_GAP:
                        return best
        if best is None:
            raise DegenerateGeometryError(
                f"the minimax RCM of {len(self.offsets)} lines could not be approached",
                next_step="look for lines that are almost parallel or very far from the others",
            )
        return best

    def _approach(self) -> Iterator[tuple[Floats, Floats, Floats]]:
        """Mehrotra's predictor and corrector; yields (q, t), weights and slacks once close."""
        rows = np.full((len(self.offsets), 4), -1.0)  # gradients of the constraints in (q, t)
        rows[:, :3] = misses = -self.offsets
        costs = 0.5 * np.vecdot(misses, misses)
        unknowns = np.array([0.0, 0.0, 0.0, 1.1 * costs.max()])
        slacks = unknowns[3] - costs
        weights = 1 / slacks
        weights /= weights.sum()
        for _ in range(INTERIOR_STEPS):
            lag = unknowns[3] - costs - slacks
            try:
                step, slack_step, weight_step = self._newton_step(rows, lag, weights, slacks)
            except np.linalg.LinAlgError:  # as near as rounding allows
                return
            length = _step_length(slack_step / slacks, weight_step / weights)
            unknowns = unknowns + length * step
            slacks = slacks + length * slack_step
            weights = weights + length * weight_step
            rows[:, :3] = misses = self.misses(unknowns[:3])
            costs = 0.5 * np.vecdot(misses, misses)
            complementarity = float(slacks.dot(weights))
            if complementarity < CLOSE * unknowns[3]:
                yield unknowns, weights, slacks
            if complementarity < 1e-18:
                return

    def _newton_step(
        self, rows: Floats, lag: Floats, weights: Floats, slacks: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return the steps of (q, t), of the slacks and of the weights.

        Optimality: Σ wᵢ∇ᵢ = 0, Σ wᵢ = 1, sᵢ = t − fᵢ and wᵢsᵢ = 0. `rows` are (∇ᵢ, −1) and `lag`
        is what the third lacks. Eliminating the steps of s and w leaves four equations.
        """
        ratios = weights / slacks
        matrix = (rows.T * ratios) @ rows
        matrix[:3, :3] += self.curvature(weights) + self.guard
        inverse = np.linalg.inv(matrix)
        pull = ratios * lag

        def step_towards(target: Floats | float) -> tuple[Floats, Floats, Floats]:
            right = (pull - target) @ rows
            right[3] -= 1
            step = inverse @ right
            slack_step = lag - rows @ step
            return step, slack_step, target - weights - ratios * slack_step

        _, slack_step, weight_step = step_towards(0.0)
        length = _step_length(slack_step / slacks, weight_step / weights)
        before = slacks.dot(weights)
        after = (slacks + length * slack_step).dot(weights + length * weight_step)
        centre = before / len(slacks) * (after / before) ** 3
        return step_towards((centre - slack_step * weight_step) / slacks)

    def misses(self, point: Floats) -> Floats:
        """Return Pᵢq − rᵢ, shape (n, 3): the constraints' gradients."""
        misses: Floats = (self.projectors.reshape(-1, 3) @ point).reshape(-1, 3) - self.offsets
        return misses

    def curvature(self, weights: Floats) -> Floats:
        """Return Σ wᵢPᵢ, shape (3, 3)."""
        curvature: Floats = (weights @ self.projectors.reshape(-1, 9)).reshape(3, 3)
        return curvature

    def _jump(self, unknowns: Floats, weights: Floats, active: Indices) -> tuple[Floats, Floats]:
        """Solve the optimality conditions of the active constraints alone, by Newton's method.

        The conditions are Σ wᵢ(Pᵢq − rᵢ) = 0, Σ wᵢ = 1 and ½‖Pᵢq − rᵢ‖² = t.
        """
        count = len(active)
        if count > MOST_ACTIVE:
            return unknowns, weights
        chosen = Constraints(self.projectors[active], self.offsets[active], self.guard)
        # The guard and its dual counterpart keep the matrix regular where a direction is open or a
        # constraint is given twice; at the solution the right-hand side vanishes all the same.
        matrix = np.diag(np.repeat([0.0, -1e-10], [4, count]))
        matrix[3, 4:] = matrix[4:, 3] = -1
        lack = np.empty(4 + count)
        for _ in range(6):
            misses = chosen.misses(unknowns[:3])
            matrix[:3, :3] = chosen.curvature(weights) + self.guard
            matrix[:3, 4:] = misses.T
            matrix[4:, :3] = misses
            lack[:3] = -weights @ misses
            lack[3] = weights.sum() - 1
            lack[4:] = unknowns[3] - 0.5 * np.vecdot(misses, misses)
            try:
                step = np.linalg.solve(matrix, lack)
            except np.linalg.LinAlgError:  # a wrong guess of what decides; its bound will show it
                break
            unknowns = unknowns + step[:4]
            weights = weights + step[4:]
            if step.dot(step) < 1e-18:
                break
        return unknowns, weights

    def _certified(self, point: Floats, active: Indices, weights: Floats) -> Optimum:
        """Return the largest distance from a point, and the bound that the weights prove.

        For weights that sum to 1, max dᵢ² ≥ Σ wᵢdᵢ², of which the least value over all points is
        Σ wᵢ‖eᵢ‖² − gᵀH⁻¹g with eᵢ = Pᵢq − rᵢ, g = Σ wᵢeᵢ and H = Σ wᵢPᵢ.
        """
        misses = self.misses(point)
        squares = np.vecdot(misses, misses)
        weights = np.maximum(weights, 0)
        total = float(weights.sum())
        if not 0 < total < np.inf:  # a failed jump proves nothing
            return Optimum(point, np.inf, active, weights, 0.0)
        weights = weights / total
        curvature = (weights @ self.projectors.reshape(-1, 9)[active]).reshape(3, 3)
        values, vectors = np.linalg.eigh(curvature)
        slope = (weights @ misses[active]) @ vectors
        # Where H is singular g vanishes with it, except for rounding.
        curved = values > 1e-13 * values[2]
        drop = (slope[curved] ** 2 / values[curved]).sum()
        least = float(np.sqrt(max(weights.dot(squares[active]) - drop, 0.0)))
        return Optimum(point, float(np.sqrt(squares.max())), active, weights, least)


def _deciding(weights: Floats, slacks: Floats) -> Iterator[Indices]:
    """Yield which constraints decide: near the optimum either the weight or the slack vanishes.

    Two to four suffice; the heaviest of those that show are the next guesses, for problems in which
    an outlier a million times farther than the rest blurs the difference.
    """
    active = np.flatnonzero(weights > slacks)
    yield active
    by_weight = active[np.argsort(-weights[active])]
    for count in (4, 3, 2):
        if count < len(active):
            yield by_weight[:count]


def _step_length(slack_change: Floats, weight_change: Floats) -> float:
    """Return the longest step, at most 1, that keeps slacks and weights positive."""
    steepest = -min(slack_change.min(), weight_change.min())
    return 1.0 if steepest <= 0.99 else 0.99 / float(steepest)


def smallest_ball_centre(points: Floats) -> Floats:
    """Return the centre, shape (3,), of the smallest ball that holds points of shape (n, 3).

    It is the same problem with Pᵢ = I. It is solved for the points farthest from the mean; then the
    farthest point outside the ball is added until there is none. A point at distance d from the
    mean is at most d + ‖q‖ from q, so few points need to be looked at.
    """
    mean = np.ones(len(points)) @ points / len(points)
    offsets = points - mean
    from_mean = np.sqrt(np.vecdot(offsets, offsets))
    size = float(from_mean.max())
    if size == 0:
        return np.asarray(mean)
    first = min(24, len(points))
    chosen = np.argpartition(from_mean, -first)[-first:]
    while True:
        projectors = np.tile(np.eye(3), (len(chosen), 1, 1))
        ball = Constraints(projectors, offsets[chosen] / size, 1e-10 * np.eye(3)).optimum()
        shift, radius = ball.point * size, ball.largest * size * (1 + 1e-9)
        near = np.flatnonzero(from_mean + np.linalg.norm(shift) * (1 + 1e-9) >= ball.largest * size)
        moved = offsets[near] - shift
        distances = np.where(np.isin(near, chosen), 0, np.sqrt(np.vecdot(moved, moved)))
        if distances.max(initial=0) <= radius:
            return np.asarray(mean + shift)
        chosen = np.append(chosen, near[distances.argmax()])
