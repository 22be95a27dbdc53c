"""The chart of per-pose distances, in the session's order, so that drift shows."""

from markupsafe import Markup

from pivometer.measurement import Measurement, UsedPose
from pivometer.report.digits import error_decimals, fixed
from pivometer.report.svg import SMALLEST_MM, picture, step_decimals, tag, tick_values
from pivometer.report.tables import miss_intervals
from pivometer.report.target import deciding_poses

_WIDTH, _HEIGHT = 960.0, 300.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 52.0, 96.0, 22.0, 70.0
_TALLEST = 1.6
"""An interval that goes farther beyond the largest miss than this is cut off at the top."""

_MOST_NAMES = 90
"""More names than this under the bars could not be read; then every second, third … is written."""


def pose_chart(measurement: Measurement) -> Markup:
    """Draw one bar per pose (minimax) with its interval, a ring (least squares), × if rejected."""
    poses = measurement.poses
    used = measurement.used
    top_mm = max(
        [max(pose.distance_mm.minimax, pose.distance_mm.least_squares) for pose in used] or [1.0]
    )
    intervals = miss_intervals(measurement)
    top_mm = max(top_mm, min(float(intervals.max(initial=0.0)), _TALLEST * top_mm))
    top_mm = 1.06 * max(top_mm, SMALLEST_MM)
    scale = (_HEIGHT - _TOP - _BOTTOM) / top_mm
    step = (_WIDTH - _LEFT - _RIGHT) / max(len(poses), 1)
    worst = deciding_poses(measurement)
    ends = dict(zip((pose.pose for pose in used), intervals, strict=True))
    parts = _grid(top_mm, scale)
    every = -(-len(poses) // _MOST_NAMES)
    for index, pose in enumerate(poses):
        x = _LEFT + (index + 0.5) * step
        if isinstance(pose, UsedPose):
            parts += _bar(pose, x, step, scale, sets_max=pose.pose in worst)
            low, high = (_floor() - scale * min(float(end), top_mm) for end in ends[pose.pose])
            parts.append(tag("path", d=f"M{x:.1f},{low:.1f}V{high:.1f}", class_="interval"))
        else:
            parts.append(_rejected(pose.pose, x))
        if index % every == 0:
            parts.append(_name(pose.pose, x))
    parts += _levels(measurement, scale)
    title = "Distance of every centerline from the RCM, in mm, in the session's order"
    height = _floor() + 16 + 6.2 * max((len(_short(pose.pose)) for pose in poses), default=0)
    return picture(*parts, width=_WIDTH, height=height, title=title, class_="chart")


def _floor() -> float:
    return _HEIGHT - _BOTTOM


def _grid(top_mm: float, scale: float) -> list[Markup]:
    ticks = [0.0, *tick_values(top_mm, 5)]
    decimals = step_decimals(ticks[1]) if len(ticks) > 1 else 0
    parts = [tag("text", "mm", x=_LEFT - 8, y=_TOP - 5, text_anchor="end", class_="axis-name")]
    for value in ticks:
        y = _floor() - value * scale
        d = f"M{_LEFT:.1f},{y:.1f}H{_WIDTH - _RIGHT:.1f}"
        text = fixed(value, decimals)
        parts += [
            tag("path", d=d, class_="axis" if value == 0 else "grid"),
            tag("text", text, x=_LEFT - 8, y=y + 4, text_anchor="end", class_="tick"),
        ]
    return parts


def _bar(pose: UsedPose, x: float, step: float, scale: float, *, sets_max: bool) -> list[Markup]:
    height = pose.distance_mm.minimax * scale
    width = min(0.66 * step, 26.0)
    minimax, squares = f"{pose.distance_mm.minimax:.4g}", f"{pose.distance_mm.least_squares:.4g}"
    title = tag("title", f"{pose.pose}: {minimax} mm minimax, {squares} mm least squares")
    bar = tag(
        "rect",
        title,
        x=x - width / 2,
        y=_floor() - height,
        width=width,
        height=height,
        class_="bar worst" if sets_max else "bar",
    )
    radius = min(3.2, max(1.5, 0.3 * step))
    y = _floor() - pose.distance_mm.least_squares * scale
    parts = [bar, tag("circle", cx=x, cy=y, r=radius, class_="least-squares")]
    if sets_max:
        parts.append(tag("path", d=f"M{x:.1f},{_floor() - height - 4:.1f}l4,-7h-8z", class_="mark"))
    return parts


def _rejected(pose: str, x: float) -> Markup:
    d = f"M{x - 4:.1f},{_floor() - 10:.1f}l8,8m0,-8l-8,8"
    return tag("path", tag("title", f"{pose}: rejected"), d=d, class_="rejected")


def _name(pose: str, x: float) -> Markup:
    y = _floor() + 8
    turn = f"rotate(-90 {x:.1f} {y:.1f})"
    return tag("text", _short(pose), x=x, y=y + 4, text_anchor="end", transform=turn, class_="tick")


def _short(pose: str) -> str:
    return pose if len(pose) <= 10 else pose[:9] + "…"


def _levels(measurement: Measurement, scale: float) -> list[Markup]:
    """Draw the lines at max and rms of the minimax point."""
    minimax = measurement.rcm.minimax
    decimals = error_decimals([minimax.max_mm, minimax.rms_mm])
    parts = []
    for name, value in (("max", minimax.max_mm), ("rms", minimax.rms_mm)):
        y = _floor() - value * scale
        d = f"M{_LEFT:.1f},{y:.1f}H{_WIDTH - _RIGHT:.1f}"
        text = f"{name} {fixed(value, decimals)}"
        parts += [
            tag("path", d=d, class_=f"level {name}"),
            tag("text", text, x=_WIDTH - _RIGHT + 6, y=y + 4, class_="ring-name"),
        ]
    return parts
