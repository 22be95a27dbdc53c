"""How straight each edge is: the rows' offsets along it, with their uncertainty."""

import numpy as np
from markupsafe import Markup

from pivometer.report.svg import picture, points, tag
from pivometer.shaft.edges import ShaftEdges

_WIDTH, _HEIGHT, _LEFT = 240.0, 84.0, 34.0
_LEAST_SPAN_PX = 0.1
"""Edges straighter than this look straight; a finer scale would show noise as if it mattered."""


def edge_plot(edges: ShaftEdges) -> Markup | None:
    """Draw both edges' offsets from their lines along the shaft; `None` if none are stated."""
    known = edges.deviation_sigma_px > 0
    if not known.any():
        return None
    reach = np.abs(edges.deviation_px) + 2 * edges.deviation_sigma_px
    span = max(float(reach[known].max()), _LEAST_SPAN_PX)
    parts = []
    for edge, middle in enumerate((0.27 * _HEIGHT, 0.73 * _HEIGHT)):
        scale = 0.21 * _HEIGHT / span
        parts.append(tag("path", d=f"M{_LEFT:.0f},{middle:.1f}H{_WIDTH:.0f}", class_="grid"))
        place = _LEFT + (np.arange(known.shape[1]) + 0.5) * (_WIDTH - _LEFT) / known.shape[1]
        x, size = place[known[edge]], edges.deviation_px[edge, known[edge]]
        sigma = 2 * edges.deviation_sigma_px[edge, known[edge]]
        over, under = middle - (size + sigma) * scale, middle - (size - sigma) * scale
        band = [*zip(x, over, strict=True), *zip(x[::-1], under[::-1], strict=True)]
        line = points(zip(x, middle - size * scale, strict=True))
        parts += [
            tag("polygon", points=points(band), class_="edge-band"),
            tag("polyline", points=line, class_="edge-line"),
        ]
    for place_y, text in ((0.06 * _HEIGHT, f"+{span:.2f}"), (0.48 * _HEIGHT, f"−{span:.2f}")):
        y = place_y + 4
        parts.append(tag("text", text, x=_LEFT - 4, y=y, text_anchor="end", class_="tick"))
    title = f"Camera {edges.camera}: offsets of both edges from their lines, px, along the shaft"
    return picture(*parts, width=_WIDTH, height=_HEIGHT, title=title, class_="edge-plot")
