"""How numbers are printed: an uncertainty with two significant digits, its value to that place."""

import math
from collections.abc import Iterable

NOT_DETERMINED = "not determined"


def decimals_of(uncertainty: float) -> int:
    """Return the decimals that show `uncertainty` with two significant digits, at least 0.

    Examples
    --------
    >>> decimals_of(0.0123), decimals_of(0.0996), decimals_of(4.2), decimals_of(310.0)
    (3, 2, 1, 0)
    """
    if not math.isfinite(uncertainty) or uncertainty <= 0:
        return 3
    exponent = int(f"{uncertainty:.1e}".partition("e")[2])
    return max(0, 1 - exponent)


def fixed(value: float, decimals: int) -> str:
    """Print a value with `decimals` decimals; never "-0.00", never "nan".

    Examples
    --------
    >>> fixed(-0.0001, 2), fixed(1.005, 1), fixed(float("nan"), 2)
    ('0.00', '1.0', 'not determined')
    """
    if not math.isfinite(value):
        return NOT_DETERMINED
    text = f"{value:.{decimals}f}"
    return text.lstrip("-") if float(text) == 0 else text


def uncertainty_text(uncertainty: float) -> str:
    """Print an uncertainty with two significant digits.

    Examples
    --------
    >>> uncertainty_text(0.0996), uncertainty_text(0.01234), uncertainty_text(float("inf"))
    ('0.10', '0.012', 'not determined')
    """
    return fixed(uncertainty, decimals_of(uncertainty))


def with_uncertainty(value: float, uncertainty: float) -> str:
    """Print a value and its uncertainty to the same place.

    Examples
    --------
    >>> with_uncertainty(6.43665, 0.0123)
    '6.437 ± 0.012'
    >>> with_uncertainty(0.0314159, 0.0)
    '0.031'
    """
    decimals = decimals_of(uncertainty)
    if not math.isfinite(uncertainty):
        return f"{fixed(value, decimals)} (uncertainty {NOT_DETERMINED})"
    if uncertainty <= 0:
        return fixed(value, decimals)
    return f"{fixed(value, decimals)} ± {fixed(uncertainty, decimals)}"


def error_decimals(values_mm: Iterable[float]) -> int:
    """Return the decimals for a column of errors: the paper's three, more where that hides them.

    The smallest value that is not zero keeps at least two significant digits, up to 1 nm.

    Examples
    --------
    >>> error_decimals([0.391, 0.145]), error_decimals([0.0041, 0.0012])
    (3, 4)
    """
    sizes = [abs(value) for value in values_mm if value != 0 and math.isfinite(value)]
    if not sizes:
        return 3
    return min(6, max(3, 1 - math.floor(math.log10(min(sizes)))))


def small(value: float) -> str:
    """Print a relative number with two significant digits, unless rounding alone explains it.

    Examples
    --------
    >>> small(3.2e-14), small(4e-9), small(0.25)
    ('less than 1e-12', '4.0e-09', '0.25')
    """
    if abs(value) < 1e-12:
        return "less than 1e-12"
    return f"{value:.2g}" if abs(value) >= 1e-3 else f"{value:.1e}"
