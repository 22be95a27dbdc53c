"""How far each row of pixels beside an edge can be trusted.

Clutter, occlusion, collars and highlights break the model in some rows and not in others. A row's
own estimate of where the edge is has a variance of pixel noise, of a scatter τ² common to all rows
and of the model's misfit in its chunk; rows that contradict the rest count for nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.fitting.profile import Bands, Fit, Model

Bools = NDArray[np.bool_]

NOISE_PERCENTILE = 25.0
"""Chunks at this percentile of the residual hold noise alone; up to 3 in 4 may be disturbed."""

CLUTTERED_ALLOWANCE = 1.0
PLAIN_ALLOWANCE = 1.7
"""What a chunk's mean square exceeds so many times the noise's by is misfit. In clutter all of it
is: with 1.5 the edges' error on the black glossy arm rose from 0.06 to 0.10 px rms. Where the plain
model fits, scatter and shot noise are not: with 1.0 the error rose from 1.2 to 1.45 bounds."""

ZERO_AT_SIGMAS = 4.0
"""Tukey's biweight ends here: 1.4 % efficiency is lost on clean rows, 0 weight to gross ones."""

FULL_ROW = 0.45
"""A row counts with this part of the usual pixels: more than one side of the edge, and no less
than what is left of a row whose far pixels are not used."""

ACCEPTED_GATE = 0.1
"""A row counts as one that shows the edge if it keeps a tenth of its weight."""

LARGEST_ROW_PX = 1.0
"""... and if it alone tells the edge to a pixel, or to three times what is usual in this image."""

VARIANCES_PX2 = np.concatenate([[0.0], np.geomspace(1e-6, 1.0, 37)])
"""Values of τ² tried, px²: from a thousandth of a pixel to a whole one in steps of 1.6 dB."""


@dataclass(frozen=True, slots=True, eq=False)
class RowTrust:
    """The weights of rows, and the noise they are relative to.

    Parameters
    ----------
    weights
        Relative to a row with pixel noise alone, shape (edges, chunks, rows), in [0, 1].
    accepted
        Which rows agree with the model, whatever their weight; boolean, same shape.
    offset_px
        Each row's own estimate of the edge's offset from the fit, raw px; same shape.
    noise_grey
        Standard deviation of the pixel noise, grey levels.
    """

    weights: Floats
    accepted: Bools
    offset_px: Floats
    noise_grey: float


def trust_rows(bands: Bands, fit: Fit, model: Model) -> RowTrust:
    """Return the weight of each row after a fit.

    Parameters
    ----------
    bands
        The pixels.
    fit
        The model's linearization at the present estimate.
    model
        The model's terms: grey levels solved for take their share of the residuals.

    References
    ----------
    Paule and Mandel, "Consensus values and weighting factors", J. Res. NBS 87 (1982) 377, with
    medians for the sums.
    """
    count = bands.valid.sum(axis=-1)
    full = (count > 0) & (count >= FULL_ROW * np.median(count[count > 0]))
    freedom = np.maximum(count - model.levels_per_row(bands.grey.shape[2]), 1)
    square = (bands.valid * fit.residual**2).sum(axis=-1) / freedom
    # The median of χ²/k is (1 − 2/9k)³ of its mean (Wilson and Hilferty).
    typical = _chunk_medians(square / (1 - 2 / (9 * freedom)) ** 3, full)
    variance = max(float(np.percentile(typical[full.any(axis=-1)], NOISE_PERCENTILE)), 1 / 12)
    allowance = CLUTTERED_ALLOWANCE if model.cluttered else PLAIN_ALLOWANCE
    misfit = np.clip(typical - allowance * variance, 0, None)[..., None]
    along = fit.jacobian[..., 0]
    information = np.maximum((bands.valid * along**2).sum(axis=-1), 1e-12)
    offset = (bands.valid * along * fit.residual).sum(axis=-1) / information
    noise, bias = variance / information, misfit / information
    scatter = _common_scatter(offset, noise + bias, full & (noise < 1))
    total = noise + bias + scatter
    agreement = np.clip(1 - offset**2 / total / ZERO_AT_SIGMAS**2, 0, None) ** 2
    usual = 9 * np.maximum(typical, variance)[..., None]
    clean = np.minimum(1, usual / np.maximum(square, 1e-12)) ** 2
    # A chunk's misfit moves all its rows alike, so it does not average out among them.
    rows = bands.grey.shape[2]
    gate = full * agreement * clean
    weights = gate * noise / (noise + scatter + rows * bias)
    usual_total = float(np.median(total[full]))
    accepted = (gate > ACCEPTED_GATE) & (total < max(LARGEST_ROW_PX**2, 9 * usual_total))
    return RowTrust(weights, accepted, offset, float(np.sqrt(variance)))


def _chunk_medians(values: Floats, used: Bools) -> Floats:
    """Return the median over the rows of each chunk, shape (edges, chunks); 0 where none is used.

    Written with a sort, as masked and nan medians are ten times slower.
    """
    ordered = np.sort(np.where(used, values, np.inf), axis=-1)
    count = used.sum(axis=-1)
    low = np.take_along_axis(ordered, np.maximum((count - 1) // 2, 0)[..., None], axis=-1)[..., 0]
    high = np.take_along_axis(
        ordered, (np.maximum(count, 1) // 2)[..., None] % ordered.shape[-1], -1
    )
    return np.where(count > 0, (low + high[..., 0]) / 2, 0.0)


def _common_scatter(offset: Floats, variance: Floats, used: Bools) -> Floats:
    """Return τ² of each edge, shape (2, 1, 1), px², at which the median of z² is that of χ²₁."""
    scatter = np.zeros((2, 1, 1))
    for edge in range(2):
        d2, v = offset[edge][used[edge]] ** 2, variance[edge][used[edge]]
        if d2.size:
            medians = np.median(d2 / (v + VARIANCES_PX2[:, None]), axis=1)
            scatter[edge] = VARIANCES_PX2[min(int((medians > 0.455).sum()), len(medians) - 1)]
    return scatter
