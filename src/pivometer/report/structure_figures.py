"""Pictures of the structure of the error: a map over the shaft's directions, and misses in time."""

import math

import numpy as np
from markupsafe import Markup

from pivometer._arrays import Floats
from pivometer.rcm.structure import ErrorStructure
from pivometer.report.digits import fixed
from pivometer.report.svg import (
    SMALLEST_MM,
    number,
    picture,
    points,
    round_step,
    step_decimals,
    tag,
    tick_values,
)

_SIZE, _RADIUS = 560.0, 205.0
_LONGEST = 70.0
"""User units of the longest arrow on the map."""

_WIDTH, _LEFT, _RIGHT, _PANEL, _GAP = 960.0, 60.0, 150.0, 120.0, 26.0


def direction_map(structure: ErrorStructure) -> Markup:
    """Draw each pose where its shaft points, with the part of its miss across the mean shaft."""
    reach_deg = max(float(structure.tilts_deg.max()), 1e-3) * 1.06
    turn = np.radians(structure.azimuths_deg)
    spots = (structure.tilts_deg * np.array([np.cos(turn), np.sin(turn)])).T * _RADIUS / reach_deg
    axes = np.stack([part.axis for part in structure.components])
    misses = structure.misses_mm @ axes[1:].T
    longest = max(float(np.linalg.norm(misses, axis=1).max()), SMALLEST_MM)
    scale = _LONGEST / longest
    arrows = [
        _arrow(spot, miss * scale, f"{pose}: {np.linalg.norm(miss):.2g} mm across")
        for pose, spot, miss in zip(structure.poses, spots, misses, strict=True)
    ]
    return picture(
        tag(
            "g",
            *_rings(reach_deg, structure),
            *arrows,
            transform=f"translate({number(_SIZE / 2)},{number(_SIZE / 2)})",
        ),
        *_key(longest, scale),
        width=_SIZE,
        height=_SIZE,
        title="Misses of the centerlines over the direction of the shaft",
        class_="miss-map",
    )


def _rings(reach_deg: float, structure: ErrorStructure) -> list[Markup]:
    """Draw the circles of equal tilt and the two axes across the mean shaft."""
    end = _RADIUS * 1.16
    parts = [tag("path", d=f"M{-end:.1f},0H{end:.1f}M0,{-end:.1f}V{end:.1f}", class_="axis")]
    names = [part.name.rpartition(" ")[2] for part in structure.components[1:]]
    ticks = tick_values(reach_deg, 4)
    for tilt in ticks:
        radius, text = tilt * _RADIUS / reach_deg, fixed(tilt, step_decimals(ticks[0]))
        at = radius * math.sqrt(0.5)
        parts += [
            tag("circle", r=radius, class_="grid"),
            tag("text", f"{text}°", x=at + 2, y=at + 10, class_="tick"),
        ]
    parts += [
        tag("text", f"{names[0]} →", x=end, y=-8.0, text_anchor="end", class_="axis-name"),
        tag("text", f"↓ {names[1]}", x=8.0, y=end + 10, class_="axis-name"),
    ]
    return parts


def _arrow(spot: Floats, way: Floats, title: str) -> Markup:
    """Draw a dot with an arrow; `spot` and `way` in user units."""
    (x, y), (dx, dy) = spot.tolist(), way.tolist()
    length = math.hypot(dx, dy)
    parts = [
        tag("title", title),
        tag("path", d=f"M{x:.1f},{y:.1f}l{dx:.1f},{dy:.1f}", class_="miss-line"),
        tag("circle", cx=x, cy=y, r=2.6, class_="dot"),
    ]
    if length > 5:
        ux, uy = dx / length, dy / length
        tip, wing = (x + dx, y + dy), 2.6
        corners = [
            tip,
            (tip[0] - 6 * ux - wing * uy, tip[1] - 6 * uy + wing * ux),
            (tip[0] - 6 * ux + wing * uy, tip[1] - 6 * uy - wing * ux),
        ]
        parts.append(tag("polygon", points=points(corners), class_="miss-tip"))
    return tag("g", *parts)


def _key(longest_mm: float, scale: float) -> list[Markup]:
    """Draw a length that says how long the arrows are."""
    length = round_step(longest_mm, 2)
    y = _SIZE - 14
    text = f"{fixed(length, step_decimals(length))} mm"
    return [
        tag("path", d=f"M14,{y - 4:.1f}v8m0,-4h{length * scale:.1f}m0,-4v8", class_="axis"),
        tag("text", text, x=20 + length * scale, y=y + 4, class_="axis-name"),
    ]


def order_chart(structure: ErrorStructure) -> Markup:
    """Draw the misses along and across the mean shaft against time, or the order of the poses."""
    count = len(structure.poses)
    time = np.arange(1.0, count + 1) if structure.times_s is None else structure.times_s / 60
    start, span = float(time.min()), max(float(np.ptp(time)), SMALLEST_MM)
    places = _LEFT + 10 + (time - start) * (_WIDTH - _LEFT - _RIGHT - 20) / span
    axes = np.stack([part.axis for part in structure.components])
    values = structure.misses_mm @ axes.T
    largest = max(float(np.abs(values).max()), SMALLEST_MM)
    parts: list[Markup] = []
    for row, part in enumerate(structure.components):
        middle = 14 + _PANEL / 2 + row * (_PANEL + _GAP)
        parts += _panel(part.name, middle, largest)
        heights = middle - values[:, row] * (_PANEL / 2 - 6) / largest
        parts += [
            tag("circle", tag("title", f"{pose}: {value:.4g} mm"), cx=x, cy=y, r=2.8, class_="dot")
            for pose, value, x, y in zip(
                structure.poses,
                values[:, row].tolist(),
                places.tolist(),
                heights.tolist(),
                strict=True,
            )
        ]
    floor = 14 + 3 * _PANEL + 2 * _GAP
    parts += _time_axis(start, span, floor, "pose" if structure.times_s is None else "min")
    return picture(
        *parts,
        width=_WIDTH,
        height=floor + 26,
        title="Misses along and across the mean shaft in the order of the poses, mm",
        class_="chart",
    )


def _panel(name: str, middle: float, largest_mm: float) -> list[Markup]:
    """Draw one panel's zero line, ticks and name."""
    end = _WIDTH - _RIGHT
    step = round_step(largest_mm, 2)
    parts = [tag("path", d=f"M{_LEFT:.1f},{middle:.1f}H{end:.1f}", class_="axis")]
    for value in (-step, 0.0, step):
        y = middle - value * (_PANEL / 2 - 6) / largest_mm
        text = fixed(value, step_decimals(step)).replace("-", "−")
        parts.append(
            tag("text", text, x=_LEFT - 8, y=y + 4, text_anchor="end", class_="tick"),
        )
        if value:
            parts.append(tag("path", d=f"M{_LEFT:.1f},{y:.1f}H{end:.1f}", class_="grid"))
    cut = name.index(" ")
    first, second = name[:cut], name[cut + 1 :]
    parts += [
        tag("text", first, x=end + 8, y=middle - 4, class_="axis-name"),
        tag("text", f"{second}, mm", x=end + 8, y=middle + 12, class_="axis-name"),
    ]
    return parts


def _time_axis(start: float, span: float, floor: float, unit: str) -> list[Markup]:
    step = round_step(span, 8)
    first = math.ceil(start / step - 1e-9) * step
    width = _WIDTH - _LEFT - _RIGHT - 20
    parts = [tag("text", unit, x=_WIDTH - _RIGHT + 8, y=floor + 16, class_="axis-name")]
    for k in range(round((start + span - first) / step + 0.5)):
        value = first + k * step
        x = _LEFT + 10 + (value - start) * width / span
        text = fixed(value, step_decimals(step))
        parts.append(
            tag("text", text, x=x, y=floor + 16, text_anchor="middle", class_="tick"),
        )
    return parts
