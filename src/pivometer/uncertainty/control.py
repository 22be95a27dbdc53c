"""Whether a result is out of line with those before it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import checked
from pivometer.uncertainty.coverage import coverage_factor

FALSE_ALARMS = 0.0027
"""Part of results in line that are called out of line: that of Shewhart's three standard
deviations."""

FEWEST = 5
"""Fewer results before it say too little of how much they scatter: Student's t is then above 7."""

SAME = 1e-9
"""Relative scatter that is rounding's."""

FEWEST_FOR_DRIFT = 8
DRIFT_FALSE_ALARMS = 0.01
"""Part of steady series in which a drift is seen."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Between what the results before a result lead one to expect it.

    Parameters
    ----------
    lower, centre, upper
        In the unit of the values.
    count
        Of how many results before.
    """

    lower: float
    centre: float
    upper: float
    count: int

    def holds(self, value: float) -> bool:
        """Tell whether a value is in line."""
        return self.lower <= value <= self.upper


def running_limits(values: ArrayLike) -> tuple[Limits | None, ...]:
    """Return for each of a series of positive values the limits that those before it set.

    The values' logarithms are taken for normal with a mean and a scatter that are not known: an rms
    of n misses scatters in proportion to itself. The limits are those of the next value given the k
    before, mean ± t s √(1 + 1/k), so that few results give wide limits and the rate of false alarms
    is Shewhart's from the first on. What was out of line is left out of later limits, or one wild
    result would hide the next.

    Parameters
    ----------
    values
        In the order of time, shape (n,), positive.

    Returns
    -------
    tuple
        `None` where fewer than `FEWEST` results stand before, or all of them are the same.

    References
    ----------
    W. A. Shewhart, Economic Control of Quality of Manufactured Product (1931); ISO 7870-2, charts
    of individual values; the prediction interval of a normal sample, Student's t.

    Examples
    --------
    >>> limits = running_limits([0.10, 0.11, 0.09, 0.10, 0.11, 0.10, 0.30])
    >>> limits[4] is None, limits[6].holds(0.12), limits[6].holds(0.30)
    (True, True, False)
    """
    logs = np.log(checked(values, (None,), "values"))
    in_line: list[float] = []
    found: list[Limits | None] = []
    for value in logs.tolist():
        limits = _limits(in_line)
        found.append(limits)
        if limits is None or limits.holds(float(np.exp(value))):
            in_line.append(value)
    return tuple(found)


def _limits(logs: Sequence[float]) -> Limits | None:
    count = len(logs)
    if count < FEWEST:
        return None
    mean, scatter = float(np.mean(logs)), float(np.std(logs, ddof=1))
    if scatter < SAME:  # one value again and again says nothing of how much it scatters
        return None
    half = coverage_factor(count - 1, coverage=1 - FALSE_ALARMS) * scatter * np.sqrt(1 + 1 / count)
    low, middle, high = np.exp([mean - half, mean, mean + half]).tolist()
    return Limits(low, middle, high, count)


def drift(values: ArrayLike) -> float | None:
    """Return the change from result to result, part of the value, of a series that drifts.

    Returns
    -------
    float or None
        The median of all slopes of the logarithm; `None` where chance explains the order of the
        values, or there are fewer than `FEWEST_FOR_DRIFT`.

    References
    ----------
    Kendall's τ between order and value; P. K. Sen, doi:10.1080/01621459.1968.10480934 (slope).

    Examples
    --------
    >>> round(drift(0.1 * 1.05 ** np.arange(9)), 3)
    0.05
    """
    logs = np.log(checked(values, (None,), "values"))
    if len(logs) < FEWEST_FOR_DRIFT:
        return None
    from scipy.stats import kendalltau

    if not kendalltau(np.arange(len(logs)), logs).pvalue < DRIFT_FALSE_ALARMS:
        return None
    first, second = np.triu_indices(len(logs), 1)
    slope = float(np.median((logs[second] - logs[first]) / (second - first)))
    return float(np.expm1(slope))
