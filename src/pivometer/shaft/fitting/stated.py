"""What is stated of two fitted edges."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pivometer._arrays import Floats, checked, read_only
from pivometer.cameras.model import Camera
from pivometer.shaft.fitting.evidence import DEVIATIONS, evidence
from pivometer.shaft.fitting.fitted import FittedEdges
from pivometer.shaft.fitting.lines import Lines, width_px

POINTS = 25
"""Points given along each edge: enough for an overlay and for undoing another distortion."""


@dataclass(frozen=True, slots=True, eq=False)
class ShaftEdges:
    """The two edges of a shaft in one image, as independent straight lines.

    Parameters
    ----------
    camera
        Name of the camera.
    points_px
        Points along each edge in the raw image, shape (2, m, 2), px: exactly on the fitted line
        once undistorted.
    normals
        Coimage normals of the edges, shape (2, 3), unit, pointing away from the shaft, camera
        frame; (6).
    normals_covariance
        Covariance of both normals as one vector of six, shape (6, 6).
    sigma_px
        Standard uncertainty of each edge's offset where it is known best, shape (2,), px.
    angle_sigma_rad
        Standard uncertainty of each edge's angle, shape (2,), rad.
    width_px
        Distance between the edges half-way along, undistorted px.
    contrast
        Mean grey step across each edge, shape (2,), grey levels, whichever side is brighter.
    blur_px
        Standard deviation of the blur across the edges, lens and pixel together, px.
    residual_px
        Root mean square of single rows' offsets from the fitted edges, px.
    used_part
        Part of each edge's rows that counts, shape (2,).
    shading
        The model of the grey levels that the fit needed: "flat", "ramp", "limb", "matt" or
        "highlight" where that of the whole width was fitted, or "clutter" where every row has a
        background of its own.
    saturated_part
        Part of the pixels beside each edge at the sensor's largest grey level, shape (2,).
    curvature_px, curvature_sigma_px
        Sagitta of a parabola through each edge's rows over their whole length, raw px, positive if
        the middle lies outward, and its standard uncertainty, shape (2,).
    deviation_px, deviation_sigma_px
        Mean offset of the rows from the fitted line, outward, raw px, in sections of equal length
        between the ends of `points_px`, and its standard uncertainty, shape (2, DEVIATIONS);
        both are 0 in a section where no row counts.
    warnings
        What makes these edges less certain than they look, one sentence each.
    """

    camera: str
    points_px: Floats
    normals: Floats
    normals_covariance: Floats
    sigma_px: Floats
    angle_sigma_rad: Floats
    width_px: float
    contrast: Floats
    blur_px: float
    residual_px: float
    used_part: Floats
    shading: str = "flat"
    saturated_part: Floats = field(default_factory=lambda: np.zeros(2))
    curvature_px: Floats = field(default_factory=lambda: np.zeros(2))
    curvature_sigma_px: Floats = field(default_factory=lambda: np.zeros(2))
    deviation_px: Floats = field(default_factory=lambda: np.zeros((2, DEVIATIONS)))
    deviation_sigma_px: Floats = field(default_factory=lambda: np.zeros((2, DEVIATIONS)))
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        shapes: dict[str, tuple[int | None, ...]] = {
            "points_px": (2, None, 2),
            "normals": (2, 3),
            "normals_covariance": (6, 6),
            "sigma_px": (2,),
            "angle_sigma_rad": (2,),
            "contrast": (2,),
            "used_part": (2,),
            "saturated_part": (2,),
            "curvature_px": (2,),
            "curvature_sigma_px": (2,),
            "deviation_px": (2, None),
            "deviation_sigma_px": (2, None),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, read_only(checked(getattr(self, name), shape, name)))


def shaft_edges(camera: Camera, fitted: FittedEdges) -> ShaftEdges:
    """Return what is stated of fitted edges."""
    lines = fitted.lines
    normals, by_parameters = _normals(camera, fitted.start, lines)
    sigma, angle = fitted.sigmas()
    total = np.maximum(fitted.weight.sum(), 1e-12)
    width = width_px(lines)
    found = evidence(fitted)
    return ShaftEdges(
        camera=camera.name,
        points_px=_points(camera, fitted, lines),
        normals=normals,
        normals_covariance=by_parameters @ fitted.covariance[:4, :4] @ by_parameters.T,
        sigma_px=sigma,
        angle_sigma_rad=angle,
        width_px=width,
        contrast=fitted.contrast,
        blur_px=float(fitted.parameters[4]),
        residual_px=float(np.sqrt((fitted.weight * fitted.offset_px**2).sum() / total)),
        used_part=fitted.accepted.sum(axis=1) / np.maximum(fitted.counted.sum(axis=1), 1),
        shading=fitted.shading,
        saturated_part=fitted.saturated_part,
        curvature_px=found.curvature_px,
        curvature_sigma_px=found.curvature_sigma_px,
        deviation_px=found.deviation_px,
        deviation_sigma_px=found.deviation_sigma_px,
        warnings=found.warnings,
    )


def _points(camera: Camera, fitted: FittedEdges, lines: Lines) -> Floats:
    """Return raw points on both edges between their first and last rows that count."""
    along = []
    for used, lever, line in zip(fitted.accepted, fitted.lever, lines, strict=True):
        along.append(line.at(np.linspace(lever[used].min(), lever[used].max(), POINTS)))
    normalized = (np.stack(along) - camera.principal_point_px) / camera.focal_px
    raw = camera.pixels_from_normalized(normalized)
    # The first row's pixel is in the image; its foot on the edge may be a part of a pixel outside.
    limit = [camera.width - 1, camera.height - 1]
    outside = np.clip(raw, 0, limit) != raw
    return raw if not outside.any() else _inside(camera, lines, raw, limit)


def _inside(camera: Camera, lines: Lines, raw: Floats, limit: list[int]) -> Floats:
    """Return points on both edges between the first and last of 500 that lie in the image."""
    ends = camera.undistorted_pixels(raw[:, [0, -1]])
    along = []
    for (first, last), _ in zip(ends, lines, strict=True):
        fine = first + np.linspace(0, 1, 20 * POINTS)[:, None] * (last - first)
        pixels = camera.pixels_from_normalized((fine - camera.principal_point_px) / camera.focal_px)
        seen = fine[((pixels >= 0) & (pixels <= limit)).all(axis=1)][[0, -1]]
        along.append(seen[0] + np.linspace(0, 1, POINTS)[:, None] * (seen[1] - seen[0]))
    normalized = (np.stack(along) - camera.principal_point_px) / camera.focal_px
    return camera.pixels_from_normalized(normalized)


def _normals(camera: Camera, start: Lines, lines: Lines) -> tuple[Floats, Floats]:
    """Return both coimage normals (2, 3) and their derivatives by offsets and tilts (6, 4).

    A normal is c₁ × c₂ / ‖…‖ for the rays c of the edge's ends, and the ends move along the
    starting line's normal.
    """
    ends = np.stack([[line.start_px, line.end_px] for line in lines])
    rays = np.ones((2, 2, 3))
    rays[..., :2] = (ends - camera.principal_point_px) / camera.focal_px
    moves = np.zeros((2, 3, 1))
    moves[:, :2, 0] = np.stack([line.outward for line in start]) / camera.focal_px
    first, second = rays[:, 0], rays[:, 1, :, None]
    cross = (_skew(first) @ second)[..., 0]
    outward = np.where(cross @ rays.mean(axis=(0, 1)) > 0, -1.0, 1.0)
    length = np.sqrt((cross * cross).sum(axis=1)) * outward
    normals = cross / length[:, None]
    by_start, by_end = _skew(moves[..., 0]) @ second, _skew(first) @ moves
    both = np.concatenate([by_start + by_end, by_end - by_start], axis=2) / length[:, None, None]
    across = both - normals[..., None] * (normals[:, None] @ both)
    derivatives = np.zeros((6, 4))
    derivatives[:3, :2], derivatives[3:, 2:] = across
    return normals, derivatives


def _skew(v: Floats) -> Floats:
    """Return [v]× of shape (n, 3, 3), so that [v]× w = v × w; `np.cross` takes 50 µs."""
    skew = np.zeros((len(v), 3, 3))
    for (row, column), value in zip(((2, 1), (0, 2), (1, 0)), v.T, strict=True):
        skew[:, row, column], skew[:, column, row] = value, -value
    return skew
