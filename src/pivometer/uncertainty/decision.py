"""Whether a value that is only known to lie in an interval keeps a limit."""

from typing import Literal

from pivometer.errors import UsageError

Decision = Literal["pass", "over", "inconclusive"]


def guarded_decision(low: float, high: float, limit: float) -> Decision:
    """Decide by guarded acceptance and guarded rejection.

    Pass only if the whole interval keeps the limit, over only if the whole interval exceeds it:
    where the limit lies inside the interval, neither can be said.

    Raises
    ------
    UsageError
        If the limit is not positive, or the interval's ends are not in order.

    References
    ----------
    JCGM 106:2012, 8.3.2 (guarded acceptance) and 8.3.3 (guarded rejection).

    Examples
    --------
    >>> [guarded_decision(0.3, 0.4, limit) for limit in (0.5, 0.4, 0.35, 0.3, 0.2)]
    ['pass', 'pass', 'inconclusive', 'inconclusive', 'over']
    """
    if not (low <= high and 0 < limit < float("inf")):
        raise UsageError(
            f"cannot hold an interval from {low} to {high} against a limit of {limit}",
            next_step="give a positive limit, mm",
        )
    if high <= limit:
        return "pass"
    return "over" if low > limit else "inconclusive"


def variance_ratio_limit(
    degrees_of_freedom: float, earlier_degrees_of_freedom: float, *, coverage: float
) -> float:
    """Return what the ratio of two equal variances, later over earlier, seldom exceeds.

    References
    ----------
    The quantile of the F distribution.

    Examples
    --------
    >>> round(variance_ratio_limit(137, 137, coverage=0.95), 3)
    1.326
    """
    from scipy.special import fdtri

    return float(fdtri(degrees_of_freedom, earlier_degrees_of_freedom, coverage))
