"""Where in each camera's image board corners were found, and how they miss."""

from functools import lru_cache

import numpy as np
from markupsafe import Markup

from pivometer._arrays import Floats
from pivometer.calibration.advice import corner_residuals
from pivometer.calibration.quality import GRID
from pivometer.calibration.result import Calibration
from pivometer.cameras.model import Camera
from pivometer.report.svg import number, picture, round_step, tag

LONGEST_PX = 0.03
"""Length of an arrow of nineteen in twenty corners at most, part of the image's width."""


@lru_cache(maxsize=1)
def coverage_pictures(calibration: Calibration) -> tuple[tuple[Markup, str], ...]:
    """Draw for each camera all corners with their residuals, and say how much larger they are.

    The page and the PDF of one report draw the same.
    """
    found = corner_residuals(calibration)
    return tuple(_coverage(camera, *found[camera.name]) for camera in calibration.rig.cameras)


def _coverage(camera: Camera, corners: Floats, residuals: Floats) -> tuple[Markup, str]:
    name = camera.name
    usual = float(np.percentile(np.linalg.norm(residuals, axis=1), 95)) if len(residuals) else 0
    times = round_step(LONGEST_PX * camera.width / usual, 1) if usual > 0 else 1.0
    arrows = "".join(
        f"M{number(x)} {number(y)}l{number(times * dx)} {number(times * dy)}"
        for (x, y), (dx, dy) in zip(corners, residuals, strict=True)
    )
    dots = "".join(f"M{number(x)} {number(y)}h0" for x, y in corners)
    width, height = float(camera.width), float(camera.height)
    cells = "".join(f"M{number(width * i / GRID[0])} 0V{number(height)}" for i in range(1, GRID[0]))
    cells += "".join(
        f"M0 {number(height * i / GRID[1])}H{number(width)}" for i in range(1, GRID[1])
    )
    pen = width / 640
    drawn = picture(
        tag(
            "rect",
            width=width,
            height=height,
            fill="none",
            stroke="currentColor",
            stroke_width=2 * pen,
        ),
        tag("path", d=cells, fill="none", stroke="currentColor", stroke_width=pen, opacity=0.2),
        tag("path", d=arrows, fill="none", stroke="#d55e00", stroke_width=1.2 * pen),
        tag(
            "path",
            d=dots,
            fill="none",
            stroke="#0072b2",
            stroke_width=3 * pen,
            stroke_linecap="round",
        ),
        width=width,
        height=height,
        title=f"{len(corners)} board corners in the image of camera {name}, with their residuals",
    )
    caption = (
        f"Camera {name}: all {len(corners)} corners used, and how far projected ones miss them, "
        f"×{times:g}. Empty cells are where the calibration is a guess; arrows that point alike "
        "show an error that is not noise."
    )
    return drawn, caption
