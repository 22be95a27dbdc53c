"""Reports: they show what a measurement holds and compute nothing of their own."""

from pivometer.report.embedding import SimulatedTruth
from pivometer.report.html import render_html
from pivometer.report.tables import Table
from pivometer.report.thumbnails import Thumbnail, make_thumbnail
from pivometer.report.verdict import Verdict, verdict

__all__ = [
    "SimulatedTruth",
    "Table",
    "Thumbnail",
    "Verdict",
    "make_thumbnail",
    "render_html",
    "verdict",
]
