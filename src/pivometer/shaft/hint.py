"""What a person may say of where the shaft is in one camera's images."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ShaftHint:
    """The pixel about which the shaft turns in one camera's images, and its width there.

    It is the same for all images of a camera, so one hint serves them all.

    Parameters
    ----------
    x_px, y_px
        Where the shaft passes in every pose, raw pixels; it may lie outside the image. About a
        quarter of the shaft's width is close enough.
    width_px
        The shaft's width there, px; found from the images where it is not given.

    Examples
    --------
    >>> ShaftHint(412, 300, 22).width_px
    22
    """

    x_px: float
    y_px: float
    width_px: float | None = None
