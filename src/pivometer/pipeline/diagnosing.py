"""Mistakes that no single picture shows: swapped cameras, a wrong scale, a moved camera."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration import BoardView, Calibration
from pivometer.calibration.drift import Drift, drift
from pivometer.cameras import Rig
from pivometer.errors import CalibrationError, DataError, DegenerateGeometryError
from pivometer.io.exclusions import FILE_NAME as EXCLUSIONS
from pivometer.io.session import Session
from pivometer.measurement import ImportedRig, Measurement
from pivometer.pipeline.calibrating import corners
from pivometer.pipeline.reading import Progress, hashes, in_threads, read
from pivometer.pipeline.responding import LINEAR_ADVICE, bent_cameras, response_findings
from pivometer.rcm import Finding
from pivometer.shaft.edges import ShaftEdges
from pivometer.shaft.gate import NOMINAL_TOLERANCE, SPREAD_TOLERANCE
from pivometer.shaft.stillness import CameraMovement
from pivometer.shaft.triangulation import WARN_DIHEDRAL_RAD, triangulate_centerline
from pivometer.uncertainty.carried_edges import SeenAlike, rcm_of_points, thinned_points

BETTER = 5.0
"""How many times better centerlines must meet in another order of cameras or files to say that the
order is wrong; chosen, not measured: a wrong order is off by millimetres, the right one by what the
robot and the instrument are."""
LAGS = (1, -1, 2, -2)
CALIPER_U_MM, STATED_U_PART = 0.02, 0.003
"""Standard uncertainty of a stated diameter: what a caliper with a resolution of 0.05 mm reads, or
0.3 % of a shaft so thin that nobody measures it so coarsely."""

Seen = Mapping[str, Mapping[str, ShaftEdges | DataError]]


# --- The order of cameras and files ---


def refuse_wrong_order(seen: Seen, rig: Rig) -> None:
    """Refuse shaft images that fit the calibration in another order of cameras or of poses.

    Raises
    ------
    CalibrationError
        If the images of two cameras are exchanged, or a camera's files are one or two poses off.
    """
    names = [camera.name for camera in rig.cameras]
    complete = [
        pose
        for pose in seen[names[0]]
        if all(isinstance(seen[name].get(pose), ShaftEdges) for name in names)
    ]
    if len(complete) < 5:
        return
    edges = [[_edges(seen, name, pose) for name in names] for pose in complete]
    (group,) = thinned_points(edges, names)
    right = _rms_mm(group, rig)
    for order in list(permutations(range(len(names))))[1:]:
        exchanged = replace(group, points_px=tuple(group.points_px[k] for k in order))
        if _rms_mm(exchanged, rig) * BETTER < right:
            pairs = [(names[b], names[a]) for a, b in enumerate(order) if a != b]
            shown = ", ".join(f"shaft/{a} was taken by camera {b}" for a, b in pairs)
            raise CalibrationError(
                f"the shaft images fit the board images only with the cameras exchanged: {shown}",
                next_step="exchange the folders under shaft/, or those under board/, intrinsics/",
            )
    _refuse_late(complete, edges, rig)


def _refuse_late(poses: Sequence[str], edges: Sequence[Sequence[ShaftEdges]], rig: Rig) -> None:
    """Refuse files that are late: the planes still meet at the RCM, but the diameters scatter."""
    right = _diameter_scatter(edges, rig)
    if right < SPREAD_TOLERANCE:
        return
    names = [camera.name for camera in rig.cameras]
    for camera, lag in ((c, lag) for c in range(1, len(names)) for lag in LAGS):
        start, count = max(0, -lag), len(edges) - abs(lag)
        shifted = [
            [edges[i + lag * (k == camera)][k] for k in range(len(names))]
            for i in range(start, start + count)
        ]
        if count >= 5 and _diameter_scatter(shifted, rig) * BETTER < right:
            raise CalibrationError(
                f"the shaft images of camera {names[camera]} are {abs(lag)} "
                f"{'pose' if abs(lag) == 1 else 'poses'} off: what camera {names[0]} shows in "
                f"{poses[start]} is in {poses[start + lag]} of camera {names[camera]}",
                next_step=f"rename the files under shaft/{names[camera]}: the same name must mean "
                "the same moment",
            )


def _diameter_scatter(edges: Sequence[Sequence[ShaftEdges]], rig: Rig) -> float:
    """Return the relative scatter of the diameters that all cameras measure in all poses."""
    measured: list[float] = []
    for pose in edges:
        try:
            line = triangulate_centerline(
                np.stack([found.normals for found in pose]), rig.reference_from_camera
            )
        except DegenerateGeometryError:
            continue
        measured += list(line.diameters_mm)
    median = float(np.median(measured)) if measured else 1.0
    return float(np.sqrt(np.mean((np.array(measured) / median - 1) ** 2))) if measured else np.inf


def _edges(seen: Seen, name: str, pose: str) -> ShaftEdges:
    found = seen[name][pose]
    if isinstance(found, ShaftEdges):
        return found
    raise found


def _rms_mm(group: SeenAlike, rig: Rig) -> float:
    try:
        return rcm_of_points([group], rig).rms_mm
    except DataError:
        return float("inf")


# --- The scale ---


def refuse_other_scale(
    diameters_mm: Sequence[Sequence[float] | Floats],
    nominal_mm: float | None,
    square_mm: float,
    bent: Collection[str] = (),
) -> None:
    """Refuse a session in which the shaft measures the same everywhere, but not what is stated.

    Raises
    ------
    CalibrationError
        If its diameter is off by more than any scale could be; the message says which square size
        would explain it, or that cameras which are not linear leave that open.
    """
    if nominal_mm is None or len(diameters_mm) < 5:
        return
    every = np.concatenate([np.asarray(row, dtype=np.float64) for row in diameters_mm])
    median = float(np.median(every))
    spread = 1.4826 * float(np.median(np.abs(every - median)))
    off = median / nominal_mm - 1
    if abs(off) > NOMINAL_TOLERANCE and spread < 0.03 * median:
        seen = (
            f"the shaft measures {median:.2f} mm in every pose (scatter {spread:.2f} mm), but "
            f"session.toml states {nominal_mm:g} mm"
        )
        if bent:
            raise CalibrationError(f"{seen}; {_no_scale(bent)}", next_step=LINEAR_ADVICE)
        raise CalibrationError(
            f"{seen}: square_mm would have to be {square_mm * nominal_mm / median:.3f} instead of "
            f"{square_mm:g}",
            next_step="measure a square of the board and the shaft with a caliper, and correct "
            "board.square_mm or shaft.diameter_mm",
        )


def _no_scale(bent: Iterable[str]) -> str:
    return (
        "that says nothing of the scale, since not all cameras record light linearly "
        f"({', '.join(bent)}), which changes widths, not lengths"
    )


def scale_finding(measurement: Measurement) -> Finding | None:
    """Compare the shaft's measured diameter with the stated one: an independent check of scale.

    Nothing else in a session tells the shaft from another rod that moves with it.
    """
    nominal, board = measurement.setup.diameter_mm, measurement.setup.board
    every = np.array([d for pose in measurement.used for d in pose.diameters_mm])
    if nominal is None:
        return Finding(
            "warning",
            f"what was measured is {np.median(every):.2f} mm thick, and the session does not state "
            "the shaft's diameter: neither that it is the shaft nor the scale has been checked",
            "measure the shaft with a caliper and write [shaft] diameter_mm into session.toml",
        )
    value = float(np.median(every))
    u = SPREAD_TOLERANCE / 3 * value  # of too few poses to judge
    if measurement.shaft is not None:
        value, u = measurement.shaft.diameter.value_mm, measurement.shaft.diameter.u_mm
    off = value / nominal - 1
    if abs(value - nominal) < 3 * np.hypot(u, min(CALIPER_U_MM, STATED_U_PART * nominal)):
        return None
    seen = (
        f"the shaft measures {value:.3f} ± {2 * u:.3f} mm (all edges of {len(measurement.used)} "
        f"poses, k = 2), {100 * off:+.1f} % from the stated {nominal:g} mm"
    )
    if bent := bent_cameras(measurement.calibration):
        return Finding("warning", f"{seen}; {_no_scale(bent)}", LINEAR_ADVICE)
    return Finding(
        "warning",
        f"{seen}; if that is the scale, all lengths are "
        f"off by as much, and square_mm would have to be {board.square_mm / (1 + off):.3f} instead "
        f"of {board.square_mm:g}",
        "measure a square of the board over its whole width, and the shaft's diameter, with a "
        "caliper; if both are as stated, look at the overlays: something else was measured",
    )


# --- The sight ---


def flat_poses_finding(measurement: Measurement) -> Finding | None:
    """Name the poses whose centerline planes are so nearly one plane that errors multiply."""
    limit = float(np.degrees(WARN_DIHEDRAL_RAD))
    flat = [pose.pose for pose in measurement.used if pose.dihedral_deg < limit]
    if not flat:
        return None
    more = f" and {len(flat) - 5} more" if len(flat) > 5 else ""
    return Finding(
        "warning",
        f"in {len(flat)} of {len(measurement.used)} poses the centerline planes of the cameras are "
        f"under {limit:.0f}° apart, which triples errors and more ({', '.join(flat[:5])}{more})",
        "leave out poses in which the shaft lies in a plane with both cameras, or move a camera",
    )


# --- Movement ---


def with_checks(
    measurement: Measurement, session: Session, progress: Progress | None = None
) -> Measurement:
    """Add what responses, diameter, sight, scenery and closing views say about the answer."""
    checked = (
        *response_findings(measurement),
        scale_finding(measurement),
        flat_poses_finding(measurement),
        *movement_findings(measurement),
    )
    told = tuple(finding for finding in checked if finding is not None)
    measurement = replace(measurement, findings=measurement.findings + told)
    files = list(session.fixed_board_images("closing"))
    if not files:
        return measurement
    calibration = measurement.calibration
    reads = in_threads(read, files, "reading closing boards", progress)
    sizes = {camera.name: (camera.width, camera.height) for camera in calibration.rig.cameras}
    found = [corners(one, session, sizes[one.file.camera]) for one in reads]
    views = [view for view in found if isinstance(view, BoardView)]
    finding = drift_finding(views, measurement)
    return replace(
        measurement,
        findings=measurement.findings if finding is None else (*measurement.findings, finding),
        inputs={**measurement.inputs, **hashes(reads)},
    )


def movement_findings(measurement: Measurement) -> list[Finding]:
    """Say which cameras moved while pictures were taken, and what that means at the RCM."""
    return [
        Finding(
            "warning",
            f"camera {moved.camera} moved, or its lens was touched, between {moved.before} and "
            f"{moved.after}: all that stands still in its pictures is shifted by "
            f"{moved.shift_px:.2f} px (by chance under {moved.limit_px:.2f}), which is "
            f"{_at_rcm_mm(moved, measurement):.3f} mm at the RCM. The stated uncertainty does not "
            "hold this",
            f"fix the camera better and repeat the session{_without_later(moved)}",
        )
        for moved in measurement.camera_movements
        if moved.significant
    ]


def _without_later(moved: CameraMovement) -> str:
    """Say what else helps where all pictures of the board were taken before the camera moved."""
    if not moved.before.startswith("shaft/"):
        return ""
    return f", or take out all poses from {moved.after} on ({EXCLUSIONS})"


def _at_rcm_mm(moved: CameraMovement, measurement: Measurement) -> float:
    rig = measurement.calibration.rig
    number = rig.index(moved.camera)
    camera_from_reference = rig.reference_from_camera[number].inverse()
    depth_mm = (camera_from_reference @ measurement.rcm.least_squares.point_mm)[2]
    return moved.shift_px * float(depth_mm / rig.cameras[number].focal_px.mean())


def drift_finding(views: Sequence[BoardView], measurement: Measurement) -> Finding | None:
    """Say whether a camera moved before the closing views, and what that means at the RCM."""
    calibration = measurement.calibration
    if isinstance(calibration, ImportedRig):
        return Finding(
            "warning",
            "whether a camera moved before the closing images cannot be judged: nothing says how "
            "good the imported rig was",
            "calibrate from board images of this session",
        )
    names = ", ".join(dict.fromkeys(view.view for view in views))
    seen = _drift(views, calibration, measurement.rcm.least_squares.point_mm)
    if seen is None:
        return Finding(
            "warning",
            "the closing images show no board to two cameras at once, so that a camera moved "
            f"during the session cannot be ruled out ({names or 'no board found'})",
            "take closing images of the whole board with all cameras at the same moment",
        )
    if not seen.significant:
        return None
    who = " or ".join(f"camera {name}" for name in seen.cameras)
    tell = "" if len(seen.cameras) == 1 else "; two cameras cannot tell which of them"
    return Finding(
        "warning",
        f"{who} moved between the calibration and the closing images ({', '.join(seen.views)}): "
        f"turned by {np.degrees(seen.angle_rad):.3f}°, which shifts what it sees at the RCM by "
        f"{seen.shift_mm:.3f} mm (χ² {seen.chi_square:.0f}, by chance under {seen.limit:.0f})"
        f"{tell}. The stated uncertainty does not hold this",
        "fix the cameras better and repeat the session; if the movement came after the last shaft "
        "image, the result stands",
    )


def _drift(views: Sequence[BoardView], calibration: Calibration, at_mm: Floats) -> Drift | None:
    return drift(
        views,
        calibration.board,
        calibration.rig,
        calibration.covariance,
        at_mm=at_mm,
        noise_px=calibration.noise_px,
        earlier=calibration.views,
    )
