"""The fit of a shaft with shading, in the widest window that holds.

A wide window tells a limb from a shift of its edge, but meets highlights that no few terms have; a
narrow one meets none, but is less certain. Each edge gets the most certain window that fits and
that agrees with the less certain ones, and what those say differently is its systematic error.
Where only narrow ones fit, the shading of the whole width may tell more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from pivometer._arrays import Floats
from pivometer.shaft.fitting.choice import Said, chosen_rung, spread_if_holds
from pivometer.shaft.fitting.evidence import saturated_part
from pivometer.shaft.fitting.fitted import FittedEdges
from pivometer.shaft.fitting.lines import halves_px, width_px
from pivometer.shaft.fitting.matt import fit_matt
from pivometer.shaft.fitting.rungs import (
    IN,
    LIMB,
    OUT,
    OUT_RAMP,
    RAMP,
    Blur,
    Rest,
    Rung,
    evaluate,
    misfits,
    solve,
)
from pivometer.shaft.fitting.samples import Behind, Samples, binned, pixels
from pivometer.shaft.fitting.strip import CHUNK_ROWS, Strip, seen_beside, strip
from pivometer.shaft.fitting.view import ShaftView
from pivometer.shaft.fitting.whole_width import fit_whole_width

ROUND = (OUT, OUT_RAMP, IN, RAMP, LIMB)
UNKNOWN = Blur()
RUNGS = (
    Rung(12.0, 6.0, ROUND),
    Rung(8.0, 6.0, ROUND),
    Rung(5.0, 5.0, ROUND),
    Rung(3.5, 4.0, ROUND),
    Rung(3.0, 3.0, (OUT, IN, RAMP)),
    Rung(2.0, 3.0, (OUT, IN, RAMP)),
)
"""A further term, (1 − ξ) √(1 − ξ²), was tried: on oblique metal it helped a little, on the white
bearing, whose point spread is not quite Gaussian, it moved edges by 0.05 px."""

FIRST, REFERENCE = RUNGS[4], RUNGS[3]
SURROUNDINGS = Rung(2.0, 6.0, (OUT, OUT_RAMP, IN, RAMP))

SYSTEMATIC_PX = 0.01
"""Added in quadrature to every shaded edge: on the white bearing (independently rendered, true
cameras) edges were 0.010 px off, and alike in all windows, which no spread between them tells."""

WHOLE_SYSTEMATIC_PX = 0.015
LARGEST_WHOLE_MISFIT = 5.0
WINDOWS_TIMES = 2.0
"""Added to each edge where the shading of the whole width is fitted, so that held-out highlights
are 1.1 stated sigmas off. The part of its misfit that a terminator causes is up to 4. It counts
while its centre is at most twice as uncertain as the windows say: in 4 of 60 scenes they were 2 to
4 sigmas off."""

LEAST_HALF_PX = 3.75
"""Half the shaft's width: narrower rungs than `REFERENCE` alone do not tell a limb."""

NOISE_PERCENTILE = 25.0
CLUTTER_TIMES = 2.0
CLEAN_PART = 0.1
CLUTTERED_PART = 0.3
LEAST_INFORMATION = 0.02
"""Rows count as showing the edge if they tell it a fiftieth as well as the usual row."""

CLEAR_PX = 3.0
"""A chunk is cluttered if, farther than this from the edge, it has twice the noise's mean square
beside a ramp. With over 3 in 10 such chunks no ramp holds; with over 1 in 10 what the frames tell
of the background is better: with a ramp drawn brushed metal before 2 to 3 in 10 was 0.4 px off."""

WITHIN_PX = 2.5
"""So far inside an edge shading is smooth along the shaft: neighbouring rows differ by noise."""

HIDDEN_PX = 4.0
"""So far inside an edge nothing of the background is seen at usual blur."""

GATE_SIGMAS = 5.0
LEAST_USED = 0.4
FIRST_ITERATIONS = 6
CONVERGING_ITERATIONS = 8
LAST_ITERATIONS = 2
FIRST_PX = 0.02
LINEAR_PX = 0.01
"""After a step that small its square over the blur is left, 0.0001 px. With 0.03 Lambert-shaded
edges were twice as far off: Lepskii compares estimates that differ by little."""

SPARE_PX = 1.0
"""Windows may move so far with their edges."""

WIDER = 1.25
STEP_LIMIT_PX = np.array([0.7, 0.7, 0.7, 0.7, 0.3])
BLUR_RANGE_PX = (0.3, 4.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Tried:
    """What a rung says: its estimate, its covariance, and how it fits each edge."""

    parameters: Floats
    covariance: Floats
    misfits: tuple[float, float]

    def of_edge(self, edge: int) -> Said:
        """Return what it says of one edge."""
        at = 2 * edge
        sigma = float(np.sqrt(self.covariance[at, at]))
        return Said(float(self.parameters[at]), sigma, self.misfits[edge])


class _Climbed(NamedTuple):
    """The fit with the chosen rung of each edge, and what all rungs with a limb say."""

    fitted: FittedEdges
    chosen: list[Rung]
    tried: list[_Tried]

    def limbs(self, edge: int) -> list[Said]:
        """Return what they say of one edge."""
        return [tried.of_edge(edge) for tried in self.tried]


@dataclass(frozen=True, slots=True, eq=False)
class _Window:
    """The image, pixels beside both edges, half the width in every row, and what lies behind."""

    view: ShaftView
    bands: Strip
    half_px: Floats
    behind: Behind | None
    blur: Blur
    range_px: Floats
    """The least and the largest distance of each column in any row, shape (2, columns), raw px."""

    @property
    def widen(self) -> float:
        return max(1.0, self.blur.mean_px)

    def reach_px(self, rung: Rung) -> tuple[float, float]:
        """Return how far a rung looks to either side if the edge moves by a pixel."""
        return -rung.inner_px * self.widen - SPARE_PX, rung.outer_px * self.widen + SPARE_PX

    def pixels(self, rung: Rung, rows: Floats) -> Samples:
        """Return the pixels that a rung looks at."""
        low, high = self.reach_px(rung)
        seen = np.flatnonzero((self.range_px[1] > low) & (self.range_px[0] < high))
        columns = slice(int(seen[0]), int(seen[-1]) + 1) if seen.size else slice(0, 1)
        return pixels(self.bands, self.half_px, rows, self.behind, columns)

    def binned(self, rung: Rung, rows: Floats, parameters: Floats) -> Samples:
        """Return the means of these pixels over bins."""
        return binned(self.pixels(rung, rows), parameters, self.reach_px(rung))


@dataclass(frozen=True, slots=True, eq=False)
class _Edges:
    """The rows of both edges that are alike, in bins, and what every evaluation needs."""

    window: _Window
    rows: Floats
    samples: Samples
    noise: float

    def step(self, rung: Rung, parameters: Floats) -> tuple[Rest, Floats, Floats]:
        """Return a rung's rest, the Gauss–Newton step from here and its covariance."""
        rest = evaluate(self.samples, rung, parameters, self.window.widen)
        return rest, *solve([rest], self.noise, self.window.blur, parameters)

    def tried(self, rung: Rung, parameters: Floats) -> _Tried:
        """Return what a rung says, after as many steps from a near start as it needs."""
        for _ in range(CONVERGING_ITERATIONS):
            rest, step, covariance = self.step(rung, parameters)
            parameters = _stepped(parameters, step)
            if np.abs(step).max() < LINEAR_PX:
                break
        return _Tried(parameters, covariance, misfits(rest, step, self.noise))


def _stepped(parameters: Floats, step: Floats) -> Floats:
    after: Floats = parameters + np.clip(step, -STEP_LIMIT_PX, STEP_LIMIT_PX)
    after[4] = np.clip(after[4], *BLUR_RANGE_PX)
    return after


def fit_ladder(
    view: ShaftView,
    background: Floats | None = None,
    blur: Blur = UNKNOWN,
    *,
    cluttered: float = CLUTTERED_PART,
) -> FittedEdges | None:
    """Return both edges of a shaded shaft, or None before clutter.

    Parameters
    ----------
    view
        The image, and the edges to a pixel or so.
    background
        What stands behind the shaft, turned likewise: an empty frame, or what `backdrop` tells;
        NaN where unknown. Rows beside such pixels do not count.
    blur
        What is known of the blur; windows widen with it.
    cluttered
        Part of the surroundings that may be clutter.
    """
    lines, widen = view.lines, max(1.0, blur.mean_px)
    if width_px(lines) / 2 < LEAST_HALF_PX * widen:
        return None
    rungs = [rung for rung in RUNGS if rung.inner_px * widen <= width_px(lines) / 2]
    reach = rungs[0].inner_px * widen + SPARE_PX, RUNGS[0].outer_px * widen + SPARE_PX
    bands = strip(view, near_px=reach)
    half = halves_px(lines, bands.lever[..., bands.lever.shape[2] // 2, None]) * bands.scale
    behind = None
    if background is not None:
        behind, known = known_behind(view, background, reach, bands.x_px)
        if (known.sum(axis=1) < LEAST_USED * np.maximum(bands.valid.sum(axis=1), 1)).any():
            return None
        bands = replace(bands, valid=bands.valid * known)
    seen = bands.x_px[bands.valid > 0] if bands.valid.any() else bands.x_px[0]
    range_px = np.stack([seen.min(axis=0), seen.max(axis=0)])
    window = _Window(view, bands, half, behind, blur, range_px)
    if behind is None and _cluttered_at_sight(window) > CLUTTERED_PART:
        return None
    first = _first(window, rungs[0], cluttered)
    if first is None:
        return None
    edges, parameters = first
    if parameters[4] > WIDER * widen:
        wider = Blur(float(parameters[4]), blur.sigma_px)
        return fit_ladder(view.moved(parameters), background, wider, cluttered=cluttered)
    climbed = _climbed(edges, rungs, parameters)
    fitted, chosen = climbed.fitted, climbed.chosen
    if behind is not None:
        return fitted
    matt = _of_matt(edges, climbed)
    if matt is not None or all(rung is rungs[0] for rung in chosen):
        return matt or fitted
    return _of_whole_width(edges, parameters, fitted) or fitted


def _of_matt(edges: _Edges, climbed: _Climbed) -> FittedEdges | None:
    """Return both edges from the matt shading of the whole width, if it holds and windows agree."""
    fitted, window = climbed.fitted, edges.window
    if any(LIMB not in rung.terms for rung in climbed.chosen):
        return None
    matt = fit_matt(
        window.view,
        edges.rows,
        fitted.parameters,
        noise=edges.noise,
        blur=window.blur,
    )
    if matt is None:
        return None
    covariance = matt.covariance.copy()
    whole = _Tried(matt.parameters, matt.covariance, matt.misfits)
    for edge in (0, 1):
        spread = spread_if_holds(whole.of_edge(edge), climbed.limbs(edge))
        if spread is None:
            return None
        at = [2 * edge, 2 * edge + 1]
        covariance[at, at] += spread**2 + SYSTEMATIC_PX**2
    return replace(fitted, parameters=matt.parameters, covariance=covariance, shading="matt")


def _of_whole_width(edges: _Edges, parameters: Floats, fitted: FittedEdges) -> FittedEdges | None:
    """Return both edges from the shading of the whole width, if that is understood better."""
    narrow = edges.tried(RUNGS[-1], parameters).parameters
    view = edges.window.view.moved(narrow)
    whole = fit_whole_width(
        view,
        edges.rows,
        noise=edges.noise,
        blur=edges.window.blur,
        blur_px=float(narrow[4]),
    )
    if whole is None or whole.misfit > LARGEST_WHOLE_MISFIT:
        return None
    covariance = whole.covariance.copy()
    covariance[range(4), range(4)] += WHOLE_SYSTEMATIC_PX**2
    if _centre_variance(covariance) > WINDOWS_TIMES**2 * _centre_variance(fitted.covariance):
        return None
    return replace(
        fitted,
        start=view.lines,
        parameters=whole.parameters,
        covariance=covariance,
        shading="highlight",
    )


def _centre_variance(covariance: Floats) -> float:
    """Return four times the variance of the midpoint between two edges, px²."""
    outward = covariance[:4:2, :4:2]
    return float(outward[0, 0] + outward[1, 1] - 2 * outward[0, 1])


def known_behind(
    view: ShaftView,
    background: Floats,
    reach_px: tuple[float, float],
    x_px: Floats,
) -> tuple[Behind, Floats]:
    """Return what stands behind the pixels that `strip` gathers, and 1 for rows where it is known.

    Parameters
    ----------
    view, reach_px, x_px
        As of the strip, and its pixels' distances.
    background
        What stands behind the shaft, turned as the image is; NaN where unknown, for which 0 stands.
    """
    grey, along_x, along_y = seen_beside(view, background, reach_px)
    # In the turned image: its normal from how the edge's column changes from row to row.
    normals = []
    for m in view.maps:
        turn = float((m.centre[-1] - m.centre[0]) / max(len(m.rows) - 1, 1))
        normals.append(m.outward * np.array([1, -turn]) / np.hypot(1, turn))
    slope = np.stack([n[0] * along_x[e] + n[1] * along_y[e] for e, n in enumerate(normals)])
    told = np.isfinite(grey) & np.isfinite(slope)
    known = (told | (x_px <= -HIDDEN_PX)).all(axis=-1)
    return Behind(np.nan_to_num(grey), np.nan_to_num(slope)), known.astype(np.float64)


def _first(window: _Window, widest: Rung, cluttered: float) -> tuple[_Edges, Floats] | None:
    """Return the edges with rows and noise, and parameters from a narrow window."""
    valid = window.bands.valid
    parameters = np.array([0.0, 0.0, 0.0, 0.0, window.blur.mean_px])
    edges = _Edges(window, valid, window.binned(FIRST, valid, parameters), 1.0)
    for _ in range(FIRST_ITERATIONS):
        _, step, _ = edges.step(FIRST, parameters)
        parameters = _stepped(parameters, step)
        if np.abs(step).max() < FIRST_PX:
            break
    rest = evaluate(window.pixels(FIRST, valid), FIRST, parameters, window.widen)
    alike = _alike_rows(rest) * valid
    if (alike.sum(axis=1) < LEAST_USED * np.maximum(valid.sum(axis=1), 1)).any():
        return None
    if alike.sum() < valid.sum():
        rest = evaluate(window.pixels(FIRST, alike), FIRST, parameters, window.widen)
    noise = _noise(rest)
    around = evaluate(window.pixels(SURROUNDINGS, alike), SURROUNDINGS, parameters, window.widen)
    if _cluttered(around, noise) > cluttered:
        return None
    samples = window.binned(widest, alike, parameters)
    edges = _Edges(window, alike, samples, noise)
    return edges, parameters


def _cluttered_at_sight(window: _Window) -> float:
    """Return the part of the chunks with other surroundings than a ramp, before anything is fitted.

    Noise is how pixels differ from those of the next row, on the side where that is more. In drawn
    and rendered sessions clutter gave over 0.3, all else at most 0.06.
    """
    bands, (least, most) = window.bands, window.range_px
    whole = bands.valid.reshape(-1, CHUNK_ROWS).min(axis=1) > 0
    grey, x = (v.reshape(len(whole), CHUNK_ROWS, -1)[whole] for v in (bands.near, bands.x_px))
    within = most < -WITHIN_PX * window.widen
    far = (least > CLEAR_PX) & (most < SURROUNDINGS.outer_px * window.widen)
    if not (whole.any() and within.any() and far.any()):
        return 0.0
    changes = (
        np.square(np.diff(grey[..., side], axis=1)).mean(axis=(1, 2)) for side in (within, far)
    )
    noise = max(1 / 12, *(float(np.percentile(c, NOISE_PERCENTILE)) / 2 for c in changes))
    grey, x = (v[..., far].reshape(len(v), -1) for v in (grey, x))
    grey, x = (v - v.mean(axis=1, keepdims=True) for v in (grey, x))
    left = np.vecdot(grey, grey) - np.vecdot(grey, x) ** 2 / np.maximum(np.vecdot(x, x), 1e-9)
    return float(np.mean(left > CLUTTER_TIMES * noise * x.shape[1]))


def _noise(rest: Rest) -> float:
    """Return the noise's standard deviation: that of the quieter chunks."""
    variance, count = rest.variance()
    variance = variance[count > 2 * CHUNK_ROWS]
    quiet = float(np.percentile(variance, NOISE_PERCENTILE)) if variance.size else 1.0
    return float(np.sqrt(max(quiet, 1 / 12)))


def _alike_rows(rest: Rest) -> Floats:
    """Return 1 for the rows whose residuals are like those of most beside the same edge."""
    count = rest.by_row(rest.count).reshape(2, -1)
    mean = rest.by_row(rest.residual**2).reshape(2, -1) / np.maximum(count, 1)
    usual = [
        float(np.median(m[c > 0])) if (c > 0).any() else 1.0
        for m, c in zip(mean, count, strict=True)
    ]
    limit = np.maximum(usual, 1 / 12)[:, None] * (
        1.2 + GATE_SIGMAS * np.sqrt(2 / np.maximum(count, 1))
    )
    return np.asarray((mean < limit) & (count > 0), dtype=np.float64)


def _cluttered(rest: Rest, noise: float) -> float:
    """Return the part of the chunks that reach so far with surroundings other than a ramp."""
    far = (rest.count > 0) & (rest.x_px > CLEAR_PX)
    count = far.sum(axis=-1)
    variance = (far * rest.residual**2).sum(axis=-1) / np.maximum(count, 1)
    other = (variance > CLUTTER_TIMES * noise**2)[count > CHUNK_ROWS]
    return float(other.mean()) if other.size else 0.0


def _climbed(edges: _Edges, rungs: list[Rung], parameters: Floats) -> _Climbed:
    """Choose each edge's rung, and fit with them."""
    reference = edges.tried(REFERENCE, parameters).parameters

    @cache
    def tried(rung: Rung) -> _Tried:
        return edges.tried(rung, reference)

    chosen, systematic, parameters = [], [], reference.copy()
    for edge in (0, 1):

        def said(rung: Rung, edge: int = edge) -> Said:
            return tried(rung).of_edge(edge)

        at = slice(2 * edge, 2 * edge + 2)
        rung, spread = chosen_rung(rungs, said)
        chosen.append(rung)
        systematic.append(spread**2 + SYSTEMATIC_PX**2)
        parameters[at] = tried(rung).parameters[at]
    window = edges.window
    if chosen[0] is chosen[1]:
        parameters = tried(chosen[0]).parameters
    else:
        rests = _of_both(edges.samples, chosen, parameters, window.widen)
        parameters = _stepped(parameters, solve(rests, edges.noise, window.blur, parameters)[0])
    samples = window.pixels(max(chosen, key=_inner), edges.rows)
    rests = _of_both(samples, chosen, parameters, window.widen)
    step, covariance = solve(rests, edges.noise, window.blur, parameters)
    parameters = _stepped(parameters, step)
    covariance = covariance * inflation(rests, edges.noise)
    covariance[range(4), range(4)] += np.repeat(systematic, 2)
    fitted = _fitted(edges, rests, parameters, covariance, chosen)
    return _Climbed(fitted, chosen, [tried(rung) for rung in rungs if LIMB in rung.terms])


def _of_both(
    samples: Samples, chosen: Sequence[Rung], parameters: Floats, widen: float
) -> list[Rest]:
    """Return the rests of both edges, each with its own rung; together if that is the same."""
    if chosen[0] is chosen[1]:
        return [evaluate(samples, chosen[0], parameters, widen)]
    return [evaluate(samples.of_edge(e), rung, parameters, widen) for e, rung in enumerate(chosen)]


def _inner(rung: Rung) -> float:
    return rung.inner_px


def _fitted(
    edges: _Edges,
    rests: Sequence[Rest],
    parameters: Floats,
    covariance: Floats,
    chosen: Sequence[Rung],
) -> FittedEdges:
    view, bands, noise = edges.window.view, edges.window.bands, edges.noise
    information = _by_edge([rest.row_information() for rest in rests])
    moment = _by_edge([rest.by_row(rest.jacobian[:, 0] * rest.residual) for rest in rests])
    usual = np.median(information, axis=1, keepdims=True)
    used = edges.rows * information > LEAST_INFORMATION * usual
    count = used.reshape(2, -1, CHUNK_ROWS).sum(axis=-1)
    contrast = _by_edge([rest.contrast() for rest in rests])
    scale = bands.scale[..., 0]
    return FittedEdges(
        start=view.lines,
        parameters=parameters,
        covariance=covariance,
        contrast=(contrast * count).sum(axis=1) / np.maximum(count.sum(axis=1), 1),
        noise_grey=noise,
        lever=bands.lever[..., bands.lever.shape[2] // 2],
        offset_px=moment / np.maximum(information, 1e-9) * scale,
        weight=information / noise**2 / scale**2,
        accepted=used,
        counted=bands.valid > 0,
        saturated_part=saturated_part(bands.near, used, view.depth),
        shading="limb" if any(LIMB in rung.terms for rung in chosen) else "ramp",
    )


def _by_edge(values: Sequence[Floats]) -> Floats:
    """Return values of both edges, told together or one after the other, shape (2, n)."""
    return np.concatenate(values).reshape(2, -1)


def inflation(rests: Sequence[Rest], noise: float) -> float:
    """Return how much the chunks' own offsets scatter beyond noise, at least 1."""
    own = np.concatenate([rest.information[:, 0, 0] for rest in rests]) * noise**2
    gradient = np.concatenate([rest.gradient[:, 0] for rest in rests])
    used = own > 1e-9
    chi2 = float((gradient[used] ** 2 / own[used]).sum())
    freedom = max(int(used.sum()) - 4, 1)
    return max(1.0, chi2 / freedom - 2 * float(np.sqrt(2 / freedom)))
