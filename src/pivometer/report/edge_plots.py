"""Each edge, along: its rows' offsets with their uncertainty; and across: its grey levels."""

from functools import lru_cache

import numpy as np
from markupsafe import Markup

from pivometer._arrays import Floats
from pivometer.report.svg import DRAWN_TWICE, number, picture, points, tag
from pivometer.shaft.across import EdgeProfiles
from pivometer.shaft.edges import ShaftEdges

_WIDTH, _HEIGHT, _LEFT = 240.0, 84.0, 52.0
_LEAST_SPAN_PX = 0.1
"""Edges straighter than this look straight; a finer scale would show noise as if it mattered."""

_TELLING_PX = 0.1
"""Sections known worse than this do not set the scale; their bands are cut off at it."""


@lru_cache(maxsize=DRAWN_TWICE)
def edge_plot(edges: ShaftEdges) -> Markup | None:
    """Draw both edges' offsets from their lines along the shaft; `None` if none are stated."""
    known = edges.deviation_sigma_px > 0
    if not known.any():
        return None
    telling = known & (edges.deviation_sigma_px < _TELLING_PX)
    reach = np.abs(edges.deviation_px) + 2 * edges.deviation_sigma_px
    span = max(float(reach[telling].max(initial=0.0)), _LEAST_SPAN_PX)
    scale = 0.22 * _HEIGHT / span
    parts = []
    for edge, middle in enumerate((0.27 * _HEIGHT, 0.73 * _HEIGHT)):
        place = _LEFT + (np.arange(known.shape[1]) + 0.5) * (_WIDTH - _LEFT) / known.shape[1]
        x, size = place[known[edge]], edges.deviation_px[edge, known[edge]]
        sigma = 2 * edges.deviation_sigma_px[edge, known[edge]]
        line, over, under = (
            middle - np.clip(rows, -span, span) * scale
            for rows in (size, size + sigma, size - sigma)
        )
        band = [*zip(x, over, strict=True), *zip(x[::-1], under[::-1], strict=True)]
        parts += [
            tag("path", d=f"M{_LEFT:.0f},{middle:.1f}H{_WIDTH:.0f}", class_="grid"),
            tag("polygon", points=points(band), class_="edge-band"),
            tag("polyline", points=points(zip(x, line, strict=True)), class_="edge-line"),
            tag(
                "text",
                f"± {span:.2f}",
                x=_LEFT - 6,
                y=middle + 4,
                text_anchor="end",
                class_="tick",
            ),
        ]
    title = f"Camera {edges.camera}: offsets of both edges from their lines, px, along the shaft"
    parts.append(tag("title", title))
    return picture(*parts, width=_WIDTH, height=_HEIGHT, title=title, class_="edge-plot")


@lru_cache(maxsize=DRAWN_TWICE)
def profile_plot(profiles: EdgeProfiles, camera: str) -> Markup:
    """Draw the grey levels across both edges, the shaft between them, and the fitted steps."""
    low, high = float(profiles.grey.min()), float(profiles.grey.max())
    scale = 0.9 * _HEIGHT / max(high - low, 1.0)
    wide = (_WIDTH - _LEFT) / 2
    reach = float(np.ptp(profiles.distance_px))
    parts = [
        tag("text", f"{high:.0f}", x=_LEFT - 6, y=12.0, text_anchor="end", class_="tick"),
        tag("text", f"{low:.0f}", x=_LEFT - 6, y=_HEIGHT - 3, text_anchor="end", class_="tick"),
    ]
    for edge, sense in enumerate((-1.0, 1.0)):
        # The shaft lies between: the first edge's outside to the left, the second's to the right.
        centre = _LEFT + wide - sense * (-0.03 * wide + profiles.distance_px.min() / reach * wide)
        x = centre + sense * profiles.distance_px / reach * 0.94 * wide
        seen, fitted = (
            0.95 * _HEIGHT - (y[edge] - low) * scale for y in (profiles.grey, profiles.fitted)
        )
        parts += [
            tag("path", d=f"M{centre:.1f},0V{_HEIGHT:.0f}", class_="grid"),
            tag("path", d=_dots(x, seen), class_="edge-dots"),
            tag("polyline", points=points(zip(x, fitted, strict=True)), class_="edge-fit"),
        ]
    title = f"Camera {camera}: grey levels across both edges, and a step at each fitted edge"
    return picture(
        *parts, tag("title", title), width=_WIDTH, height=_HEIGHT, title=title, class_="edge-plot"
    )


def _dots(x: Floats, y: Floats) -> str:
    """Draw dots as one path of strokes without length: circles take long to typeset."""
    pairs = zip(x, y, strict=True)
    return "".join(f"M{number(float(a))} {number(float(b))}h0" for a, b in pairs)
