"""Results over time: tables, charts with their limits, and a page."""

from dataclasses import dataclass

from markupsafe import Markup

from pivometer.report.digits import error_decimals, fixed
from pivometer.report.page import render_page
from pivometer.report.svg import picture, step_decimals, tag, tick_values
from pivometer.report.tables import Table
from pivometer.uncertainty.control import Limits

_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 960.0, 300.0, 60.0, 30.0, 26.0, 74.0


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """One result of a series.

    Parameters
    ----------
    session, made
        Its session, and the day.
    poses
        How many were used.
    value_mm
        What is followed, mm.
    limits
        What the results before it lead one to expect; `None` where they are too few.
    """

    session: str
    made: str
    poses: int
    value_mm: float
    limits: Limits | None

    @property
    def in_line(self) -> bool:
        """Whether it lies between its limits, if it has any."""
        return self.limits is None or self.limits.holds(self.value_mm)


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One quantity of one robot over time.

    Parameters
    ----------
    device
        The robot; empty where the sessions name none.
    quantity
        What is followed.
    points
        In the order of time.
    findings
        What stands out, in plain words.
    """

    device: str
    quantity: str
    points: tuple[Point, ...]
    findings: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """All results under a folder.

    Parameters
    ----------
    folder
        Its name.
    series
        By robot and quantity.
    skipped
        Files that are no results, each with the reason.
    """

    folder: str
    series: tuple[Series, ...]
    skipped: tuple[tuple[str, str], ...]

    @property
    def newest_in_line(self) -> bool:
        """Whether the newest result of every series is."""
        return all(series.points[-1].in_line for series in self.series)


def series_table(series: Series) -> Table:
    """Tabulate a series with its limits."""
    decimals = error_decimals([point.value_mm for point in series.points])
    rows = tuple(
        (
            point.made,
            point.session,
            str(point.poses),
            fixed(point.value_mm, decimals),
            "–" if point.limits is None else fixed(point.limits.lower, decimals),
            "–" if point.limits is None else fixed(point.limits.upper, decimals),
            "" if point.in_line else "▲ out of line",
        )
        for point in series.points
    )
    return Table(
        f"{series.device or 'No robot named'}: {series.quantity}, mm",
        ("made", "session", "poses", "value", "lower limit", "upper limit", ""),
        rows,
    )


def series_chart(series: Series) -> Markup:
    """Draw a series with the limits as they were known at each result."""
    points = series.points
    tops = [point.value_mm for point in points]
    tops += [point.limits.upper for point in points if point.limits is not None and point.in_line]
    top = 1.1 * max(tops)
    scale = (_HEIGHT - _TOP - _BOTTOM) / top
    step = (_WIDTH - _LEFT - _RIGHT) / len(points)
    parts = _grid(top, scale)
    for index, point in enumerate(points):
        x = _LEFT + (index + 0.5) * step
        if point.limits is not None:
            parts += _limits(point.limits, x, step, top, scale)
        y = _floor() - point.value_mm * scale
        title = tag("title", f"{point.session}, {point.made}: {point.value_mm:.4g} mm")
        if point.in_line:
            parts.append(tag("circle", title, cx=x, cy=y, r=4.5, class_="dot"))
        else:
            d = f"M{x:.1f},{y - 6:.1f}l6,11h-12z"
            parts.append(tag("path", title, d=d, class_="mark"))
        if index % -(-len(points) // 40) == 0:
            turn = f"rotate(-60 {x:.1f} {_floor() + 10:.1f})"
            label = tag(
                "text",
                point.made,
                x=x,
                y=_floor() + 12,
                text_anchor="end",
                transform=turn,
                class_="tick",
            )
            parts.append(label)
    heading = f"{series.quantity} over time with its limits, mm"
    return picture(*parts, width=_WIDTH, height=_HEIGHT, title=heading, class_="chart")


def _floor() -> float:
    return _HEIGHT - _BOTTOM


def _limits(limits: Limits, x: float, step: float, top: float, scale: float) -> list[Markup]:
    """Draw the limits of one result across its place, solid; the middle of those before dashed."""
    left, right = x - step / 2, x + step / 2
    ends = [value for value in (limits.lower, limits.upper) if value <= top]
    solid = "".join(f"M{left:.1f},{_floor() - v * scale:.1f}H{right:.1f}" for v in ends)
    middle = f"M{left:.1f},{_floor() - limits.centre * scale:.1f}H{right:.1f}"
    return [
        tag("path", d=solid, class_="level max"),
        tag("path", d=middle, class_="level rms"),
    ]


def _grid(top: float, scale: float) -> list[Markup]:
    ticks = [0.0, *tick_values(top, 5)]
    decimals = step_decimals(ticks[1]) if len(ticks) > 1 else 0
    parts = [tag("text", "mm", x=_LEFT - 8, y=_TOP - 8, text_anchor="end", class_="axis-name")]
    for value in ticks:
        y = _floor() - value * scale
        d = f"M{_LEFT:.1f},{y:.1f}H{_WIDTH - _RIGHT:.1f}"
        text = fixed(value, decimals)
        parts += [
            tag("path", d=d, class_="grid" if value else "axis"),
            tag("text", text, x=_LEFT - 8, y=y + 4, text_anchor="end", class_="tick"),
        ]
    return parts


CHART_CAPTION = (
    "● in line, ▲ out of line; solid lines: between them the results before lead one to expect "
    "each result, dashed their middle. The limits narrow as results are added."
)
LIMITS_REASON = (
    "A result is out of line if the results before it make it less likely than 0.27 % (three "
    "standard deviations, as on Shewhart’s charts), taking into account how few they are; the "
    "logarithms are taken for normal, since an rms scatters in proportion to itself. Results out "
    "of line do not count for later limits. The robot’s rms out of line, and the instrument’s "
    "figures in line, is the robot; if the instrument’s are out of line as well, look at the "
    "calibration first."
)


def render_history(history: History) -> str:
    """Return a history as a page that asks no host for anything."""
    shown = [(one, series_chart(one), series_table(one)) for one in history.series]
    return render_page(
        "history.html.j2",
        history=history,
        shown=shown,
        caption=CHART_CAPTION,
        reason=LIMITS_REASON,
    )
