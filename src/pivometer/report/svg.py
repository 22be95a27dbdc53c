"""Elements of a hand-made SVG picture; every text and attribute is escaped."""

import math
from collections.abc import Iterable

from markupsafe import Markup, escape

DRAWN_TWICE = 512
"""The page and the PDF of one report show the same small drawings: so many of a kind are kept."""

SMALLEST_MM = 1e-6
"""No picture resolves less than a nanometre: exact lines would need an endless scale."""

Child = str | Markup
"""Markup stays as it is; any other text is escaped."""


def number(value: float) -> str:
    """Print a coordinate with at most two decimals.

    Examples
    --------
    >>> number(1.50), number(-0.001), number(12.345)
    ('1.5', '0', '12.35')
    """
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def tag(name: str, *children: Child, **attributes: object) -> Markup:
    """Build an element; ``class_`` means class and ``stroke_width`` means stroke-width.

    Examples
    --------
    >>> tag("text", "a < b", x=1.5, class_="label")
    Markup('<text x="1.5" class="label">a &lt; b</text>')
    """
    text = [f"<{name}"]
    for key, value in attributes.items():
        shown = number(value) if isinstance(value, float) else value
        text.append(f' {key.rstrip("_").replace("_", "-")}="{escape(shown)}"')
    inner = "".join(escape(child) for child in children)
    return Markup("".join(text) + f">{inner}</{name}>")  # noqa: S704 – all parts are escaped above


def picture(*children: Child, width: float, height: float, title: str, **extra: object) -> Markup:
    """Build an ``<svg>`` of that size in user units, with the title that screen readers read."""
    attributes: dict[str, object] = {"viewBox": f"0 0 {number(width)} {number(height)}"}
    return tag("svg", *children, **attributes, role="img", aria_label=title, **extra)


def points(pairs: Iterable[tuple[float, float]]) -> str:
    """Join (x, y) pairs for the ``points`` of a polyline.

    Examples
    --------
    >>> points([(1.0, 2.0), (3.5, 4.25)])
    '1,2 3.5,4.25'
    """
    return " ".join(f"{number(x)},{number(y)}" for x, y in pairs)


def round_step(span: float, count: int) -> float:
    """Return the 1, 2 or 5 × 10ⁿ that divides `span` into at most about `count` steps.

    Examples
    --------
    >>> round_step(0.9, 5), round_step(7.2, 4)
    (0.2, 2.0)
    """
    rough = span / count
    power = math.floor(math.log10(rough))
    for factor in (1, 2, 5, 10):
        if factor * 10.0**power >= rough * (1 - 1e-9):
            return round(factor * 10.0**power, 12)
    return round(10.0 ** (power + 1), 12)


def tick_values(end: float, count: int) -> list[float]:
    """Return round values from the first step up to `end`.

    Examples
    --------
    >>> tick_values(0.45, 4)
    [0.2, 0.4]
    """
    step = round_step(end, count)
    return [round(step * i, 12) for i in range(1, math.floor(end / step + 1e-9) + 1)]


def step_decimals(step: float) -> int:
    """Return the decimals that print multiples of a round step.

    Examples
    --------
    >>> step_decimals(0.05), step_decimals(20.0)
    (2, 0)
    """
    return max(0, -math.floor(math.log10(step) + 1e-9))
