"""Figures for publications, by matplotlib: SVG with text as text, and PNG.

The same measurement gives the same bytes: no date, no random names.
"""

from collections.abc import Callable, Mapping
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from pivometer._arrays import Floats
from pivometer.errors import UsageError
from pivometer.measurement import Measurement
from pivometer.rcm.structure import ErrorStructure
from pivometer.report.tables import miss_intervals
from pivometer.report.target import deciding_poses, mean_shaft_view, target_offsets_mm

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMN_IN = 3.5
"""Width of a column of a journal, inches."""

_STYLE: Any = {
    "font.size": 8,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "axes.titlesize": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 0.9,
    "legend.frameon": False,
    "legend.fontsize": 7,
    "figure.dpi": 100,
    "savefig.dpi": 300,
    "svg.fonttype": "none",
    "svg.hashsalt": "pivometer",
}
_BLUE, _RED, _INK, _SOFT = "#14497a", "#a3231f", "#1d2733", "#7b8794"


def figure_files(measurement: Measurement) -> dict[str, bytes]:
    """Return all figures that a measurement has something to say for, as files by name.

    Raises
    ------
    UsageError
        If the extra ``figures`` is not installed.
    """
    from importlib.util import find_spec

    if find_spec("matplotlib") is None:
        raise UsageError(
            "figures need matplotlib, which is not installed",
            next_step='run: pip install "pivometer[figures]"',
        )
    from matplotlib import rc_context

    files: dict[str, bytes] = {}
    with rc_context(_STYLE):
        for name, draw in _FIGURES.items():
            figure = draw(measurement)
            if figure is not None:
                files |= {
                    f"{name}.svg": _saved(figure, "svg"),
                    f"{name}.png": _saved(figure, "png"),
                }
    return files


def _saved(figure: "Figure", kind: str) -> bytes:
    held = BytesIO()
    metadata: dict[str, Any] = {"Date": None} if kind == "svg" else {"Software": None}
    figure.savefig(held, format=kind, metadata=metadata)
    return held.getvalue()


def _figure(height_in: float, width_in: float = _COLUMN_IN) -> "Figure":
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout="constrained")


def _worst(measurement: Measurement) -> np.ndarray[Any, np.dtype[np.bool_]]:
    deciding = deciding_poses(measurement)
    return np.array([pose.pose in deciding for pose in measurement.used])


def target_figure(measurement: Measurement) -> "Figure":
    """Draw where each centerline passes the RCM, looking along the mean shaft, mm."""
    view = mean_shaft_view(measurement)
    spots, worst = target_offsets_mm(measurement, view), _worst(measurement)
    minimax, squares = measurement.rcm.minimax, measurement.rcm.least_squares
    figure = _figure(_COLUMN_IN)
    axes = figure.subplots()
    turn = np.linspace(0, 2 * np.pi, 361)
    for radius, style, name in (
        (minimax.max_mm, "-", f"max {minimax.max_mm:.3f} mm"),
        (minimax.rms_mm, "--", f"rms {minimax.rms_mm:.3f} mm"),
    ):
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), style, color=_INK, label=name)
    axes.plot(*spots[~worst].T, "o", ms=2.6, color=_BLUE)
    axes.plot(*spots[worst].T, "^", ms=4.2, color=_RED)
    axes.plot(0, 0, "+", ms=8, color=_INK)
    shift = squares.point_mm - minimax.point_mm
    axes.plot(view.right @ shift, view.down @ shift, "D", ms=4, mfc="white", mec=_INK)
    right, down = view.names()
    axes.set(xlabel=f"{right}, mm", ylabel=f"{down}, mm", aspect="equal")
    axes.invert_yaxis()
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)
    return figure


def miss_figure(measurement: Measurement) -> "Figure":
    """Draw each pose's miss from the minimax point with its 95 % interval, in order."""
    misses = np.array([pose.distance_mm.minimax for pose in measurement.used])
    low, high = miss_intervals(measurement).T
    worst, place = _worst(measurement), np.arange(1, len(misses) + 1)
    minimax = measurement.rcm.minimax
    figure = _figure(2.2, 2 * _COLUMN_IN)
    axes = figure.subplots()
    axes.vlines(place, low, high, color=_SOFT, lw=0.8)
    axes.plot(place[~worst], misses[~worst], "o", ms=2.6, color=_BLUE)
    axes.plot(place[worst], misses[worst], "^", ms=4.2, color=_RED)
    for value, style, name in ((minimax.max_mm, "-", "max"), (minimax.rms_mm, "--", "rms")):
        axes.axhline(value, ls=style, color=_INK, lw=0.7)
        axes.annotate(
            f" {name} {value:.3f}", (1, value), xycoords=("axes fraction", "data"), va="center"
        )
    axes.set(xlabel="pose used", ylabel="distance from the RCM, mm", ylim=(0, None))
    return figure


def direction_figure(measurement: Measurement) -> "Figure | None":
    """Draw the misses over the direction of the shaft: a map of the cone."""
    structure = measurement.structure
    if structure is None:
        return None
    across = _across(structure)
    figure = _figure(_COLUMN_IN)
    axes = figure.subplots()
    turn = np.radians(structure.azimuths_deg)
    x, y = structure.tilts_deg * np.cos(turn), structure.tilts_deg * np.sin(turn)
    longest = float(np.linalg.norm(across, axis=1).max())
    reach = float(structure.tilts_deg.max())
    circle = np.linspace(0, 2 * np.pi, 181)
    for tilt in axes.yaxis.get_major_locator().tick_values(0, reach):
        if 0 < tilt <= 1.15 * reach:
            axes.plot(tilt * np.cos(circle), tilt * np.sin(circle), color="#d5dbe1", lw=0.6)
    scale = max(longest, 1e-12) / (0.3 * max(reach, 1e-3))
    drawn = axes.quiver(
        x, y, *across.T, angles="xy", scale_units="xy", scale=scale, width=0.004, color=_BLUE
    )
    axes.plot(x, y, "o", ms=1.8, color=_BLUE)
    axes.quiverkey(drawn, 0.72, 1.03, longest / 2, f"{longest / 2:.2g} mm", labelpos="E")
    names = [part.name.rpartition(" ")[2] for part in structure.components[1:]]
    axes.set(xlabel=f"tilt towards {names[0]}, °", ylabel=f"tilt towards {names[1]}, °")
    axes.set_aspect("equal")
    axes.margins(0.15)
    axes.invert_yaxis()
    return figure


def _across(structure: ErrorStructure) -> Floats:
    axes = np.stack([part.axis for part in structure.components])
    across: Floats = structure.misses_mm @ axes[1:].T
    return across


def order_figure(measurement: Measurement) -> "Figure | None":
    """Draw the misses along and across the mean shaft in the order of the poses: drift shows."""
    structure = measurement.structure
    if structure is None:
        return None
    figure = _figure(3.6, 2 * _COLUMN_IN)
    panels: list[Axes] = list(figure.subplots(3, 1, sharex=True, sharey=True))
    timed = structure.times_s is not None
    at = structure.times_s if structure.times_s is not None else np.arange(len(structure.poses)) + 1
    for axes, part in zip(panels, structure.components, strict=True):
        axes.axhline(0, color=_SOFT, lw=0.6)
        axes.plot(at, structure.misses_mm @ part.axis, "o", ms=2.6, color=_BLUE)
        axes.set_title(part.name, loc="left")
    panels[1].set_ylabel("miss from the least-squares point, mm")
    panels[-1].set_xlabel("time, s" if timed else "pose used")
    return figure


def distribution_figure(measurement: Measurement) -> "Figure":
    """Draw how many poses miss by how much."""
    misses = measurement.rcm.least_squares.distances_mm
    squares = measurement.rcm.least_squares
    figure = _figure(2.3)
    axes = figure.subplots()
    count = max(5, round(np.sqrt(len(misses)) * 1.5))
    axes.hist(
        misses, bins=count, range=(0, float(misses.max()) or 1.0), color="#9ab4cc", ec="white"
    )
    axes.axvline(squares.rms_mm, ls="--", color=_INK, lw=0.8, label=f"rms {squares.rms_mm:.3f} mm")
    axes.axvline(float(misses.max()), color=_INK, lw=0.8, label=f"max {misses.max():.3f} mm")
    axes.set(xlabel="distance from the least-squares point, mm", ylabel="poses")
    axes.legend()
    return figure


_FIGURES: Mapping[str, Callable[[Measurement], "Figure | None"]] = {
    "target": target_figure,
    "misses": miss_figure,
    "directions": direction_figure,
    "order": order_figure,
    "distribution": distribution_figure,
}
