"""The tables of a report, as plain text: number formats are decided here and nowhere else."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration.result import Calibration
from pivometer.measurement import Measurement, RejectedPose, UsedPose
from pivometer.report.digits import decimals_of, error_decimals, fixed, small, uncertainty_text
from pivometer.report.embedding import SimulatedTruth
from pivometer.report.target import deciding_poses, nearest_points_mm
from pivometer.uncertainty.pose_miss import miss_interval_mm
from pivometer.uncertainty.propagation import LocationUncertainty


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """A table with its caption.

    Parameters
    ----------
    caption
        What it holds, with the unit and frame.
    columns
        Column headings; the first stands over the row headings.
    rows
        Cells; the first of each row is its heading.
    note
        What a reader must know to use it.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def location_table(measurement: Measurement) -> Table:
    """Tabulate both RCM points with the expanded uncertainty of the location and its parts."""
    uncertainty, rcm = measurement.uncertainty, measurement.rcm
    decimals = [decimals_of(float(expanded)) for expanded in uncertainty.expanded_mm]
    lines_u = np.sqrt(np.maximum(np.diag(uncertainty.lines_mm2), 0.0))
    calibration_u, light_u, known = ["unknown"] * 3, ["unknown"] * 3, False
    if isinstance(uncertainty, LocationUncertainty):
        known = True
        variances = np.maximum(np.diag(uncertainty.calibration_mm2), 0.0)
        calibration_u = [uncertainty_text(u) for u in np.sqrt(variances)]
        light_u = [uncertainty_text(u) for u in np.sqrt(np.diag(uncertainty.shading_mm2))]
    rows = [
        (
            axis,
            fixed(rcm.least_squares.point_mm[i], decimals[i]),
            uncertainty_text(uncertainty.expanded_mm[i]),
            uncertainty_text(lines_u[i]),
            calibration_u[i],
            light_u[i],
            fixed(rcm.minimax.point_mm[i], decimals[i]),
        )
        for i, axis in enumerate("xyz")
    ]
    return Table(
        f"RCM location in the frame of camera “{measurement.reference_camera}”, mm",
        (
            "axis",
            "least squares",
            ("± U" if known else "± U, centerlines only")
            + f" (k = {uncertainty.coverage_factor:.2f})",
            "u from the centerlines",
            "u from the calibration",
            "u from light",
            "minimax",
        ),
        tuple(rows),
        "U is the expanded uncertainty of the least-squares point, each axis by itself: "
        f"{100 * uncertainty.coverage:.0f} % coverage, "
        f"{_freedom(uncertainty.degrees_of_freedom)}; u are standard uncertainties, combined as "
        "the root of the sum of squares. The frame has x to the right, y down and z forward."
        + _unknown_part(measurement),
    )


def board_location_table(measurement: Measurement) -> Table | None:
    """Tabulate both RCM points in the reference board's frame; `None` without such a frame."""
    frame = measurement.board_frame
    if frame is None:
        return None
    uncertainty = frame.uncertainty
    decimals = [decimals_of(float(expanded)) for expanded in uncertainty.expanded_mm]
    parts_u = [
        np.sqrt(np.maximum(np.diag(covariance), 0.0))
        for covariance in (
            uncertainty.lines_mm2,
            uncertainty.calibration_mm2,
            uncertainty.board_mm2,
            uncertainty.shading_mm2,
        )
    ]
    rows = [
        (
            axis,
            fixed(frame.least_squares_point_mm[i], decimals[i]),
            uncertainty_text(uncertainty.expanded_mm[i]),
            *(uncertainty_text(part[i]) for part in parts_u),
            fixed(frame.minimax_point_mm[i], decimals[i]),
        )
        for i, axis in enumerate("xyz")
    ]
    return Table(
        "RCM location in the frame of the reference board, mm",
        (
            "axis",
            "least squares",
            f"± U (k = {uncertainty.coverage_factor:.2f})",
            "u from the centerlines",
            "u from the calibration",
            "u from the board’s corners",
            "u from light",
            "minimax",
        ),
        tuple(rows),
        "The board stood still beside the RCM, so errors of the cameras shift both alike and most "
        "of the calibration’s uncertainty drops out: this is the location to use. The origin is "
        "the board’s inner corner 0; x runs across, y down and z away from the viewer. U: "
        f"{100 * uncertainty.coverage:.0f} % coverage, "
        f"{_freedom(uncertainty.degrees_of_freedom)}. Mean of {len(frame.views)} views; the "
        f"corners miss by {frame.rms_px:.3f} px rms."
        + (f" Note: {frame.note}." * bool(frame.note)),
    )


def miss_table(measurement: Measurement) -> Table:
    """Tabulate max and rms at both points, their separation and the certificate."""
    rcm = measurement.rcm
    minimax, squares = rcm.minimax, rcm.least_squares
    decimals = error_decimals([minimax.max_mm, minimax.rms_mm, squares.rms_mm])
    return Table(
        "RCM error at both points, mm",
        ("quantity", "minimax", "least squares"),
        (
            (
                "largest miss (max)",
                fixed(minimax.max_mm, decimals),
                fixed(squares.max_mm, decimals),
            ),
            ("rms miss", fixed(minimax.rms_mm, decimals), fixed(squares.rms_mm, decimals)),
        ),
        f"The two points are {fixed(rcm.separation_mm, decimals)} mm apart. The minimax value is "
        f"proved least to a relative gap of {small(minimax.certificate_gap)}. The directions of "
        f"the {len(measurement.used)} poses fill a cone of {rcm.cone_deg:.0f}° apex angle. Misses "
        "are as observed: they hold the instrument's own error too."
        + _calibration_share(measurement),
    )


def _calibration_share(measurement: Measurement) -> str:
    """Say what the calibration adds to the misses."""
    uncertainty = measurement.uncertainty
    if not isinstance(uncertainty, LocationUncertainty):
        return " What the calibration adds is unknown: the rig was imported."
    return (
        " Of that, the calibration adds a standard uncertainty of "
        f"{uncertainty_text(uncertainty.max_calibration_u_mm)} mm to the max and "
        f"{uncertainty_text(uncertainty.rms_calibration_u_mm)} mm to the rms from the "
        "least-squares point."
    )


def _unknown_part(measurement: Measurement) -> str:
    """Say so where U lacks the calibration's part."""
    if isinstance(measurement.uncertainty, LocationUncertainty):
        return ""
    return (
        " The rig was imported without its uncertainty: U holds the scatter of the centerlines "
        "only and is too small by an unknown amount."
    )


def own_error_table(measurement: Measurement) -> Table | None:
    """Tabulate the robot's own error apart from the instrument's; `None` where it is unknown."""
    own, rcm = measurement.intrinsic, measurement.rcm
    if own is None:
        return None
    decimals = error_decimals([rcm.least_squares.rms_mm, own.instrument_rms_mm])
    rms, largest = (
        " to ".join(fixed(float(end), decimals) for end in ends)
        for ends in (own.rms_interval_mm, own.max_interval_mm)
    )
    rows = (
        (
            "rms miss (least squares)",
            fixed(rcm.least_squares.rms_mm, decimals),
            fixed(own.instrument_rms_mm, decimals),
            rms,
        ),
        ("largest miss (minimax)", fixed(rcm.minimax.max_mm, decimals), "–", largest),
    )
    return Table(
        "The robot’s own error apart from the instrument’s, mm",
        ("quantity", "observed", "instrument alone", f"own, {100 * own.coverage:.0f} % interval"),
        rows,
        "Over the poses measured. An instrument that adds noise to every line makes a good robot "
        "look worse: the noise is known from edges and calibration, and taken off.",
    )


def paper_table(measurement: Measurement) -> Table:
    """Tabulate the result in the form of the paper's Table I, the paper's own figures beside it."""
    rcm, calibration = measurement.rcm, measurement.calibration
    lengths = calibration.edge_length_error if isinstance(calibration, Calibration) else None
    known = [] if lengths is None else [lengths.rms_mm]
    decimals = error_decimals([*known, rcm.minimax.rms_mm, rcm.least_squares.rms_mm])

    def row(
        name: str, ours: tuple[float | None, float, float], paper: tuple[str, ...]
    ) -> tuple[str, ...]:
        cells = ("unknown" if value is None else fixed(value, decimals) for value in ours)
        return (name, *cells, *paper)

    return Table(
        "RCM evaluation results in the form of the paper's Table I, mm",
        (
            "",
            "Calibration",
            "this measurement, minimax",
            "this measurement, least squares",
            "paper: Calibration",
            "paper: Gold Standard",
            "paper: da Vinci",
        ),
        (
            row(
                "error (max)",
                (lengths.max_mm if lengths else None, rcm.minimax.max_mm, rcm.least_squares.max_mm),
                ("0.253", "0.391", "7.086"),
            ),
            row(
                "error (rms)",
                (lengths.rms_mm if lengths else None, rcm.minimax.rms_mm, rcm.least_squares.rms_mm),
                ("0.130", "0.145", "3.010"),
            ),
        ),
        "The three columns headed “paper” are the figures Wilson et al. printed for their own "
        "set-up; they are not results of this measurement. “Calibration” is the error of the "
        "reconstructed edges of the board.",
    )


def pose_table(measurement: Measurement, numbers: Mapping[str, int]) -> Table:
    """Tabulate every used pose, the worst first."""
    used = sorted(measurement.used, key=lambda pose: -pose.distance_mm.minimax)
    worst = deciding_poses(measurement)
    rcm = measurement.rcm
    decimals = error_decimals([rcm.minimax.rms_mm, rcm.least_squares.rms_mm])
    names = [camera.name for camera in measurement.calibration.rig.cameras]
    ends = dict(zip((p.pose for p in measurement.used), miss_intervals(measurement), strict=True))
    rows = [
        (
            pose.pose,
            str(numbers[pose.pose]),
            fixed(pose.distance_mm.minimax, decimals),
            fixed(pose.distance_mm.least_squares, decimals),
            f"{pose.dihedral_deg:.1f}",
            *(f"{diameter:.3f}" for diameter in pose.diameters_mm),
            " to ".join(fixed(float(end), decimals) for end in ends[pose.pose]),
            "▲ max" if pose.pose in worst else "",
        )
        for pose in used
    ]
    return Table(
        "Distance of every centerline from the RCM, worst first",
        (
            "pose",
            "no.",
            "minimax, mm",
            "least squares, mm",
            "dihedral angle, °",
            *(f"diameter {name}, mm" for name in names),
            "minimax, 95 % interval, mm",
            "",
        ),
        tuple(rows),
    )


def miss_intervals(measurement: Measurement) -> Floats:
    """Return the 95 % interval of each used pose's miss from the minimax point, shape (n, 2), mm.

    From the pose's own edges alone: the point's and the calibration's uncertainty move all alike.
    """
    point = measurement.rcm.minimax.point_mm
    misses = nearest_points_mm(measurement) - point
    lines = [pose.centerline for pose in measurement.used]
    return np.array(
        [
            miss_interval_mm(miss, line.position_covariance_mm2(point))
            for miss, line in zip(misses, lines, strict=True)
        ]
    ).reshape(-1, 2)


def rejected_table(measurement: Measurement) -> Table:
    """Tabulate the rejected poses with their reasons and next steps."""
    return Table(
        "Poses that do not count",
        ("pose", "reason", "next step"),
        tuple((pose.pose, pose.reason, pose.next_step) for pose in measurement.rejected),
    )


def pose_facts(pose: UsedPose, measurement: Measurement) -> tuple[tuple[str, str], ...]:
    """Return the figures of one pose that belong to no camera."""
    rcm = measurement.rcm
    decimals = error_decimals([rcm.minimax.rms_mm, rcm.least_squares.rms_mm])
    return (
        ("minimax", f"{fixed(pose.distance_mm.minimax, decimals)} mm"),
        ("least squares", f"{fixed(pose.distance_mm.least_squares, decimals)} mm"),
        ("dihedral angle", f"{pose.dihedral_deg:.1f}°"),
        *_cylinder_facts(pose),
    )


def _cylinder_facts(pose: UsedPose) -> tuple[tuple[str, str], ...]:
    found = pose.cylinder
    if found is None:
        return ()
    return (
        ("edges and cylinder, χ² / limit", f"{found.chi_square:.1f} / {found.limit:.0f}"),
        ("cylinder’s axis off by", f"{found.apart_mm:.4f} mm"),
    )


def edge_table(pose: UsedPose | RejectedPose) -> Table:
    """Tabulate what each camera's edges of one pose measured."""
    diameters: tuple[str, ...] = ("–",) * len(pose.edges)
    if isinstance(pose, UsedPose):
        diameters = tuple(f"{value:.3f}" for value in pose.diameters_mm)
    rows = [
        (
            edges.camera,
            diameter,
            " / ".join(f"{sigma:.3f}" for sigma in edges.sigma_px),
            " / ".join(f"{grey:.0f}" for grey in edges.contrast),
            f"{edges.blur_px:.2f}",
            f"{edges.residual_px:.3f}",
            " / ".join(f"{100 * part:.0f}" for part in edges.used_part),
        )
        for edges, diameter in zip(pose.edges, diameters, strict=True)
    ]
    return Table(
        f"Edges of pose {pose.pose}",
        (
            "camera",
            "diameter, mm",
            "edge u, px",
            "contrast, grey",
            "blur, px",
            "residual, px",
            "used, %",
        ),
        tuple(rows),
    )


def input_table(inputs: Mapping[str, str]) -> Table:
    """Tabulate the SHA-256 of every input."""
    return Table("SHA-256 of every file used", ("file", "SHA-256"), tuple(sorted(inputs.items())))


def truth_table(measurement: Measurement, truth: SimulatedTruth) -> Table:
    """Tabulate the answer beside the simulated truth."""
    rcm = measurement.rcm
    decimals = error_decimals([truth.rms_mm, rcm.least_squares.rms_mm])
    pairs: Sequence[tuple[str, float, float]] = (
        *(
            (f"{axis}, mm", float(rcm.least_squares.point_mm[i]), float(truth.point_mm[i]))
            for i, axis in enumerate("xyz")
        ),
        ("largest miss (max), mm", rcm.minimax.max_mm, truth.max_mm),
        ("rms miss, mm", rcm.least_squares.rms_mm, truth.rms_mm),
    )
    return Table(
        "Simulated session: the answer beside the truth",
        ("quantity", "measured", "truth", "difference"),
        tuple(
            (name, fixed(ours, decimals), fixed(true, decimals), fixed(ours - true, decimals))
            for name, ours, true in pairs
        ),
    )


def _freedom(degrees: float) -> str:
    if not np.isfinite(degrees):
        return "no limit to its degrees of freedom"
    return f"{degrees:.0f} degrees of freedom"
