"""The report's figures and tables, live in step 4."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup
from nicegui import ui

from pivometer.app.shell import attribute, drawing, tag
from pivometer.measurement import Measurement, UsedPose
from pivometer.report import captions
from pivometer.report.chart import pose_chart
from pivometer.report.points import all_points_table
from pivometer.report.scene import scene, scene_picture
from pivometer.report.shaft_tables import shaft_table
from pivometer.report.structure_figures import direction_map, order_chart
from pivometer.report.structure_tables import (
    component_table,
    pattern_table,
    structure_sentences,
)
from pivometer.report.tables import (
    Table,
    board_location_table,
    location_table,
    miss_table,
    own_error_table,
    paper_table,
)
from pivometer.report.target import target_plot

Figure = tuple[Markup, str]
"""A drawing, and the words under it."""


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """What step 4 shows below the poses.

    Parameters
    ----------
    side_by_side, rig
        Figures of half the width: how the centerlines pass the RCM; the rig and the RCM in it.
    chart, order
        Figures of the whole width: the misses, and their order.
    sentences
        What the misses follow.
    tables
        The tables.
    """

    side_by_side: tuple[Figure, ...]
    rig: tuple[Figure, ...]
    chart: Figure
    order: Figure | None
    sentences: tuple[str, ...]
    tables: tuple[Table, ...]


def drawn(measured: Measurement) -> Drawn:
    """Make all drawings and tables of a measurement; it takes a moment."""
    numbers = [n for n, pose in enumerate(measured.poses, 1) if isinstance(pose, UsedPose)]
    structure = measured.structure
    beside: list[Figure] = [(target_plot(measured, numbers), captions.target(measured))]
    if structure is not None:
        beside.append((direction_map(structure), captions.MAP))
    shown = scene(measured, numbers)
    near = scene_picture(shown, shown.near_zoom, "scene-near")
    return Drawn(
        side_by_side=tuple(beside),
        rig=(
            (scene_picture(shown, 1, "scene"), captions.scene_far(measured)),
            (near, captions.scene_near(shown.near_zoom)),
        ),
        chart=(pose_chart(measured), captions.CHART),
        order=None if structure is None else (order_chart(structure), captions.ORDER),
        sentences=() if structure is None else tuple(structure_sentences(structure)),
        tables=tuple(table for table in _tables(measured) if table is not None),
    )


def _tables(measured: Measurement) -> tuple[Table | None, ...]:
    structure = measured.structure
    return (
        location_table(measured),
        board_location_table(measured),
        miss_table(measured),
        own_error_table(measured),
        paper_table(measured),
        all_points_table(measured),
        shaft_table(measured),
        None if structure is None else component_table(structure),
        pattern_table(structure) if structure is not None and structure.patterns else None,
    )


def show_figures(made: Drawn) -> None:
    """Show the target, the misses, what they follow, and the rig."""
    tag("h2", "Figures")
    with ui.element("div").classes("two"):
        for figure in made.side_by_side:
            _figure(*figure)
    _figure(*made.chart)
    if made.order is not None:
        tag("h3", "What the misses follow")
        for sentence in made.sentences:
            tag("p", sentence)
        _figure(*made.order)
    with ui.element("div").classes("two"):
        for figure in made.rig:
            _figure(*figure)


def _figure(svg: Markup, caption: str) -> None:
    with ui.element("figure"):
        drawing(svg)
        tag("figcaption", caption)


def show_tables(made: Drawn) -> None:
    """Show the tables of the report that are not of single poses."""
    tag("h2", "Tables")
    for table in made.tables:
        _draw(table)


def _draw(table: Table) -> None:
    box = ui.element("div").classes("scroll").props('tabindex="0" role="region"')
    box.props(f'aria-label="{attribute(table.caption)}"')
    with box, ui.element("table"):
        tag("caption", table.caption)
        with ui.element("thead"), ui.element("tr"):
            for name in table.columns:
                cell = tag("th" if name else "td", name)
                if name:
                    cell.props('scope="col"')
        with ui.element("tbody"):
            for heading, *cells in table.rows:
                with ui.element("tr"):
                    tag("th", heading).props('scope="row"')
                    for content in cells:
                        tag("td", content)
    tag("p", table.note).classes("lead")
