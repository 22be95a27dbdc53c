"""How light becomes pixels: rays through the exact lens, area coverage, point spread, noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.cameras import Camera
from pivometer.errors import UsageError

CELLS = 4
"""Cells a pixel is divided into along each axis where it holds an edge.

A blurred edge that crosses a cell is displaced by at most 0.096 h³ / 6 s² (the skewness of the
cell's two-point mass, h = 1 / CELLS, s² the variance of PSF and pixel): 0.6 mpx for a PSF of
0.6 px, and with alternating sign along any edge that is not parallel to a pixel row.
"""

MARGIN_PX = 4
"""Pixels rendered beyond the image's border, so that the PSF there blurs the scene, not a rim."""


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """View rays (x, y, 1) in the camera's frame with their derivatives by pixel, all shape (n,).

    Parameters
    ----------
    x, y
        Normalized, undistorted coordinates.
    x_u, x_v, y_u, y_v
        ∂x/∂u, ∂x/∂v, ∂y/∂u, ∂y/∂v for pixel coordinates (u, v), 1/px.
    """

    x: Floats
    y: Floats
    x_u: Floats
    x_v: Floats
    y_u: Floats
    y_v: Floats

    def select(self, index: Any) -> Rays:
        """Return the rays at `index` (anything NumPy takes), flattened."""
        parts = (self.x, self.y, self.x_u, self.x_v, self.y_u, self.y_v)
        return Rays(*(part[index].ravel() for part in parts))

    def divided(self) -> Rays:
        """Return the rays through the CELLS² cells of each pixel, pixel by pixel, row by row.

        Uses the derivatives: the second-order term is below 2e-5 px for lenses like the presets'.
        """
        centre = (np.arange(CELLS) + 0.5) / CELLS - 0.5
        v, u = (axis.ravel() for axis in np.meshgrid(centre, centre, indexing="ij"))
        derivatives = [
            np.repeat(part, CELLS * CELLS) for part in (self.x_u, self.x_v, self.y_u, self.y_v)
        ]
        x = self.x[:, None] + self.x_u[:, None] * u + self.x_v[:, None] * v
        y = self.y[:, None] + self.y_u[:, None] * u + self.y_v[:, None] * v
        return Rays(x.ravel(), y.ravel(), *derivatives)

    def directions(self) -> Floats:
        """Return the rays as vectors (x, y, 1), shape (n, 3)."""
        return np.stack([self.x, self.y, np.ones_like(self.x)], axis=-1)


def camera_rays(camera: Camera) -> Rays:
    """Return the rays of every pixel of a camera and of a margin around, undistorted exactly.

    The arrays have shape (height + 2 MARGIN_PX, width + 2 MARGIN_PX).

    Examples
    --------
    >>> rays = camera_rays(Camera("left", 64, 48, [100, 100], [32, 24], [-0.2, 0.1]))
    >>> rays.x.shape, float(rays.x[24 + MARGIN_PX, 32 + MARGIN_PX])
    ((56, 72), 0.0)
    """
    u = np.arange(-MARGIN_PX, camera.width + MARGIN_PX, dtype=np.float64)
    v = np.arange(-MARGIN_PX, camera.height + MARGIN_PX, dtype=np.float64)
    pixels = np.stack(np.meshgrid(u, v), axis=-1)
    normalized = camera.normalized_from_pixels(pixels)
    jacobian = np.asarray(np.linalg.inv(camera.pixels_jacobian(normalized)), dtype=np.float64)
    parts: list[Floats] = [normalized[..., 0], normalized[..., 1]]
    parts += [jacobian[..., i, j] for i in range(2) for j in range(2)]
    return Rays(*(np.ascontiguousarray(part) for part in parts))


class Edge(NamedTuple):
    """Where an edge φ = 0 passes each ray, from φ and its gradient; all shape (n,).

    Parameters
    ----------
    distance_px
        φ / ‖∇φ‖: signed, positive inside, px.
    u, v, norm
        ∇φ by pixel column and row, and its length.
    """

    distance_px: Floats
    u: Floats
    v: Floats
    norm: Floats

    def near(self, reach_px: float) -> NDArray[np.bool_]:
        """Return which rays pass within a distance of the edge."""
        return np.abs(self.distance_px) < reach_px


def edge_at(rays: Rays, phi: Floats, phi_x: Floats | float, phi_y: Floats | float) -> Edge:
    """Return where the edge φ = 0 passes each ray, to first order.

    Parameters
    ----------
    rays
        The rays.
    phi
        A function on the image that vanishes on an edge and is positive inside, shape (n,).
    phi_x, phi_y
        Its derivatives by the normalized coordinates.
    """
    u = phi_x * rays.x_u + phi_y * rays.y_u
    v = phi_x * rays.x_v + phi_y * rays.y_v
    norm = np.sqrt(u * u + v * v) + 1e-150
    return Edge(phi / norm, u, v, norm)


def coverage(edge: Edge, cell: float) -> Floats:
    """Return the share of a square cell that lies inside a straight edge, exact, shape (n,).

    Parameters
    ----------
    edge
        Where the edge passes, as from `edge_at`.
    cell
        The side of the cell, px.

    Examples
    --------
    >>> one, none = np.ones(4), np.zeros(4)
    >>> coverage(Edge(np.array([0.0, 0.25, -0.6, 2.0]), one, none, one), 1.0)
    array([0.5 , 0.75, 0.  , 1.  ])
    """
    distance = edge.distance_px
    share: Floats = (distance > 0).astype(np.float64)
    near = edge.near(0.70711 * cell)
    reach, scale = np.abs(distance[near]), cell / edge.norm[near]
    u, v = np.abs(edge.u[near]) * scale, np.abs(edge.v[near]) * scale
    wide, narrow = np.maximum(u, v), np.maximum(np.minimum(u, v), 1e-12)
    corner = np.maximum((wide + narrow) / 2 - reach, 0) ** 2 / (2 * wide * narrow)
    flat = reach <= (wide - narrow) / 2
    half = np.where(flat, 0.5 + reach / wide, 1 - corner)
    share[near] = np.where(distance[near] > 0, half, 1 - half)
    return share


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """Point spread and electronics: linear response, shot and read noise, quantisation.

    Parameters
    ----------
    psf_sigma_px
        Standard deviation of the lens's Gaussian point spread, px; the pixel is a box besides.
    full_well_e
        Electrons at full scale: sets the shot noise.
    read_noise_e
        Read noise, electrons.
    pedestal
        Offset as a share of full scale, which keeps dark noise from being clipped.
    gain
        Full scale per unit of radiance.
    bits
        8 or 16.
    noise
        Scales both noises; 0 switches them off.

    Raises
    ------
    UsageError
        If a value is out of range.
    """

    psf_sigma_px: float = 0.6
    full_well_e: float = 30000.0
    read_noise_e: float = 45.0
    pedestal: float = 0.015
    gain: float = 1.0
    bits: int = 8
    noise: float = 1.0

    def __post_init__(self) -> None:
        if self.bits not in (8, 16) or self.psf_sigma_px < 0.3 or self.noise < 0:
            raise UsageError(
                f"a sensor of {self.bits} bits, PSF {self.psf_sigma_px} px, noise {self.noise}",
                next_step="take 8 or 16 bits, a PSF of at least 0.3 px and noise of at least 0",
            )

    @property
    def full_scale(self) -> int:
        """The largest grey level."""
        return int(2**self.bits - 1)

    def expose(self, radiance: NDArray[np.float32], rng: np.random.Generator) -> NDArray[Any]:
        """Return the image of a blurred radiance (0 to 1) as uint8 or uint16, same shape."""
        signal = radiance * np.float32(self.gain)
        electrons = np.maximum(signal, 0) * np.float32(self.full_well_e)
        if self.noise:
            spread = np.sqrt(electrons + np.float32(self.read_noise_e**2)) * np.float32(self.noise)
            draw = rng.standard_normal(radiance.shape, dtype=np.float32)
            electrons = electrons + spread * draw
        share = electrons / np.float32(self.full_well_e) + np.float32(self.pedestal)
        grey = np.rint(share * self.full_scale).clip(0, self.full_scale)
        return np.asarray(grey.astype(np.uint8 if self.bits == 8 else np.uint16))


def blurred(cells: NDArray[np.float32], psf_sigma_px: float) -> NDArray[np.float32]:
    """Blur cells by the PSF, integrate them over each pixel, and drop the margin.

    Parameters
    ----------
    cells
        Radiance of CELLS × CELLS cells a pixel, shape (CELLS (h + 2 m), CELLS (w + 2 m)) with
        m = MARGIN_PX.
    psf_sigma_px
        Standard deviation of the point spread, px.

    Returns
    -------
    numpy.ndarray
        Shape (h, w).
    """
    kernel = _pixel_kernel(psf_sigma_px)
    rows = _filter_columns(cells, kernel)
    return np.ascontiguousarray(_filter_columns(np.ascontiguousarray(rows.T), kernel).T)


def _pixel_kernel(psf_sigma_px: float) -> Floats:
    """Return the weights of the cells from a margin left to a margin right of one pixel.

    Area sampling widens an edge by a(1 − a)h² at phase a, h²/6 on average, which is taken off.
    """
    sigma = CELLS * np.sqrt(max(psf_sigma_px**2 - 1 / (6 * CELLS**2), 0.04))
    offset = np.arange(-MARGIN_PX * CELLS, (MARGIN_PX + 1) * CELLS)
    inside = np.arange(CELLS)
    weights = np.exp(-0.5 * ((offset[:, None] - inside) / sigma) ** 2).sum(axis=1)
    kernel: Floats = weights / weights.sum()
    return kernel


def _filter_columns(cells: NDArray[np.float32], kernel: Floats) -> NDArray[np.float32]:
    """Filter and decimate along the last axis, as a product with a banded matrix in blocks."""
    block, taps = 32, len(kernel)
    band = np.zeros((CELLS * (block - 1) + taps, block), dtype=np.float32)
    for k in range(block):
        band[CELLS * k : CELLS * k + taps, k] = kernel
    width = cells.shape[1] // CELLS - 2 * MARGIN_PX
    out = np.empty((cells.shape[0], width), dtype=np.float32)
    for start in range(0, width, block):
        count = min(block, width - start)
        reach = CELLS * (count - 1) + taps
        part = cells[:, CELLS * start : CELLS * start + reach]
        out[:, start : start + count] = part @ band[:reach, :count]
    return out
