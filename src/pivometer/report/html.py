"""The report as one HTML file that asks no host for anything."""

import base64
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

from markupsafe import Markup

from pivometer.calibration.advice import advice
from pivometer.calibration.result import Calibration
from pivometer.measurement import Measurement, RejectedPose, UsedPose
from pivometer.report import captions, setup_tables, tables
from pivometer.report.chart import pose_chart
from pivometer.report.coverage import coverage_pictures
from pivometer.report.edge_plots import edge_plot, profile_plot
from pivometer.report.embedding import Carried, SimulatedTruth
from pivometer.report.overlays import PosePicture, pose_pictures
from pivometer.report.page import asset, render_page
from pivometer.report.points import all_points_table
from pivometer.report.scene import scene, scene_picture
from pivometer.report.shaft_tables import shaft_table
from pivometer.report.signatures import SEALED, roles
from pivometer.report.structure_figures import direction_map, order_chart
from pivometer.report.structure_tables import (
    component_table,
    pattern_table,
    structure_sentences,
)
from pivometer.report.tables import Table
from pivometer.report.target import deciding_poses, mean_shaft_view, target_plot
from pivometer.report.thumbnails import Thumbnail
from pivometer.report.uncertainty_tables import (
    budget_sentences,
    budget_table,
    floor_table,
    monte_carlo_table,
)
from pivometer.report.verdict import verdict
from pivometer.shaft.across import EdgeProfiles


@dataclass(frozen=True, slots=True, eq=False)
class _Card:
    """One pose in the gallery."""

    anchor: str
    number: int
    name: str
    worst: bool
    facts: tuple[tuple[str, str], ...]
    reason: str
    next_step: str
    pictures: tuple[PosePicture, ...]
    edges: Table
    plots: tuple[Markup, ...]
    warnings: tuple[str, ...]


def render_html(
    measurement: Measurement,
    *,
    thumbnails: Mapping[tuple[str, str], Thumbnail],
    profiles: Mapping[tuple[str, str], EdgeProfiles] | None = None,
    simulated_truth: SimulatedTruth | None = None,
    carried: Carried | None = None,
) -> str:
    """Return the report of a measurement as the text of one HTML file.

    The file holds its styles, pictures and script, and forbids every request to a host. It can be
    read on paper, in light and dark, and without JavaScript or colour.

    Parameters
    ----------
    measurement
        What to report. Nothing is computed here that it does not hold.
    thumbnails
        Pictures by (pose, camera); a missing one is left out.
    profiles
        Grey levels across the edges by (pose, camera); a missing one is left out.
    simulated_truth
        For a simulated session: adds how far the answer is from the truth.
    carried
        What the page carries of what it was made from, so that it can be verified.

    Returns
    -------
    str
        The page, to be written as UTF-8.
    """
    script = asset("viewer.js")
    return render_page(
        "report.html.j2",
        m=measurement,
        made=setup_tables.provenance_table(measurement, carried.seal if carried else "not stated"),
        created=setup_tables.moment_text(measurement),
        carried=carried,
        script=script,
        script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii"),
        **_figures(measurement),
        **_tables(measurement),
        captions=captions,
        sealed=SEALED,
        roles=roles(measurement),
        structure=_structure(measurement),
        truth=None if simulated_truth is None else tables.truth_table(measurement, simulated_truth),
        cards=[
            _card(pose, measurement, thumbnails, profiles or {}, n)
            for n, pose in _numbered(measurement)
        ],
    )


def _numbered(measurement: Measurement) -> list[tuple[int, UsedPose | RejectedPose]]:
    """Return the poses numbered from 1 in the session's order, as everywhere in the report."""
    return list(enumerate(measurement.poses, start=1))


def _figures(measurement: Measurement) -> dict[str, object]:
    numbers = [n for n, pose in _numbered(measurement) if isinstance(pose, UsedPose)]
    shown = scene(measurement, numbers)
    return {
        "coverage": coverage_pictures(measurement.calibration)
        if isinstance(measurement.calibration, Calibration)
        else [],
        "target": target_plot(measurement, numbers),
        "view": mean_shaft_view(measurement),
        "chart": pose_chart(measurement),
        "scene_far": scene_picture(shown, 1, "scene"),
        "scene_near": scene_picture(shown, shown.near_zoom, "scene-near"),
        "near_zoom": shown.near_zoom,
    }


def _tables(measurement: Measurement) -> dict[str, object]:
    numbers = {pose.pose: n for n, pose in _numbered(measurement)}
    calibration = measurement.calibration
    return {
        "verdict": verdict(measurement),
        "advice": advice(calibration, at_mm=measurement.rcm.least_squares.point_mm)
        if isinstance(calibration, Calibration)
        else None,
        "location": tables.location_table(measurement),
        "board_location": tables.board_location_table(measurement),
        "misses": tables.miss_table(measurement),
        "own": tables.own_error_table(measurement),
        "shaft": shaft_table(measurement),
        "budget": budget_table(measurement),
        "budget_sentences": budget_sentences(measurement),
        "monte_carlo": monte_carlo_table(measurement),
        "floor": floor_table(measurement),
        "all_points": all_points_table(measurement),
        "paper": tables.paper_table(measurement),
        "poses": tables.pose_table(measurement, numbers),
        "rejected": tables.rejected_table(measurement),
        "cameras": setup_tables.camera_table(measurement),
        "relative_pose": setup_tables.relative_pose_table(measurement),
        "lengths": (
            setup_tables.length_table(calibration) if isinstance(calibration, Calibration) else None
        ),
        "views": (
            setup_tables.view_table(calibration) if isinstance(calibration, Calibration) else None
        ),
        "setup": setup_tables.setup_table(measurement),
        "inputs": tables.input_table(measurement.inputs),
        "anchors": {name: f"pose-{n}" for name, n in numbers.items()},
    }


def _structure(measurement: Measurement) -> dict[str, object] | None:
    """Return the section on the structure of the error; `None` where that is not stated."""
    structure = measurement.structure
    if structure is None:
        return None
    return {
        "sentences": structure_sentences(structure),
        "components": component_table(structure),
        "patterns": pattern_table(structure) if structure.patterns else None,
        "map": direction_map(structure),
        "order": order_chart(structure),
    }


def _card(
    pose: UsedPose | RejectedPose,
    measurement: Measurement,
    thumbnails: Mapping[tuple[str, str], Thumbnail],
    profiles: Mapping[tuple[str, str], EdgeProfiles],
    number: int,
) -> _Card:
    return _Card(
        anchor=f"pose-{number}",
        number=number,
        name=pose.pose,
        worst=pose.pose in deciding_poses(measurement),
        facts=tables.pose_facts(pose, measurement) if isinstance(pose, UsedPose) else (),
        reason="" if isinstance(pose, UsedPose) else pose.reason,
        next_step="" if isinstance(pose, UsedPose) else pose.next_step,
        pictures=pose_pictures(pose, measurement, thumbnails),
        edges=tables.edge_table(pose),
        plots=_plots(pose, profiles),
        warnings=tuple(f"{one.camera}: {text}" for one in pose.edges for text in one.warnings),
    )


def _plots(
    pose: UsedPose | RejectedPose, profiles: Mapping[tuple[str, str], EdgeProfiles]
) -> tuple[Markup, ...]:
    """Draw every camera's edges across, then along."""
    cameras = [one.camera for one in pose.edges if (pose.pose, one.camera) in profiles]
    across = [profile_plot(profiles[pose.pose, camera], camera) for camera in cameras]
    along = [plot for one in pose.edges if (plot := edge_plot(one)) is not None]
    return (*across, *along)
