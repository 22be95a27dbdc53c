"""One camera: the calibration matrix K of (17) and the distortion of (18) or a wider model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.cameras.distortion import (
    COEFFICIENTS,
    distort,
    distort_jacobian,
    model_of,
    undistort,
)
from pivometer.errors import ShapeError


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A pinhole camera with rectangular pixels and lens distortion.

    Pixels are ``(x, y)`` with the origin at the centre of the top-left pixel. The camera frame has
    x to the right, y down and z forward, in mm.

    Parameters
    ----------
    name
        The folder name of the camera.
    width, height
        The image's size, px.
    focal_px
        f s_x and f s_y of (17), shape (2,), px.
    principal_point_px
        o_x and o_y of (17), shape (2,), px.
    distortion
        The first 0, 2, 5 or 8 of k₁ k₂ p₁ p₂ k₃ k₄ k₅ k₆, shape (m,); their number is the model:
        none, radial2 (the paper's β₁ and β₂ of (18)), brown5 or rational8.

    Examples
    --------
    >>> camera = Camera("left", 640, 480, [1000, 1000], [320, 240], [-0.2, 0.1])
    >>> camera.project([50.0, 0.0, 500.0]).round(6)
    array([419.801, 240.   ])
    >>> camera.normalized_from_pixels(camera.project([50.0, 0.0, 500.0])).round(12)
    array([0.1, 0. ])
    """

    name: str
    width: int
    height: int
    focal_px: Floats
    principal_point_px: Floats
    distortion: Floats

    def __post_init__(self) -> None:
        for name, length in (("focal_px", 2), ("principal_point_px", 2), ("distortion", None)):
            values = checked(getattr(self, name), (length,), name)
            object.__setattr__(self, name, read_only(values))
        model_of(self.distortion)
        if (self.focal_px <= 0).any() or self.width < 1 or self.height < 1:
            raise ShapeError(
                f"camera {self.name}: focal lengths {self.focal_px} px, image "
                f"{self.width}×{self.height} px",
                next_step="pass positive focal lengths and sizes",
            )

    @property
    def calibration_matrix(self) -> Floats:
        """The calibration matrix K of (17), shape (3, 3), px."""
        (fx, fy), (ox, oy) = self.focal_px, self.principal_point_px
        return read_only([[fx, 0, ox], [0, fy, oy], [0, 0, 1]])

    @property
    def model(self) -> str:
        """The name of the distortion model."""
        return model_of(self.distortion)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the intrinsic parameters that the model frees, in the order of `parameters`."""
        return ("fx_px", "fy_px", "ox_px", "oy_px", *COEFFICIENTS[: len(self.distortion)])

    @property
    def parameters(self) -> Floats:
        """The intrinsic parameters f s_x, f s_y, o_x, o_y (px) and the distortion, shape (4+m,)."""
        return np.concatenate([self.focal_px, self.principal_point_px, self.distortion])

    def with_parameters(self, parameters: ArrayLike) -> Camera:
        """Return this camera with other intrinsic parameters, in the order of `parameters`."""
        values = checked(parameters, (4 + len(self.distortion),), "parameters")
        return Camera(self.name, self.width, self.height, values[:2], values[2:4], values[4:])

    def project(self, points_mm: ArrayLike) -> Floats:
        """Image points of shape (..., 3), mm, camera frame, in pixels of shape (..., 2).

        Raises
        ------
        ShapeError
            If a point is not in front of the camera.

        References
        ----------
        Wilson et al., eqs. (4), (17) and (18).
        """
        points = checked(points_mm, (-1, 3), "points_mm")
        depth = points[..., 2:]
        if (depth <= 0).any():
            raise ShapeError(
                f"camera {self.name}: {int((depth <= 0).sum())} points are not in front of it",
                next_step="check the direction of the transform into the camera's frame",
            )
        return self.pixels_from_normalized(points[..., :2] / depth)

    def pixels_from_normalized(self, normalized: ArrayLike) -> Floats:
        """Distort (18) and scale (17) normalized points, shape (..., 2), to pixels."""
        return distort(normalized, self.distortion) * self.focal_px + self.principal_point_px

    def pixels_jacobian(self, normalized: ArrayLike) -> Floats:
        """Return ∂pixel/∂normalized, shape (..., 2, 2), px, at normalized points (..., 2)."""
        return self.focal_px[:, None] * distort_jacobian(normalized, self.distortion)

    def normalized_from_pixels(self, pixels: ArrayLike) -> Floats:
        """Undo (17) and (18): pixels, shape (..., 2), to normalized points (f = 1).

        Raises
        ------
        DataError
            If a pixel lies beyond the fold of the distortion model.
        """
        points = checked(pixels, (-1, 2), "pixels")
        return undistort((points - self.principal_point_px) / self.focal_px, self.distortion)

    def undistorted_pixels(self, pixels: ArrayLike) -> Floats:
        """Pixels the same rays would have without distortion, shape (..., 2): K q_n."""
        return self.normalized_from_pixels(pixels) * self.focal_px + self.principal_point_px
