"""What the edges say of the shaft and of the cameras, as a table and a sentence."""

from pivometer.measurement import Measurement, ShaftAgreement
from pivometer.report.digits import uncertainty_text, with_uncertainty
from pivometer.report.tables import Table
from pivometer.shaft.stillness import CameraMovement
from pivometer.uncertainty.shaft_check import MoveTest


def shaft_sentence(measurement: Measurement) -> str:
    """State the measured diameter beside the nominal one; empty where none was measured."""
    if measurement.shaft is None:
        return ""
    found, nominal = measurement.shaft.diameter, measurement.setup.diameter_mm
    beside = "no nominal one is stated" if nominal is None else f"stated {nominal:g} mm"
    value = with_uncertainty(found.value_mm, found.expanded_mm)
    return f"The shaft's diameter is {value} mm (U, k = {found.coverage_factor:.2f}; {beside})."


def shaft_table(measurement: Measurement) -> Table | None:
    """Tabulate diameter, agreement of edges and cameras, and straightness; `None` where unknown."""
    shaft, nominal = measurement.shaft, measurement.setup.diameter_mm
    if shaft is None:
        return None
    found = shaft.diameter
    parts = (found.edges_u_mm, found.shading_u_mm, found.calibration_u_mm)
    rows = [
        ("diameter measured ± U, mm", with_uncertainty(found.value_mm, found.expanded_mm)),
        ("diameter stated, mm", "–" if nominal is None else f"{nominal:g}"),
        (
            "u from edges / shading / calibration, mm",
            " / ".join(uncertainty_text(u) for u in parts),
        ),
        ("edges miss the cylinders, over what is stated", f"{shaft.scatter:.1f}×"),
        ("cameras as calibrated: χ² / limit", _test(shaft.moved)),
        ("a camera moved during the session: χ² / limit", _test(shaft.change)),
        ("largest χ² of a pose / limit", _worst(measurement)),
        ("the two centerlines of a pose apart by at most, mm", _apart(measurement)),
        *_bend_rows(shaft),
        *map(_movement_row, measurement.camera_movements),
    ]
    return Table(
        "The shaft: one straight cylinder for all edges, poses and cameras",
        ("quantity", "found"),
        tuple(rows),
        "A cylinder of one common diameter is fitted to all edges of a pose, and what is left over "
        "is held against noise, shading and the calibration’s covariance; limits are what chance "
        "exceeds once in ten thousand sessions. The size of a board square is not in U: the "
        "diameter checks it. Centerlines here are "
        + (
            "the intersections of the planes midway between the edges (14)–(16)"
            if shaft.route == "paper"
            else "the axes of these cylinders"
        )
        + ". With two cameras only turns of about a degree show; a third shows hundredths. "
        "Scenery that stands still shows the turns of each camera alone.",
    )


def _movement_row(moved: CameraMovement) -> tuple[str, str]:
    where = f"between {moved.before} and {moved.after}; {moved.views} pictures"
    return (
        f"camera {moved.camera}: largest shift of the scenery / limit, px",
        f"{moved.shift_px:.3f} / {moved.limit_px:.2f} ({where})",
    )


def _test(test: MoveTest) -> str:
    return f"{test.chi_square:.0f} / {test.limit:.0f}"


def _worst(measurement: Measurement) -> str:
    seen = [pose for pose in measurement.used if pose.cylinder is not None]
    cylinders = [pose.cylinder for pose in seen if pose.cylinder is not None]
    worst = max(range(len(seen)), key=lambda i: cylinders[i].chi_square / cylinders[i].limit)
    one = cylinders[worst]
    return f"{one.chi_square:.0f} / {one.limit:.0f} (pose {seen[worst].pose})"


def _apart(measurement: Measurement) -> str:
    apart = [pose.cylinder.apart_mm for pose in measurement.used if pose.cylinder is not None]
    return f"{max(apart):.4f}"


def _bend_rows(shaft: ShaftAgreement) -> list[tuple[str, str]]:
    bend = shaft.bend
    if bend is None:
        return []
    text = f"{with_uncertainty(bend.sagitta_mm, bend.u_mm)} over {bend.length_mm:.0f} mm"
    told = "significant" if bend.significant else "not told from chance"
    return [("common bow of the shaft ± u, mm", f"{text}: {told}")]
