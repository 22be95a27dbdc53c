"""Small live pictures: the sphere of shaft directions, and how the uncertainty shrinks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from pivometer._arrays import Floats
from pivometer.geometry.line import unit
from pivometer.rcm.cone import signed_axes
from pivometer.rcm.pose_advice import WANTED_CONE_DEG, poses_to_add
from pivometer.report.svg import number, picture, points, tag
from pivometer.report.target import ShaftView, shaft_view

_SIZE, _WIDEST_DEG = 300.0, 45.0
_SCALE = 0.44 * _SIZE / _WIDEST_DEG


def pose_map(directions: Floats, *, now: Floats | None = None) -> Markup:
    """Draw the shaft's directions as seen along their middle, in degrees of tilt.

    Dots are poses taken, the dashed circle is the cone to fill, open circles are poses to add, and
    the cross is where the shaft points now.

    Parameters
    ----------
    directions
        Of the poses taken, shape (n, 3), n ≥ 1.
    now
        The shaft's direction now, shape (3,).
    """
    tips, middle = signed_axes(unit(directions))
    view = shaft_view(middle[None])
    parts = [_circle(0.0, 0.0, ring * _SCALE, "ring") for ring in (15.0, 30.0, 45.0)]
    parts.append(_circle(0.0, 0.0, WANTED_CONE_DEG / 2 * _SCALE, "want"))
    right, down = view.names()
    parts.append(tag("text", f"{right} →", x=_SIZE - 36, y=_SIZE / 2 - 6))
    parts.append(tag("text", f"{down} ↓", x=_SIZE / 2 + 6, y=_SIZE - 6))
    parts += [_circle(*_place(one, view), 6.0, "next") for one in poses_to_add(directions)]
    parts += [_circle(*_place(one, view), 3.4, "have") for one in tips]
    if now is not None:
        x, y = (v + _SIZE / 2 for v in _place(now, view))
        cross = f"M{number(x - 8)},{number(y)}h16M{number(x)},{number(y - 8)}v16"
        parts.append(tag("path", d=cross, class_="now"))
    title = (
        f"Directions of {len(directions)} poses; the dashed circle is the cone of "
        f"{WANTED_CONE_DEG:.0f}° to fill, open circles are poses to add"
    )
    return picture(*parts, width=_SIZE, height=_SIZE, title=title, class_="map")


def _place(direction: Floats, view: ShaftView) -> tuple[float, float]:
    """Return where a direction lies in the map: as far from the middle as it is tilted."""
    toward = direction * np.sign(direction @ view.into)
    across = np.array([toward @ view.right, toward @ view.down])
    tilt = float(np.degrees(np.arctan2(np.linalg.norm(across), toward @ view.into)))
    length = float(np.linalg.norm(across))
    x, y = across * (_SCALE * min(tilt, _WIDEST_DEG) / length if length > 0 else 0.0)
    return float(x), float(y)


def _circle(x: float, y: float, radius: float, name: str) -> Markup:
    return tag("circle", cx=x + _SIZE / 2, cy=y + _SIZE / 2, r=radius, class_=name)


def shrinking_chart(counts: Sequence[int], expanded_mm: Sequence[float]) -> Markup:
    """Draw how the expanded uncertainty of the location shrank with the number of poses.

    Parameters
    ----------
    counts
        Numbers of poses, rising.
    expanded_mm
        Largest expanded uncertainty of a coordinate then, mm.
    """
    width, height = 300.0, 110.0
    top = max(expanded_mm)
    xs = np.linspace(46, width - 10, len(counts)) if len(counts) > 1 else np.array([46.0])
    places = [
        (float(x), height - 22 - (height - 34) * value / top)
        for x, value in zip(xs, expanded_mm, strict=True)
    ]
    base = height - 22
    return picture(
        tag("path", d=f"M46,12V{number(base)}H{number(width - 10)}", class_="ring"),
        tag("polyline", points=points(places), class_="line"),
        *(tag("circle", cx=x, cy=y, r=3.0, class_="have") for x, y in places),
        tag("text", f"{top:.2g}", x=2.0, y=16.0),
        tag("text", "0 mm", x=2.0, y=base),
        tag("text", f"{counts[0]} poses", x=46.0, y=height - 5),
        tag("text", str(counts[-1]), x=width - 22, y=height - 5),
        width=width,
        height=height,
        title=f"Expanded uncertainty of the location, mm, from {counts[0]} to {counts[-1]} poses",
        class_="map",
    )
