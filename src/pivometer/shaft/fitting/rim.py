"""What a rim that mirrors its surroundings may add to the shading of a round shaft."""

from __future__ import annotations

import numpy as np

from pivometer._arrays import Floats

LIKELY_RIM = 3**-0.5
"""Root mean square of the rim's part of what a mirror shows, if all from 0 to 1 are as likely."""

SCHLICK_POWER = 5


def rim(angles: Floats, behind: tuple[float, float], own: tuple[float, float]) -> Floats:
    """Return what the last degrees may gain as they mirror what stands behind the shaft.

    At grazing incidence every smooth surface reflects all light, and what it reflects there is
    what stands beside its edge.

    Parameters
    ----------
    angles
        Angles around the shaft, shape (n,), −π/2 at the second edge to π/2 at the first, rad.
    behind, own
        Grey levels beside the first and the second edge, and of the shaft there.

    Returns
    -------
    numpy.ndarray
        Root mean square of the gain, with the sign that it has, shape (n,), grey levels.

    References
    ----------
    Schlick, "An inexpensive BRDF model for physically-based rendering", Computer Graphics Forum
    13 (1994) 233.
    """
    gain = np.where(angles > 0, behind[0] - own[0], behind[1] - own[1])
    return np.asarray(LIKELY_RIM * gain * (1 - np.cos(angles)) ** SCHLICK_POWER)
