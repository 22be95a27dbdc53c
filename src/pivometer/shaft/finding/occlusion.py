"""Whether what lies between two edges hides the background."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.finding.background import GREY_UNITS, StaticScene
from pivometer.shaft.finding.pairs import EdgePair

LANES = np.linspace(-0.8, 0.8, 9)
"""Where across a shaft the picture is compared with the background; 0 is the middle, ±1 edges."""

STATIONS = (np.arange(32) + 0.5) / 32
LEAST_CHANGE = 0.03 * GREY_UNITS
LEAST_COVER = 0.4
"""A lane that changes less often than this share of the average lane shows the background, as
between a shaft and a rod beside it. Chosen, not measured."""

BESIDE_PX = 3.0
LEAST_UNCHANGED = 0.5
"""Just beside a silhouette the background shows unchanged; beside a stripe on the shaft it does
not. It never counts fully: a shadow or a carriage may lie beside the shaft."""

SHADOW_SPREAD = 0.5
LEAST_TEXTURE = 0.08
LEAST_SAMPLES = 40
"""What a shadow is told by: see `_are_shadows`. Chosen, not measured."""


def cover(
    pairs: Sequence[EdgePair], copy: NDArray[np.uint16], scene: StaticScene, centre_px: Floats
) -> Floats:
    """Return for every pair how well it hides the background, 0 (not at all) to 1.

    Two edges with a strip of unchanged background between them are two objects, and a strip where
    the picture is the background times one factor is a shadow. A dark shaft before dark clutter
    changes little, but in all lanes alike, which does not count against it; nor does the ghost
    that the shaft leaves in the median near the pivot.
    """
    if not pairs:
        return np.zeros(0)
    widths = np.array([pair.width_px for pair in pairs])
    beside = 1 + 2 * BESIDE_PX / widths
    lanes = np.concatenate([np.tile(LANES, (len(pairs), 1)), np.stack([-beside, beside], 1)], 1)
    edges = np.stack([pair.edges_px for pair in pairs]) + centre_px
    columns, rows = _grid(edges, lanes, copy.shape)
    now = copy[rows, columns] * _gain(copy, scene)
    before = scene.grey[rows, columns].astype(np.float64)
    changed = np.abs(now - before) > LEAST_CHANGE
    share = changed[..., :-2].mean(axis=1)
    thinnest = share.min(axis=1) / np.maximum(share.mean(axis=1), 0.05)
    filled = np.clip(thinnest / LEAST_COVER, 0.0, 1.0)
    unchanged = 1 - changed[..., -2:].mean(axis=1)
    ends = np.clip(unchanged.min(axis=1) / LEAST_UNCHANGED, 0.3, 1.0)
    inner = slice(0, lanes.shape[1] - 2)
    shadow = _are_shadows(now[..., inner], before[..., inner], changed[..., inner])
    share_hidden: Floats = filled * ends * np.where(shadow, 0.1, 1.0)
    return share_hidden


def _gain(copy: NDArray[np.uint16], scene: StaticScene) -> float:
    """Return the factor that undoes a flicker of the light."""
    now, before = (float(np.median(grey[::8, ::8])) for grey in (copy, scene.grey))
    return float(np.clip(before / max(now, 1.0), 0.8, 1.25))


def _grid(
    edges: Floats, lanes: Floats, shape: tuple[int, ...]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Columns and rows of the samples, shape (pairs, stations, lanes); edges (pairs, 2, 2, 2)."""
    along = edges[:, :, :1] + STATIONS[:, None] * (edges[:, :, 1:] - edges[:, :, :1])
    across = (lanes[:, None, :, None] + 1) / 2
    points = along[:, 0, :, None] + across * (along[:, 1] - along[:, 0])[:, :, None]
    whole = np.rint(points).astype(np.intp)
    return np.clip(whole[..., 0], 0, shape[1] - 1), np.clip(whole[..., 1], 0, shape[0] - 1)


def _are_shadows(now: NDArray[Any], before: NDArray[Any], changed: NDArray[Any]) -> NDArray[Any]:
    """Tell of each pair whether its darker samples are the background's times one factor."""
    shaped = (len(now), -1)
    there = changed.reshape(shaped)
    behind = np.where(there, before.reshape(shaped), np.nan)
    seen = np.where(there, now.reshape(shaped), np.nan)
    count = there.sum(axis=1)
    found = count >= LEAST_SAMPLES
    found[found] = _medians(seen[found]) <= _medians(behind[found])
    if found.any():
        ratio = seen[found] / np.maximum(behind[found], 1.0)
        texture, remaining = (_spreads(values) for values in (behind[found], ratio))
        found[found] = (texture > LEAST_TEXTURE) & (remaining < SHADOW_SPREAD * texture)
    return np.asarray(found)


def _medians(values: Floats) -> Floats:
    """Return the median of each row but for nan; a sort, as `nanmedian` is far slower."""
    ordered = np.sort(values, axis=1)
    count = (~np.isnan(values)).sum(axis=1)
    row = np.arange(len(values))
    low, high = ordered[row, (count - 1) // 2], ordered[row, count // 2]
    return np.asarray((low + high) / 2)


def _spreads(values: Floats) -> Floats:
    """Return the relative robust spread of the positive values of each row."""
    middle = _medians(values)
    apart = _medians(np.abs(values - middle[:, None]))
    return np.asarray(1.4826 * apart / np.maximum(middle, 1e-9))
