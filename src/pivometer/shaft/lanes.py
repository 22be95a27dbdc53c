"""An edge of a shaft of whatever shading, before a known background that changes along it.

Lanes of brushed metal beside an edge look like the edge in every row, and no few terms have their
shape. Here the grey level at each distance from the edge is free in every chunk of rows, so that
shading tells nothing. What is left tells where the edge is: how far in the picture follows the
changes of the background from row to row, B Φ(x/s) about their mean.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pivometer._arrays import Floats
from pivometer.shaft.rungs import OUT, Blur, Rest, Rung, terms_of
from pivometer.shaft.samples import Behind, Samples

WINDOW = Rung(3.5, 4.0, (OUT,))
KNOT_PX = 0.5
"""The free profile is linear between places so far apart: blur leaves nothing finer."""

ITERATIONS = 15
CONVERGED_CHI2 = 0.04
"""A step that gains less moves no estimate by more than a fifth of its uncertainty."""

STEP_LIMIT_PX = np.array([0.5, 0.5, 0.2])
BLUR_RANGE_PX = (0.3, 4.0)
FARTHEST_PX = 2.0
"""An edge that goes so far from where the ladder found it is another one."""


@dataclass(frozen=True, slots=True, eq=False)
class Lanes:
    """Offset and tilt of an edge, px, their covariance by noise alone (2, 2), and what is left."""

    parameters: Floats
    covariance: Floats
    rest: Rest


def fit_lanes(
    samples: Samples, behind: Behind, parameters: Floats, widen: float, blur: Blur, noise: float
) -> Lanes | None:
    """Return an edge by the background's changes; None where they do not lead to one.

    Parameters
    ----------
    samples
        The single pixels of one edge.
    behind
        The background there.
    parameters
        Where the ladder found the edges, and the blur, shape (5,).
    widen
        What the window is multiplied by.
    blur
        What is known of the blur.
    noise
        Standard deviation of a pixel, grey levels.
    """
    at = 2 * int(samples.edge[0])
    x = samples.moved(parameters)
    low, high = -WINDOW.inner_px * widen, WINDOW.outer_px * widen
    count = samples.count * ((x > low) & (x < high))
    changes = replace(samples, count=count, behind=_changes(behind, x, count))
    profile = _hats(x, np.linspace(low, high, round((high - low) / (KNOT_PX * widen)) + 1))
    own, prior = parameters[[at, at + 1, 4]], (noise / blur.sigma_px) ** 2
    for _ in range(ITERATIONS):
        rest = _linearized(changes, profile, own)
        normal, gradient = rest.information.sum(axis=0), rest.gradient.sum(axis=0)
        normal[2, 2] += prior
        gradient[2] += (blur.mean_px - own[2]) * prior
        normal[range(3), range(3)] += 1e-9 * normal.diagonal() + 1e-9
        inverse = np.asarray(np.linalg.inv(normal))
        step = inverse @ gradient
        own = own + np.clip(step, -STEP_LIMIT_PX, STEP_LIMIT_PX)
        own[2] = np.clip(own[2], *BLUR_RANGE_PX)
        if np.abs(own[:2] - parameters[at : at + 2]).sum() > FARTHEST_PX:
            return None
        if gradient @ step < CONVERGED_CHI2 * noise**2:
            return Lanes(own[:2], inverse[:2, :2] * noise**2, rest)
    return None


def _changes(behind: Behind, x: Floats, count: Floats) -> Behind:
    """Return the background less each chunk's parabola across.

    A profile that is linear between its knots leaves a little of the parabola times Φ, which would
    pass for the edge: at a mean of 120 levels for more of it than changes of 2 levels tell.
    """
    basis = np.stack([np.ones_like(x), x, x * x], axis=1)
    weighted = basis * count[:, None]
    gram = weighted @ np.swapaxes(basis, -1, -2) + 1e-9 * np.eye(3)
    levels = np.linalg.solve(gram, weighted @ behind.grey[..., None])[..., 0]
    ramp = levels[:, 1:2] + 2 * levels[:, 2:] * x
    return Behind(behind.grey - (levels[:, None] @ basis)[:, 0], behind.slope - ramp)


def _hats(x: Floats, knots: Floats) -> Floats:
    """Return 1 at each knot, falling to 0 at the next ones, shape (chunks, knots, p)."""
    hats: Floats = 1 - np.abs(x[:, None] - knots[:, None]) / (knots[1] - knots[0])
    return np.maximum(hats, 0.0)


def _linearized(samples: Samples, profile: Floats, own: Floats) -> Rest:
    """Return what is left of each chunk with offset, tilt and blur of the edge as given."""
    x = samples.x_px - samples.scale * (own[0] + own[1] * samples.lever)
    root = np.sqrt(samples.count)
    seen, slope, spread = terms_of(x, float(own[2]), samples, WINDOW, slice(None))
    values = np.concatenate([seen, profile], axis=1) * root[:, None]
    gram = values @ np.swapaxes(values, -1, -2)
    size = np.trace(gram, axis1=-2, axis2=-1)[:, None, None]
    gram += (1e-9 * size + 1e-9) * np.eye(gram.shape[-1])
    grey = root * samples.grey
    levels = np.linalg.solve(gram, values @ grey[..., None])
    gain = levels[:, 0] * root
    columns = np.empty((len(x), 4, x.shape[1]))
    columns[:, 0] = -samples.scale * gain * slope[:, 0]
    columns[:, 1] = columns[:, 0] * samples.lever
    columns[:, 2] = gain * spread[:, 0]
    columns[:, 3] = grey - (np.swapaxes(levels, -1, -2) @ values)[:, 0]
    mixed = values @ np.swapaxes(columns, -1, -2)
    rest = columns @ np.swapaxes(columns, -1, -2)
    rest -= np.swapaxes(mixed, -1, -2) @ np.linalg.solve(gram, mixed)
    return Rest(
        information=rest[:, :3, :3],
        gradient=rest[:, :3, 3],
        contrast=np.zeros(len(x)),
        x_px=x,
        count=samples.count,
        residual=columns[:, 3],
        jacobian=columns[:, :3],
        edge=samples.edge,
        terms=gram.shape[-1],
    )
