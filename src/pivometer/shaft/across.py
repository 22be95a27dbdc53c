"""Grey levels across a shaft's edges, for people to look at, with the step that was fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, read_only
from pivometer.cameras.model import Camera
from pivometer.shaft.fitting.lines import edge_lines, width_px
from pivometer.shaft.fitting.stated import ShaftEdges

REACH_PX = 8.0
STEP_PX = 0.75
"""Reach and spacing: a blurred edge is 2 to 4 px wide, and a limb's fall as much again."""

ROWS = 96
"""Places along each edge that are looked at; the median over them leaves out what crosses it."""

BILINEAR_PX = 0.41
"""Interpolation between pixels blurs by 0 to 0.5 px as the place falls, 0.41 px rms."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeProfiles:
    """The usual grey level across both edges of a shaft.

    Parameters
    ----------
    distance_px
        Distance from the fitted edge, outward, shape (k,), undistorted px.
    grey
        Median grey level along each edge at these distances, shape (2, k).
    fitted
        A step at the fitted edge with the fitted blur, its levels and the inside's slope as fit
        these grey levels best, shape (2, k).
    """

    distance_px: Floats
    grey: Floats
    fitted: Floats

    def __post_init__(self) -> None:
        for name in ("distance_px", "grey", "fitted"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


def profiles_across(image: ArrayLike, edges: ShaftEdges, camera: Camera) -> EdgeProfiles:
    """Return the grey levels across both edges.

    Nothing is measured by them: the fit has used the raw pixels, and this resamples them.

    Parameters
    ----------
    image
        The raw image, shape (height, width), any depth.
    edges
        The edges that were fitted in it.
    camera
        Its camera.
    """
    import cv2

    raw = np.asarray(image, dtype=np.float32)
    lines = edge_lines(edges.points_px[:, [0, -1]], camera)
    inward = min(REACH_PX, width_px(lines) / 2)
    distance = np.arange(-np.floor(inward / STEP_PX), REACH_PX / STEP_PX + 1) * STEP_PX
    grey = []
    for line in lines:
        along = line.at(np.linspace(-0.95, 0.95, ROWS))
        places = along[:, None] + distance[:, None] * line.outward
        pixels = camera.pixels_from_normalized(
            (places - camera.principal_point_px) / camera.focal_px
        ).astype(np.float32)
        seen = cv2.remap(
            raw, pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        grey.append(np.median(seen, axis=0))
    blur = float(np.hypot(edges.blur_px, BILINEAR_PX))
    levels = np.array(grey, dtype=np.float64)
    return EdgeProfiles(distance, levels, np.array([_step(distance, g, blur) for g in levels]))


def _step(distance: Floats, grey: Floats, blur_px: float) -> Floats:
    """Return a blurred step at zero with a sloping inside, by least squares."""
    from scipy.special import ndtr

    inside = ndtr(-distance / blur_px)
    density = np.exp(-((distance / blur_px) ** 2) / 2) * blur_px / np.sqrt(2 * np.pi)
    design = np.stack([np.ones_like(distance), inside, inside * distance - density], axis=1)
    fitted: Floats = design @ np.linalg.lstsq(design, grey, rcond=None)[0]
    return fitted
