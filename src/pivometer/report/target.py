"""The target: where each centerline passes the RCM, looking along the mean shaft."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from pivometer._arrays import Floats
from pivometer.geometry import nearest_points_on_lines
from pivometer.measurement import Measurement
from pivometer.report.digits import error_decimals, fixed
from pivometer.report.svg import SMALLEST_MM, number, picture, step_decimals, tag, tick_values

_SIZE = 560.0
_RADIUS = 205.0
"""User units from the centre to the largest miss; the rest is for tick labels and numbers."""

_AXES = "xyz"


@dataclass(frozen=True, slots=True, eq=False)
class ShaftView:
    """A view along the mean shaft: right, down and into the page, in the reference frame."""

    right: Floats
    down: Floats
    into: Floats

    def names(self) -> tuple[str, str]:
        """Name the reference axes nearest to right and to down, such as ``("+x", "+z")``."""
        return _nearest_axis(self.right), _nearest_axis(self.down)


def shaft_view(directions: Floats) -> ShaftView:
    """Return the view along the mean of undirected `directions`, shape (n, 3).

    The mean is the principal axis of the directions, pointed along its largest component; right is
    the reference axis (x, or z where the shaft lies along x) as it appears in that view.

    Examples
    --------
    >>> view = shaft_view(np.array([[0.1, 1, 0], [0.1, -1, 0.0]]))
    >>> view.names()
    ('+x', '-z')
    """
    into = np.linalg.eigh(directions.T @ directions)[1][:, -1]
    into = into * np.sign(into[np.argmax(np.abs(into))])
    lateral = np.eye(3)[2 if abs(into[0]) > math.cos(math.radians(30)) else 0]
    right = lateral - into * (into @ lateral)
    right = right / np.linalg.norm(right)
    return ShaftView(right, np.cross(into, right), into)


def mean_shaft_view(measurement: Measurement) -> ShaftView:
    """Return the view along the mean of the used centerlines."""
    return shaft_view(np.array([pose.centerline.direction for pose in measurement.used]))


def target_offsets_mm(measurement: Measurement, view: ShaftView) -> Floats:
    """Return where each dot lies, shape (n, 2), mm right and down of the minimax point.

    A dot has the direction in which the nearest point of its centerline is seen, and the true
    distance in space, so that the circles at rms and max mean what they say for tilted shafts too.
    """
    centre = measurement.rcm.minimax.point_mm
    offsets = np.zeros((len(measurement.used), 2))
    misses = nearest_points_mm(measurement) - centre
    for row, (pose, miss) in enumerate(zip(measurement.used, misses, strict=True)):
        seen = np.array([view.right @ miss, view.down @ miss])
        length = float(np.linalg.norm(seen))
        if length > 0:
            offsets[row] = seen * (pose.distance_mm.minimax / length)
    return offsets


def nearest_points_mm(measurement: Measurement) -> Floats:
    """Return the point of every used centerline nearest to the minimax point, shape (n, 3), mm."""
    lines = [pose.centerline for pose in measurement.used]
    return nearest_points_on_lines(
        measurement.rcm.minimax.point_mm,
        np.array([line.point_mm for line in lines]),
        np.array([line.direction for line in lines]),
    )


def deciding_poses(measurement: Measurement) -> frozenset[str]:
    """Return the names of the poses at the largest distance: they alone place the minimax point."""
    largest = max((pose.distance_mm.minimax for pose in measurement.used), default=0.0)
    # The minimax solver is exact to 1e-9; poses closer than 1e-6 to the largest share it.
    return frozenset(
        pose.pose for pose in measurement.used if pose.distance_mm.minimax >= largest * (1 - 1e-6)
    )


def target_plot(measurement: Measurement, numbers: Sequence[int]) -> Markup:
    """Draw the target around the minimax point.

    Parameters
    ----------
    measurement
        What to draw.
    numbers
        The number written at the dot of each used pose.
    """
    rcm = measurement.rcm
    scale = _RADIUS / max(rcm.minimax.max_mm, SMALLEST_MM)
    view = mean_shaft_view(measurement)
    places = target_offsets_mm(measurement, view) * scale
    labels = Labels(places)
    return picture(
        tag(
            "g",
            *_axes(scale, view.names()),
            *_circles(measurement, scale, labels),
            *_least_squares(measurement, view, scale),
            *_dots(measurement, places, numbers, labels),
            tag("path", d="M-9,0H9M0,-9V9", class_="rcm"),
            transform=f"translate({number(_SIZE / 2)},{number(_SIZE / 2)})",
        ),
        width=_SIZE,
        height=_SIZE,
        title="Target plot: where each centerline passes the RCM, in mm",
        class_="target",
    )


def _axes(scale: float, names: tuple[str, str]) -> list[Markup]:
    end = _RADIUS * 1.16
    ticks = tick_values(end / scale, 4)
    decimals = step_decimals(ticks[0]) if ticks else 0
    parts = [
        tag("path", d=f"M{-end:.1f},0H{end:.1f}M0,{-end:.1f}V{end:.1f}", class_="axis"),
        tag(
            "text",
            f"{names[0]}, mm →",
            x=_SIZE / 2 - 2,
            y=-8.0,
            text_anchor="end",
            class_="axis-name",
        ),
        tag("text", f"↓ {names[1]}, mm", x=8.0, y=end + 14, class_="axis-name"),
    ]
    for value in [sign * tick for tick in ticks for sign in (-1, 1)]:
        at, text = value * scale, fixed(value, decimals)
        d = f"M{at:.1f},-4V4M-4,{at:.1f}H4"
        parts += [
            tag("path", d=d, class_="axis"),
            tag("text", text, x=at, y=17.0, text_anchor="middle", class_="tick"),
            tag("text", text, x=-8.0, y=at + 4, text_anchor="end", class_="tick"),
        ]
    return parts


def _circles(measurement: Measurement, scale: float, labels: "Labels") -> list[Markup]:
    minimax = measurement.rcm.minimax
    decimals = error_decimals([minimax.max_mm, minimax.rms_mm])
    parts = []
    for name, radius_mm, turn_deg in (("max", minimax.max_mm, -45), ("rms", minimax.rms_mm, -135)):
        radius, text = radius_mm * scale, f"{name} {fixed(radius_mm, decimals)}"
        x, y = labels.place_outside(radius + 6, turn_deg, text)
        parts += [
            tag("circle", r=radius, class_=f"ring {name}"),
            tag("text", text, x=x, y=y, class_="ring-name"),
        ]
    return parts


def _least_squares(measurement: Measurement, view: ShaftView, scale: float) -> list[Markup]:
    """Draw the least-squares point and the k-fold ellipse of its scatter part."""
    rcm, uncertainty = measurement.rcm, measurement.uncertainty
    axes = np.array([view.right, view.down])
    x, y = axes @ (rcm.least_squares.point_mm - rcm.minimax.point_mm) * scale
    variances, turn = np.linalg.eigh(axes @ uncertainty.lines_mm2 @ axes.T)
    half = uncertainty.coverage_factor * np.sqrt(np.maximum(variances, 0)) * scale
    angle = math.degrees(math.atan2(turn[1, 0], turn[0, 0]))
    place = f"translate({number(x)},{number(y)})"
    parts = [tag("path", d="M0,-7L7,0L0,7L-7,0Z", class_="least-squares", transform=place)]
    if np.isfinite(half).all():
        spin = f"{place} rotate({number(angle)})"
        parts.append(tag("ellipse", rx=half[0], ry=half[1], transform=spin, class_="scatter"))
    return parts


def _dots(
    measurement: Measurement, places: Floats, numbers: Sequence[int], labels: "Labels"
) -> list[Markup]:
    """Draw the dots, the worst as triangles, numbered as far as the numbers do not collide."""
    used, parts = measurement.used, []
    worst = deciding_poses(measurement)
    order = np.argsort([-pose.distance_mm.minimax for pose in used], kind="stable")
    for index in order:
        pose, (x, y) = used[index], places[index]
        title = tag("title", f"{pose.pose}: {pose.distance_mm.minimax:.4g} mm")
        gap = 5.0
        if pose.pose in worst:
            gap = 8.0
            d = f"M{x:.1f},{y - 6:.1f}l5.5,9.5h-11z"
            parts.append(tag("path", title, d=d, class_="dot worst"))
        else:
            parts.append(tag("circle", title, cx=x, cy=y, r=3.0, class_="dot"))
        corner = labels.place(float(x), float(y), text := str(numbers[index]), gap)
        if corner is not None:
            parts.append(tag("text", text, x=corner[0], y=corner[1], class_="dot-number"))
    return parts


class Labels:
    """Places texts so that none covers a dot or another text."""

    def __init__(self, places: Floats) -> None:
        self._boxes = [(x - 4, y - 4, x + 4, y + 4) for x, y in places.tolist()]

    def place(self, x: float, y: float, text: str, gap: float) -> tuple[float, float] | None:
        """Return where `text` begins beside the dot at (x, y), or `None` where there is no room."""
        width = 5.6 * len(text)
        for dx, dy in ((gap, 3.0), (-gap - width, 3.0), (-width / 2, -1 - gap), (-width / 2, 13.0)):
            if self._is_free(box := (x + dx, y + dy - 8, x + dx + width, y + dy)):
                self._boxes.append(box)
                return x + dx, y + dy
        return None

    def place_outside(self, radius: float, turn_deg: float, text: str) -> tuple[float, float]:
        """Return where `text` begins outside a circle: the free place nearest to a turn."""
        width = 7.6 * len(text)
        corners = []
        for shift_deg in sorted(range(-40, 45, 5), key=abs):
            turn = math.radians(turn_deg + shift_deg)
            x, y = radius * math.cos(turn), radius * math.sin(turn)
            corners.append((x if x > 0 else x - width, y))
        boxes = [(x, y - 10, x + width, y + 1) for x, y in corners]
        chosen = next((i for i, box in enumerate(boxes) if self._is_free(box)), 0)
        self._boxes.append(boxes[chosen])
        return corners[chosen]

    def _is_free(self, box: tuple[float, ...]) -> bool:
        return not any(_overlap(box, other) for other in self._boxes)


def _overlap(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _nearest_axis(direction: Floats) -> str:
    largest = int(np.argmax(np.abs(direction)))
    return ("+" if direction[largest] > 0 else "-") + _AXES[largest]
