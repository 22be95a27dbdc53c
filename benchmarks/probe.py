"""A real thin probe, far out of focus: both edges in each of its frames, beside profile fits.

Run with ``python -m benchmarks.probe [--overlays FOLDER]``. The pictures are ``parallax_probe`` of
the folder named by ``PIVOMETER_DATA``, by default ``../shared/data``: raw mosaics of 12 Mpx, no
calibration, nothing known of the truth. The shaft is found without a click. Beside its edges stand
those of one profile fit for every 60 px of it, which share nothing with the package: a bar before a
ramp on either side, each edge with its own blur, fitted by scipy to pixels that a 3 × 3 binomial
filter has freed of the mosaic. A parabola through those that are certain gives the straight line
nearest to each edge and its bow. ``--overlays`` draws each shaft straightened, its length shrunk.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

from pivometer.cameras import Camera
from pivometer.errors import ShaftNotFoundError
from pivometer.shaft.detection import find_shaft
from pivometer.shaft.edges import ShaftEdges, fit_edges
from pivometer.shaft.seed import ShaftSeed

Floats = NDArray[Any]
Grey = NDArray[np.uint8]

CAMERA = Camera("probe", 4000, 3000, np.full(2, 8000.0), np.array([1999.5, 1499.5]), np.zeros(2))
"""Any camera without distortion gives the same edges in px."""

DATA = Path(os.environ.get("PIVOMETER_DATA", Path(__file__).parents[2] / "shared" / "data"))

BLOCK_PX, REACH_PX, STEP_PX = 60, 28.0, 0.5
CERTAIN_PX, LARGEST_BLUR_PX = 0.3, 8.0
TOGETHER = 3
"""Blocks that follow one another miss alike: so many count for one."""


@dataclass(frozen=True)
class Strip:
    """The coordinates of a straightened shaft: along from one end, across from its middle line."""

    origin: Floats
    along: Floats
    across: Floats
    length: float

    @classmethod
    def of(cls, points_px: Floats) -> Strip:
        """Return that of the line midway between two edges of shape (2, m, 2)."""
        middle = points_px.mean(axis=0)
        along = (middle[-1] - middle[0]) / np.hypot(*(middle[-1] - middle[0]))
        length = float(np.hypot(*(middle[-1] - middle[0])))
        return cls(middle[0], along, np.array([-along[1], along[0]]), length)

    def pixels(self, image: Floats, t: Floats, u: Floats) -> Floats:
        """Return grey levels at places along (n,) and across (k,), NaN outside, (n, k)."""
        places = self.origin + t[:, None, None] * self.along + u[:, None] * self.across
        x, y = np.moveaxis(places.astype(np.float32), -1, 0)
        grey = image.astype(np.float32)
        return np.asarray(
            cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderValue=float("nan")), dtype=np.float64
        )

    def place(self, points_px: Floats) -> Floats:
        """Return along and across of points (..., 2)."""
        away = points_px - self.origin
        return np.stack([away @ self.along, away @ self.across], axis=-1)


def frames(folder: Path) -> list[Grey]:
    """Return the pictures."""
    files = sorted((folder / "parallax_probe").glob("*.jpg"))
    return [np.asarray(cv2.imread(str(f), cv2.IMREAD_GRAYSCALE), dtype=np.uint8) for f in files]


def block(u: Floats, grey: Floats, start: Floats) -> Floats | None:
    """Return both edges' places of a bar, their sigmas and the larger blur, or None if uncertain.

    Parameters
    ----------
    u, grey
        Places across and grey levels of pixels, shape (n,).
    start
        Where the edges roughly are.
    """

    def residual(p: Floats) -> Floats:
        one, other = ndtr((p[0] - u) / p[2]), ndtr((u - p[1]) / p[3])
        terms = [one, other, 1 - one - other, one * (u - p[0]), other * (u - p[1])]
        design = np.stack(terms, axis=1)
        levels = np.linalg.lstsq(design, grey, rcond=None)[0]
        return np.asarray(design @ levels - grey)

    reach = np.array([6.0, 6.0, 0.0, 0.0])
    first = np.append(start, [2.5, 2.5])
    low, high = first - reach, first + reach
    low[2:], high[2:] = 0.5, LARGEST_BLUR_PX
    fit = least_squares(residual, first, bounds=(low, high), x_scale=[1, 1, 0.5, 0.5])
    freedom = len(u) / (1 / STEP_PX) - 9  # neighbours are interpolated from the same pixels
    jacobian = np.asarray(fit.jac, dtype=np.float64)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * 2 * fit.cost / freedom
    sigma = np.sqrt(covariance.diagonal()[:2])
    at_bound = np.isclose(fit.x, low, atol=1e-3) | np.isclose(fit.x, high, atol=1e-3)
    if at_bound.any() or sigma.max() > CERTAIN_PX:
        return None
    return np.array([*fit.x[:2], *sigma, fit.x[2:].max()])


def profile_fits(image: Grey, strip: Strip, start: Floats) -> Floats:
    """Return (along, edge, edge, sigma, sigma, blur) of the blocks that are certain, (n, 6)."""
    binomial = np.array([0.25, 0.5, 0.25])
    smooth = cv2.sepFilter2D(image, cv2.CV_32F, binomial, binomial)
    u = np.arange(-REACH_PX, REACH_PX + STEP_PX / 2, STEP_PX)
    found = []
    for begin in np.arange(0, strip.length - BLOCK_PX + 1, BLOCK_PX):
        grey = strip.pixels(smooth, begin + np.arange(BLOCK_PX), u)
        if np.isfinite(grey).all():
            one = block(np.tile(u, BLOCK_PX), grey.ravel(), start)
            if one is not None:
                found.append(np.append(begin + BLOCK_PX / 2, one))
    return np.array(found).reshape(-1, 6)


@dataclass(frozen=True)
class Reference:
    """The line nearest to a parabola through one edge's blocks: at both ends, and its bow, px."""

    ends: Floats
    ends_sigma: Floats
    bow: float
    bow_sigma: float


def reference(blocks: Floats, edge: int, length: float) -> Reference:
    """Return it from `profile_fits`; what the blocks scatter by is its uncertainty."""
    t, y = 2 * blocks[:, 0] / length - 1, blocks[:, 1 + edge]
    design = np.stack([np.ones_like(t), t, t * t - 1 / 3], axis=1)

    def residual(c: Floats) -> Floats:
        return np.asarray(design @ c - y)

    fit = least_squares(residual, np.zeros(3), loss="soft_l1", f_scale=0.3)
    scatter = 1.4826 * float(np.median(np.abs(residual(fit.x))))
    weight = 1 / np.sqrt(1 + (residual(fit.x) / 0.3) ** 2)
    covariance = np.linalg.inv((design * weight[:, None]).T @ design) * scatter**2 * TOGETHER
    rows = np.array([[1.0, -1.0, 0.0], [1.0, 1.0, 0.0]])
    sigma = np.sqrt(np.einsum("ij,jk,ik->i", rows, covariance, rows))
    return Reference(rows @ fit.x, sigma, -float(fit.x[2]), float(np.sqrt(covariance[2, 2])))


def stated(edges: ShaftEdges, points_px: Floats) -> Floats:
    """Return the stated sigma of both edges at points of shape (2, m, 2), px."""
    rays = np.ones((*points_px.shape[:2], 3))
    rays[..., :2] = (points_px - CAMERA.principal_point_px) / CAMERA.focal_px
    sigma = []
    for edge, normal in enumerate(edges.normals):
        own = slice(3 * edge, 3 * edge + 3)
        covariance = edges.normals_covariance[own, own]
        scale = CAMERA.focal_px[0] / np.hypot(*normal[:2])
        sigma.append(np.sqrt(np.einsum("ij,jk,ik->i", rays[edge], covariance, rays[edge])) * scale)
    return np.array(sigma)


@dataclass(frozen=True)
class Compared:
    """Fitted edges less the profile fits', outward at both ends of both edges, and bows, px."""

    off: Floats  # (2, 2)
    sigma: Floats  # of both together
    stated: Floats
    bows: Floats  # fitted, its sigma, the profile fits', its sigma
    blocks: int


def compared(image: Grey, edges: ShaftEdges) -> Compared:
    """Return how fitted edges lie beside profile fits."""
    strip = Strip.of(edges.points_px)
    ends = strip.place(edges.points_px[:, [0, -1]])
    order = np.argsort(ends[:, :, 1].mean(axis=1))
    outward = np.array([-1.0, 1.0])
    blocks = profile_fits(image, strip, ends[order, :, 1].mean(axis=1))
    lines = [reference(blocks, k, strip.length) for k in (0, 1)]
    off = np.stack(
        [s * (ends[o, :, 1] - r.ends) for s, o, r in zip(outward, order, lines, strict=True)]
    )
    own = stated(edges, edges.points_px[:, [0, -1]])[order]
    theirs = np.stack([r.ends_sigma for r in lines])
    bow, u = edges.curvature_px[order], edges.curvature_sigma_px[order]
    bows = np.array(
        [
            (bow[1] - bow[0]) / 2,
            np.hypot(*u) / 2,
            (lines[0].bow + lines[1].bow) / 2,
            np.hypot(lines[0].bow_sigma, lines[1].bow_sigma) / 2,
        ]
    )
    return Compared(off, np.hypot(own, theirs), own, bows, len(blocks))


def overlay(image: Grey, edges: ShaftEdges) -> Grey:
    """Return the straightened shaft, four times as wide and a fourth as long, with its edges."""
    strip, wide, short, beyond = Strip.of(edges.points_px), 4, 4, 150
    t = np.arange(-beyond, strip.length + beyond)
    u = np.arange(-REACH_PX, REACH_PX, 1 / wide)
    grey = np.nan_to_num(strip.pixels(cv2.blur(image, (2, 2)), t, u))
    rows = len(t) // short
    grey = grey[: rows * short].reshape(rows, short, -1).mean(axis=1)
    drawn = cv2.cvtColor(np.clip(grey, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR)
    for line in strip.place(edges.points_px):
        places = np.stack([(line[:, 1] + REACH_PX) * wide, (line[:, 0] + beyond) / short], axis=1)
        cv2.polylines(drawn, [np.rint(places).astype(np.int32)], False, (0, 255, 0), 1, cv2.LINE_AA)
    return np.asarray(drawn, dtype=np.uint8)


def row(edges: ShaftEdges, beside: Compared) -> str:
    """Return a printed row."""
    ends = "".join(
        f"{off:8.2f}{own:6.2f}{both:6.2f}"
        for off, own, both in zip(
            beside.off.ravel(), beside.stated.ravel(), beside.sigma.ravel(), strict=True
        )
    )
    bow, u, theirs, their_u = beside.bows
    warned = ", ".join(warning.split(":")[0] for warning in edges.warnings)
    return (
        f"{edges.width_px:8.1f}{edges.blur_px:6.1f}{beside.blocks:8}{ends}"
        f"{bow:8.2f} ± {u:.2f}{theirs:8.2f} ± {their_u:.2f}   {warned}"
    )


def main() -> None:
    """Print a row for each frame."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--overlays", type=Path, help="folder for a picture of each shaft")
    options = parser.parse_args()
    images = frames(DATA)
    if not images:
        print(f"the pictures are not here ({DATA}); set PIVOMETER_DATA to their folder")
        return
    print("edges less those of profile fits at the four ends, their stated sigma, that of both; px")
    heads = "".join(f"{'end':>8}{'u':>6}{'both':>6}" for _ in range(4))
    print(
        f"{'':6}{'width':>8}{'blur':>6}{'blocks':>8}{heads}{'bow':>11}{'profiles':>15}   warnings"
    )
    for number, (image, seed) in enumerate(zip(images, find_shaft(images), strict=True)):
        if not isinstance(seed, ShaftSeed):
            print(f"{number:6} not found: {seed.reason}")
            continue
        try:
            edges = fit_edges(image, CAMERA, seed)
        except ShaftNotFoundError as error:
            print(f"{number:6} {error}")
            continue
        print(f"{number:6}{row(edges, compared(image, edges))}", flush=True)
        if options.overlays is not None:
            options.overlays.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(options.overlays / f"{number}.png"), overlay(image, edges))


if __name__ == "__main__":
    main()
