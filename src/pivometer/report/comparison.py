"""Several results side by side, and what may be said of their differences."""

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from pivometer._arrays import Floats
from pivometer.measurement import Measurement
from pivometer.report.digits import error_decimals, fixed, with_uncertainty
from pivometer.report.page import render_page
from pivometer.report.svg import number, picture, tag, tick_values
from pivometer.report.tables import Table
from pivometer.uncertainty.comparison import LocationDifference, Ratio

_WIDTH, _LEFT, _RIGHT, _ROW = 960.0, 190.0, 40.0, 46.0


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """What may be said of two results.

    Parameters
    ----------
    first, second
        Their names.
    statements
        Sentences, the weightiest first: rms, location, largest miss.
    assumptions
        What they take for granted.
    rms, own_rms
        Ratio of the rms misses as of two samples of poses; and of the robots' own over the poses
        measured. `None` where it may not be stated.
    location
        Difference of the locations; `None` where they are in different frames.
    differ
        Whether rms or location differ by more than chance explains.
    """

    first: str
    second: str
    statements: tuple[str, ...]
    assumptions: tuple[str, ...]
    rms: Ratio | None
    own_rms: Ratio | None
    location: LocationDifference | None
    differ: bool


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Results side by side.

    Parameters
    ----------
    names
        What each is called.
    results
        The measurements.
    pairs
        Every other result against the first.
    coverage
        Probability with which every statement of chance holds; they hold jointly with 95 %.
    """

    names: tuple[str, ...]
    results: tuple[Measurement, ...]
    pairs: tuple[Pair, ...]
    coverage: float


def comparison_table(compared: Comparison) -> Table:
    """Tabulate the results, one a column."""
    results = compared.results
    rms = [m.rcm.least_squares.rms_mm for m in results]
    decimals = error_decimals([*rms, *(m.rcm.minimax.max_mm for m in results)])
    rows = (
        ("made", *(m.provenance.created[:10] if m.provenance else "–" for m in results)),
        ("poses used", *(str(len(m.used)) for m in results)),
        ("poses rejected", *(str(len(m.rejected)) for m in results)),
        ("cone of the shaft, °", *(f"{m.rcm.cone_deg:.0f}" for m in results)),
        ("rms miss (least squares), mm", *(fixed(value, decimals) for value in rms)),
        ("the robot’s own rms, 95 %, mm", *(_interval(m, decimals, "rms") for m in results)),
        ("largest miss (minimax), mm", *(fixed(m.rcm.minimax.max_mm, decimals) for m in results)),
        ("the robot’s own largest, 95 %, mm", *(_interval(m, decimals, "max") for m in results)),
        *_location_rows(results),
        ("shaft’s diameter ± U, mm", *map(_diameter, results)),
        ("measured by", *(m.software for m in results)),
    )
    return Table(
        "The results side by side",
        ("", *compared.names),
        rows,
        "The robot’s own error is what is left when the instrument’s noise is taken off, with the "
        "interval that holds it over the poses measured. Largest misses grow with the number of "
        "poses: compare them only at equal numbers.",
    )


def _location_rows(results: Sequence[Measurement]) -> list[tuple[str, ...]]:
    """State locations in the reference board's frame where all have it, else each in its own."""
    frames = [m.board_frame for m in results]
    rows = []
    for i, axis in enumerate("xyz"):
        cells = []
        for m, frame in zip(results, frames, strict=True):
            if all(frames) and frame is not None:
                point, u = frame.least_squares_point_mm, frame.uncertainty.expanded_mm
            else:
                point, u = m.rcm.least_squares.point_mm, m.uncertainty.expanded_mm
            cells.append(with_uncertainty(float(point[i]), float(u[i])))
        where = "board’s frame" if all(frames) else "camera’s frame"
        rows.append((f"{axis} ± U, {where}, mm", *cells))
    return rows


def _interval(m: Measurement, decimals: int, kind: str) -> str:
    if m.intrinsic is None:
        return "–"
    ends: Floats = m.intrinsic.rms_interval_mm if kind == "rms" else m.intrinsic.max_interval_mm
    return " to ".join(fixed(float(end), decimals) for end in ends)


def _diameter(m: Measurement) -> str:
    if m.shaft is None:
        return "–"
    return with_uncertainty(m.shaft.diameter.value_mm, m.shaft.diameter.expanded_mm)


def interval_plot(compared: Comparison) -> Markup:
    """Draw each result's rms and largest miss with the interval of the robot's own."""
    results, names = compared.results, compared.names
    ends = [float(m.intrinsic.max_interval_mm[1]) for m in results if m.intrinsic is not None]
    top = 1.06 * max([m.rcm.minimax.max_mm for m in results] + ends)
    scale = (_WIDTH - _LEFT - _RIGHT) / max(top, 1e-9)
    height = 34.0 + _ROW * len(results) + 34.0
    parts = _scale(top, scale, height)
    for row, (name, m) in enumerate(zip(names, results, strict=True)):
        y = 34.0 + _ROW * (row + 0.5)
        parts.append(tag("text", _short(name), x=_LEFT - 14, y=y + 4, text_anchor="end"))
        parts += _marks(m, y, scale)
    title = "Each result’s rms miss (circle) and largest miss (triangle), mm"
    return picture(*parts, width=_WIDTH, height=height, title=title, class_="intervals")


def _marks(m: Measurement, y: float, scale: float) -> list[Markup]:
    """Draw a result: bars are the robot's own, marks what was observed."""
    own = m.intrinsic
    rms, largest = m.rcm.least_squares.rms_mm, m.rcm.minimax.max_mm
    parts = []
    for offset, ends in (
        (-8.0, None if own is None else own.rms_interval_mm),
        (8.0, None if own is None else own.max_interval_mm),
    ):
        if ends is not None:
            low, high = (_LEFT + scale * float(end) for end in ends)
            d = f"M{low:.1f},{y + offset:.1f}H{high:.1f}"
            caps = f"M{low:.1f},{y + offset - 4:.1f}v8M{high:.1f},{y + offset - 4:.1f}v8"
            parts.append(tag("path", d=d + caps, class_="level"))
    parts.append(tag("circle", cx=_LEFT + scale * rms, cy=y - 8, r=4.5, class_="dot"))
    x = _LEFT + scale * largest
    triangle = f"M{x:.1f},{y + 2.5:.1f}l5,9h-10z"
    return [*parts, tag("path", d=triangle, class_="mark")]


def _scale(top: float, scale: float, height: float) -> list[Markup]:
    parts = []
    for value in (0.0, *tick_values(top, 6)):
        x = _LEFT + scale * value
        parts += [
            tag("path", d=f"M{x:.1f},24V{height - 30:.1f}", class_="axis" if not value else "grid"),
            tag("text", number(value), x=x, y=height - 14, text_anchor="middle", class_="tick"),
        ]
    return [*parts, tag("text", "mm", x=_WIDTH - _RIGHT, y=height - 14, class_="axis-name")]


def _short(name: str) -> str:
    return name if len(name) <= 24 else name[:23] + "…"


PLOT_CAPTION = (
    "● rms miss from the least-squares point and ▲ largest miss from the minimax point, as "
    "observed; bars: the 95 % intervals of the robot’s own, apart from the instrument’s noise. "
    "Observed misses hold the noise, too, and may lie above their bar."
)


def render_comparison(compared: Comparison) -> str:
    """Return a comparison as a page that asks no host for anything."""
    return render_page(
        "compare.html.j2",
        compared=compared,
        table_of_results=comparison_table(compared),
        plot=interval_plot(compared),
        plot_caption=PLOT_CAPTION,
    )
