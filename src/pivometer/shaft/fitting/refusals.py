"""When a fit does not show the two edges of the seed.

A reason does not name the camera: whoever hears it knows whose image it was.
"""

from __future__ import annotations

import numpy as np

from pivometer.cameras.model import Camera
from pivometer.errors import ShaftNotFoundError
from pivometer.shaft.fitting.evidence import BLURS_ACROSS, blurs_meet
from pivometer.shaft.fitting.fitted import FittedEdges
from pivometer.shaft.fitting.lines import Lines, width_px
from pivometer.shaft.seed import ShaftSeed

LEAST_ROWS = 20
LEAST_ROW_PART = 0.25
LEAST_CONTRAST_NOISES = 2.0
LARGEST_SIGMA_PX = 0.5
LEAST_WIDTH_PX = 3.0
SEED_WIDTH_PX = 4.0
SEED_WIDTH_PART = 0.2
LARGEST_TAPER = 0.5
FARTHEST_PX = 4.0
LARGEST_OVERSHOOT = 2.0
LEAST_SHOWN = 0.5
SINGLE = ("ramp", "limb", "clutter")
"""Refusals: fewer rows than 20 or a quarter of the seed's; contrast under twice the noise; an
edge known to no better than half a pixel; edges closer than 3 px, or whose distance differs from
the seed's by more than two seeds' errors and a fifth, or from end to end by more than a half; an
end that a fit moved by 4 px from where the search saw a grey step, which is good to 1 px; a grey
step over twice the range of grey levels seen beside the edge: levels are then extrapolated to what
no pixel shows, beside a highlight or a lane of brushed metal. In 14 drawn sessions 60 of 69 such
edges were over 0.5 px off, the others 0.15 to 0.49 px; an edge beside which the background shows
in less than half of the chunks that tell. Shadings of `SINGLE` have windows of one edge each."""


def strays(fitted: FittedEdges) -> bool:
    """Tell whether a fit left the edges that it started from."""
    moves = np.abs(fitted.parameters[:4].reshape(2, 2))
    return bool(moves.sum(axis=1).max() > FARTHEST_PX)


def extrapolates(fitted: FittedEdges) -> bool:
    """Tell whether a fit states a grey step that its pixels do not show."""
    return bool(fitted.overshoot.max() > LARGEST_OVERSHOOT)


def refuse_fit(fitted: FittedEdges, seed: Lines) -> None:
    """Raise `ShaftNotFoundError` where the fit does not show the two edges of the seed."""
    lines = fitted.lines
    if strays(fitted):
        raise ShaftNotFoundError(
            "no model of grey levels fits the edges that are seen; the last "
            f"one tried left them by over {FARTHEST_PX:.0f} px",
            next_step="look at the picture: what is beside the shaft, or shines on it?",
        )
    if extrapolates(fitted):
        raise ShaftNotFoundError(
            f"the step at an edge would be {fitted.overshoot.max():.1f} "
            "times the range of grey levels seen there, so a highlight passes for it",
            next_step="soften the light, or put a background behind the shaft that differs from it",
        )
    if (fitted.shown_part < LEAST_SHOWN).any():
        raise ShaftNotFoundError(
            "beside an edge that was found, what stands behind the shaft "
            "does not show, so it is not the shaft's edge, or something hides it",
            next_step="soften the light, or put a background behind the shaft that differs from it",
        )
    refuse_width(width_px(lines), width_px(seed))
    _refuse_meeting(fitted)
    gaps = [
        float(abs((lines[0].at(np.array(lever)) - lines[1].middle_px) @ lines[1].outward))
        for lever in (-1.0, 1.0)
    ]
    if min(gaps) < (1 - LARGEST_TAPER) * max(gaps):
        raise ShaftNotFoundError(
            f"the edges found are {gaps[0]:.1f} px apart at one end and "
            f"{gaps[1]:.1f} px at the other, not nearly parallel",
            next_step="look at the overlay and give a hint for this pose",
        )
    sigma, noise = fitted.sigmas()[0], fitted.noise_grey
    for edge, name in enumerate(("first", "second")):
        count, total = int(fitted.accepted[edge].sum()), int(fitted.counted[edge].sum())
        if count < max(LEAST_ROWS, LEAST_ROW_PART * total):
            raise ShaftNotFoundError(
                f"only {count} of {total} rows show the {name} edge of the "
                "shaft as one straight line",
                next_step="look for what hides the shaft or crosses it, or shorten the region",
            )
        contrast = fitted.contrast[edge]
        if contrast < LEAST_CONTRAST_NOISES * noise or sigma[edge] > LARGEST_SIGMA_PX:
            raise ShaftNotFoundError(
                f"the {name} edge has a contrast of {contrast:.1f} grey "
                f"levels at a noise of {noise:.1f} and is known to {sigma[edge]:.2f} px only",
                next_step="put a background behind the shaft that differs from it in brightness",
            )


def _refuse_meeting(fitted: FittedEdges) -> None:
    """Raise `ShaftNotFoundError` where a window of one edge sees the other's blur."""
    width, blur = width_px(fitted.lines), float(fitted.parameters[4])
    if fitted.shading in SINGLE and not fitted.together and blurs_meet(width, blur):
        raise ShaftNotFoundError(
            f"the edges are {width:.0f} px apart and blurred by {blur:.1f} px, so that their blurs "
            "meet, and no model of both together holds",
            next_step="focus the camera on the shaft, stop its lens down, or come so close that "
            f"the shaft is {BLURS_ACROSS:.0f} blurs wide",
        )


def refuse_outside(camera: Camera, seed: ShaftSeed) -> None:
    """Raise `ShaftNotFoundError` unless both edges of the seed cross a good part of the image."""
    lever = np.linspace(0, 1, 101)[:, None]
    for start, end in seed.edges_px:
        points = start + lever * (end - start)
        limit = np.array([camera.width - 1, camera.height - 1])
        inside = ((points >= 0) & (points <= limit)).all(axis=1)
        length = float(inside.mean() * np.hypot(*(end - start)))
        if length < LEAST_ROWS:
            raise ShaftNotFoundError(
                f"only {length:.0f} px of an edge of the seed lie inside the "
                f"image, outside of which nothing is seen; {LEAST_ROWS} px are needed",
                next_step="check the hint or the region of this pose",
            )


def refuse_width(width_px: float, seed_px: float) -> None:
    """Raise `ShaftNotFoundError` where the edges are not as far apart as the seed's."""
    allowed = SEED_WIDTH_PX + SEED_WIDTH_PART * seed_px
    if width_px < LEAST_WIDTH_PX or abs(width_px - seed_px) > allowed:
        raise ShaftNotFoundError(
            f"the edges found are {width_px:.1f} px apart, where the seed "
            f"has {seed_px:.1f} px and at least {LEAST_WIDTH_PX:.0f} px are needed",
            next_step="look at the overlay; move the camera closer if the shaft is this thin",
        )
