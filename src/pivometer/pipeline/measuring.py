"""From a session's shaft images to the RCM."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import starmap
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer._version import software
from pivometer.calibration import Calibration
from pivometer.cameras import Rig
from pivometer.cameras.distortion import DistortionModel
from pivometer.errors import (
    DataError,
    DegenerateGeometryError,
    TooFewPosesError,
    UsageError,
)
from pivometer.geometry.line import unit
from pivometer.geometry.rigid import RigidTransform
from pivometer.io.exclusions import FILE_NAME as EXCLUSIONS
from pivometer.io.session import Session
from pivometer.measurement import (
    ImportedRig,
    Measurement,
    Options,
    PoseDistances,
    RejectedPose,
    Setup,
    UsedPose,
)
from pivometer.pipeline.budgeting import with_budget
from pivometer.pipeline.calibrating import Method, calibrate
from pivometer.pipeline.diagnosing import refuse_other_scale, refuse_wrong_order, with_checks
from pivometer.pipeline.drawing import with_monte_carlo
from pivometer.pipeline.framing import with_board_frame
from pivometer.pipeline.gold_standard import with_gold_standard
from pivometer.pipeline.line_errors import line_errors
from pivometer.pipeline.other_points import with_all_points
from pivometer.pipeline.own_error import with_own_error
from pivometer.pipeline.provenance import provenance_now, settings_hashes
from pivometer.pipeline.reading import Progress
from pivometer.pipeline.responding import bent_cameras
from pivometer.pipeline.shaft_checking import Route, Triangulated, checked_poses, with_shaft
from pivometer.pipeline.shafts import SHAFT_ADVICE, moved_camera, session_shafts
from pivometer.pipeline.structuring import with_structure
from pivometer.rcm import geometry_findings, refuse_geometry, solve
from pivometer.rcm.result import Finding
from pivometer.shaft.edges import ShaftEdges
from pivometer.shaft.gate import diameter_faults, uncertain_end
from pivometer.shaft.hint import ShaftHint
from pivometer.shaft.triangulation import (
    WARN_DIHEDRAL_RAD,
    triangulate_centerline,
)
from pivometer.uncertainty import (
    LinesUncertainty,
    LocationUncertainty,
    lines_uncertainty,
    location_uncertainty,
)
from pivometer.uncertainty.floor import InstrumentFloor
from pivometer.uncertainty.sequence import scatter, sequence_findings


def measure(
    session: Session,
    *,
    rig: Calibration | ImportedRig | None = None,
    method: Method = "joint",
    distortion: DistortionModel = "radial2",
    hints: Mapping[str, ShaftHint] | None = None,
    centerline: Route = "paper",
    floor: InstrumentFloor | None = None,
    bearing_rms_mm: float | None = None,
    draws: int = 0,
    progress: Progress | None = None,
) -> Measurement:
    """Measure the RCM of a session.

    Parameters
    ----------
    session
        What `load` returns.
    rig
        A calibration of the session's cameras; made from its board views where none is given. A
        rig of another program has no uncertainty: a finding says so, and that of the location
        holds the scatter of the centerlines only.
    method, distortion
        How to calibrate then: see `calibrate`.
    hints
        By camera, where the shaft is in its images; they come before those of the session.
    centerline
        What a pose's centerline is: ``"paper"``, where the planes midway between the edges meet, or
        ``"cylinder"``, the axis of the cylinder that fits all edges best.
    floor
        What the instrument showed on a gold standard: `Measurement.gold_standard` of that session.
        It counts as noise of the instrument.
    bearing_rms_mm
        Says that this is a gold standard, a joint that turns about one point: what it misses by
        itself, rms, mm. The result then states the instrument's floor.
    draws
        How many draws of a Monte Carlo to make; none for 0.
    progress
        Called as ``progress(stage, done, total)``.

    Returns
    -------
    Measurement
        Both RCM points with their errors and uncertainty in the reference camera's frame, mm, and
        every pose, used or rejected.

    Raises
    ------
    SessionError
        If the session has no shaft images.
    DataError
        If the data cannot support an answer: its subclasses say why.
    UsageError
        If the calibration or the floor is of other cameras.

    References
    ----------
    Wilson et al., eqs. (1)–(16) and (22).
    """
    if floor is not None and bearing_rms_mm is not None:
        raise UsageError(
            "a gold standard shows the instrument's floor; another floor cannot be taken off it",
            next_step="leave out one of the two",
        )
    session.require("shaft")
    _refuse_other_hints(session, hints or {})
    calibration = rig or calibrate(session, method=method, distortion=distortion, progress=progress)
    if isinstance(calibration, ImportedRig):
        calibration = replace(calibration, rig=_seen_from(calibration.rig, session.reference))
    _refuse_other_cameras(session, calibration.rig)
    seen = see_shafts(session, calibration.rig, hints=hints, progress=progress)
    known = {} if rig else dict(calibration.inputs)
    measurement = measure_edges(
        session,
        calibration,
        seen.edges,
        settings_hashes(session) | known | dict(seen.inputs),
        doubts=seen.doubts,
        shifts_px=seen.shifts_px,
        centerline=centerline,
        floor=floor,
        bearing_rms_mm=bearing_rms_mm,
        progress=progress,
    )
    if draws:
        measurement = with_monte_carlo(measurement, draws, progress=progress)
    options = Options(
        method,
        distortion,
        centerline,
        hints or {},
        rig_given=rig is not None,
        draws=draws,
        bearing_rms_mm=bearing_rms_mm,
    )
    return replace(measurement, provenance=provenance_now(options, command="pivometer.measure"))


@dataclass(frozen=True, slots=True, eq=False)
class SeenShafts:
    """What all cameras saw of the shaft.

    Parameters
    ----------
    edges
        By camera and pose, the edges, or why there are none.
    inputs
        SHA-256 of the files behind them.
    doubts
        What makes it uncertain that this is the shaft.
    shifts_px
        By camera and view, how far the scenery is shifted, if the picture tells.
    """

    edges: Mapping[str, Mapping[str, ShaftEdges | DataError]]
    inputs: Mapping[str, str]
    doubts: tuple[Finding, ...]
    shifts_px: Mapping[str, Mapping[str, Floats | None]] = field(default_factory=dict)


def see_shafts(
    session: Session,
    rig: Rig,
    *,
    hints: Mapping[str, ShaftHint] | None = None,
    progress: Progress | None = None,
) -> SeenShafts:
    """Find and fit the shaft's edges in all images; options as in `measure`."""
    edges: dict[str, dict[str, ShaftEdges | DataError]] = {}
    inputs: dict[str, str] = {}
    warned: dict[str, list[str]] = {}
    shifts_px: dict[str, dict[str, Floats | None]] = {}
    found = {**session.hints, **(hints or {})}
    for name, shafts in session_shafts(session, rig, hints=found, progress=progress).items():
        edges[name] = shafts.edges
        if shafts.warning is not None:
            warned.setdefault(shafts.warning, []).append(name)
        shifts_px[name] = shafts.shifts_px
        inputs |= shafts.inputs
    return SeenShafts(edges, inputs, tuple(starmap(_doubt, warned.items())), shifts_px)


def measure_seen(session: Session, calibration: Calibration, seen: SeenShafts) -> Measurement:
    """Measure as `measure` does without options, from edges that it would find.

    So a pose that is taken out, or back, changes the result at once.

    Parameters
    ----------
    session
        The session as it is now.
    calibration
        What `calibrate` makes of it.
    seen
        What `see_shafts` saw in it.
    """
    inputs = settings_hashes(session) | dict(calibration.inputs) | dict(seen.inputs)
    measurement = measure_edges(
        session,
        calibration,
        seen.edges,
        inputs,
        doubts=seen.doubts,
        shifts_px=seen.shifts_px,
    )
    options = Options("joint", "radial2", "paper", {}, rig_given=False)
    return replace(measurement, provenance=provenance_now(options, command="pivometer app"))


def measure_edges(
    session: Session,
    calibration: Calibration | ImportedRig,
    seen: Mapping[str, Mapping[str, ShaftEdges | DataError]],
    inputs: Mapping[str, str],
    *,
    doubts: Sequence[Finding] = (),
    shifts_px: Mapping[str, Mapping[str, Floats | None]] = MappingProxyType({}),
    centerline: Route = "paper",
    floor: InstrumentFloor | None = None,
    bearing_rms_mm: float | None = None,
    progress: Progress | None = None,
) -> Measurement:
    """Measure the RCM from edges that are fitted already.

    Parameters
    ----------
    session
        What the session says of itself; its shaft images are not read.
    calibration
        Of the session's cameras.
    seen
        By camera and pose, the edges, or why there are none.
    inputs
        SHA-256 of the files behind them.
    doubts
        What was found while looking for the shaft.
    shifts_px
        By camera and view, how far the scenery is shifted, if the picture tells.
    centerline, floor, bearing_rms_mm
        As in `measure`.
    progress
        Called as ``progress(stage, done, total)``.

    Raises
    ------
    DataError
        If the data cannot support an answer: its subclasses say why.
    """
    found = _poses(session, calibration.rig, seen, bent_cameras(calibration))
    poses = _without_repeated(session, found, inputs)
    poses, shaft = checked_poses(poses, calibration, centerline)
    measurement = replace(_measurement(session, calibration, poses, inputs), floor=floor)
    measurement = with_shaft(measurement, shaft, centerline)
    errors = line_errors(measurement)
    measurement = with_all_points(measurement, errors)
    measurement = with_own_error(measurement, errors)
    moved = [moved_camera(session, name, shifts) for name, shifts in shifts_px.items()]
    measurement = replace(
        measurement,
        findings=(*measurement.findings, *doubts),
        camera_movements=tuple(m for m in moved if m is not None),
    )
    measurement = with_board_frame(measurement, session, progress)
    measurement = with_structure(measurement, session, errors)
    measurement = with_budget(measurement, errors)
    if bearing_rms_mm is not None:
        measurement = with_gold_standard(measurement, errors, bearing_rms_mm)
    return with_checks(measurement, session, progress)


def _doubt(warning: str, cameras: Sequence[str]) -> Finding:
    """Say why what these cameras found may not be the shaft; together they name themselves."""
    return Finding(
        "warning",
        warning if len(cameras) > 1 else f"camera {cameras[0]}: {warning}",
        "state diameter_mm, which another rod does not have, or say which it is: "
        + " ".join(f"--hint {camera}=X,Y,WIDTH" for camera in cameras),
    )


def _seen_from(rig: Rig, reference: str) -> Rig:
    """Return a rig in the frame of another of its cameras, or as it is if it has none such."""
    names = [camera.name for camera in rig.cameras]
    if reference not in names:
        return rig
    order = sorted(range(len(names)), key=lambda i: names[i] != reference)
    new_from_old = rig.reference_from_camera[order[0]].inverse()
    poses = [new_from_old @ rig.reference_from_camera[i] for i in order[1:]]
    return Rig([rig.cameras[i] for i in order], [RigidTransform.identity(), *poses])


def _refuse_other_hints(session: Session, hints: Mapping[str, ShaftHint]) -> None:
    for stray in (name for name in hints if name not in session.cameras):
        raise UsageError(
            f"the hint is for '{stray}', which is no camera; they are {', '.join(session.cameras)}",
            next_step="name a camera as its folder under shaft/ is named",
        )


def _refuse_other_cameras(session: Session, rig: Rig) -> None:
    names = [camera.name for camera in rig.cameras]
    if set(names) != set(session.cameras) or names[0] != session.reference:
        raise UsageError(
            f"the calibration is of cameras {', '.join(names)}, the first the reference; the "
            f"session has {', '.join(session.cameras)}",
            next_step="calibrate this session, or name its cameras as the calibration does",
            path=session.folder,
        )


def _poses(
    session: Session,
    rig: Rig,
    seen: Mapping[str, Mapping[str, ShaftEdges | DataError]],
    bent: Collection[str],
) -> list[Triangulated | RejectedPose]:
    """Triangulate every pose that at least two cameras saw, and gate the shaft they saw."""
    refuse_wrong_order(seen, rig)
    poses = [
        _excluded(
            _triangulated(pose, rig, {name: outcomes.get(pose) for name, outcomes in seen.items()}),
            session.excluded.get(f"shaft/{pose}"),
        )
        for pose in session.shaft
    ]
    lines = [pose for pose in poses if isinstance(pose, Triangulated)]
    diameters = [line.centerline.diameters_mm for line in lines]
    refuse_other_scale(diameters, session.diameter_mm, session.board.square_mm, bent)
    faults = diameter_faults(diameters, nominal_mm=session.diameter_mm)
    wrong = {
        line.pose: RejectedPose(line.pose, fault, SHAFT_ADVICE, line.edges)
        for line, fault in zip(lines, faults, strict=True)
        if fault is not None
    }
    return [wrong.get(pose.pose, pose) for pose in poses]


def _triangulated(
    pose: str, rig: Rig, seen: Mapping[str, ShaftEdges | DataError | None]
) -> Triangulated | RejectedPose:
    edges = tuple(found for found in seen.values() if isinstance(found, ShaftEdges))
    if len(edges) < 2:
        name, fault = next((n, f) for n, f in seen.items() if not isinstance(f, ShaftEdges))
        if fault is None:
            step = f"add {pose} to the images of camera {name}"
            return RejectedPose(pose, f"camera {name} has no image of this pose", step, edges)
        where = f" ({fault.path.name})" if fault.path else ""
        return RejectedPose(pose, f"camera {name}{where}: {fault.what}", fault.next_step, edges)
    for one in edges:
        if (doubt := uncertain_end(one)) is not None:
            step = "put a background behind the shaft that differs from it in brightness"
            return RejectedPose(pose, f"camera {one.camera}: {doubt}", step, edges)
    try:
        centerline = triangulate_centerline(
            np.stack([found.normals for found in edges]),
            [rig.reference_from_camera[rig.index(found.camera)] for found in edges],
            covariances=np.stack([found.normals_covariance for found in edges]),
        )
    except DegenerateGeometryError as error:
        return RejectedPose(pose, error.what, error.next_step, edges)
    return Triangulated(pose, centerline, edges)


def _excluded(pose: Triangulated | RejectedPose, reason: str | None) -> Triangulated | RejectedPose:
    """Return a pose as it is, or as rejected where a person took it out."""
    if reason is None:
        return pose
    step = f"take it back in {EXCLUSIONS} if it should count"
    return RejectedPose(pose.pose, f"excluded by hand: {reason}", step, pose.edges)


def _without_repeated(
    session: Session,
    poses: Sequence[Triangulated | RejectedPose],
    inputs: Mapping[str, str],
) -> list[Triangulated | RejectedPose]:
    """Reject poses with a picture that is that of an earlier pose, to the last byte.

    Noise makes no two pictures alike: the file was copied, or the camera had stopped.
    """
    first: dict[tuple[str, str], str] = {}
    kept = list(poses)
    for i, pose in enumerate(kept):
        files = session.shaft[pose.pose].values()
        for file in (f for f in files if f.frame is None and f.name in inputs):
            earlier = first.setdefault((file.camera, inputs[file.name]), pose.pose)
            if earlier != pose.pose and isinstance(pose, Triangulated):
                reason = (
                    f"camera {file.camera}: this picture is that of pose {earlier}, to the byte"
                )
                step = "give each picture once; if the camera had stopped, take the pose again"
                kept[i] = RejectedPose(pose.pose, reason, step, pose.edges)
    return kept


def _measurement(
    session: Session,
    calibration: Calibration | ImportedRig,
    poses: Sequence[Triangulated | RejectedPose],
    inputs: Mapping[str, str],
) -> Measurement:
    """Solve for the RCM and gather what the result rests on."""
    lines = [pose for pose in poses if isinstance(pose, Triangulated)]
    _refuse_few(poses, lines)
    points = np.stack([line.centerline.point_mm for line in lines])
    directions = np.stack([line.centerline.direction for line in lines])
    rcm = solve(points, directions)
    findings = geometry_findings(
        points,
        directions,
        rcm,
        camera=calibration.rig.reference,
        allowed=partial(_well_seen, calibration.rig, rcm.least_squares.point_mm),
    )
    refuse_geometry(findings)
    uncertainty: LocationUncertainty | LinesUncertainty
    if isinstance(calibration, ImportedRig):
        uncertainty = lines_uncertainty(scatter(rcm.least_squares, points, directions))
        findings = (*findings, _unknown_calibration(calibration))
    else:
        uncertainty = location_uncertainty(
            [line.edges for line in lines],
            calibration.rig,
            calibration.covariance,
        )
        best = replace(rcm.least_squares, covariance_mm2=uncertainty.total_mm2)
        rcm = replace(rcm, least_squares=best)
    findings += sequence_findings(len(lines), uncertainty.independent_poses)
    rows = iter(zip(lines, rcm.minimax.distances_mm, rcm.least_squares.distances_mm, strict=True))
    return Measurement(
        rcm=rcm,
        uncertainty=uncertainty,
        poses=tuple(
            pose if isinstance(pose, RejectedPose) else _used_pose(*next(rows)) for pose in poses
        ),
        findings=findings,
        calibration=calibration,
        setup=Setup(
            session=session.folder.resolve().name,
            board=session.board,
            diameter_mm=session.diameter_mm,
            device=session.device,
            operator=session.operator,
            notes=session.notes,
        ),
        inputs=inputs,
        software=software(),
    )


def _well_seen(rig: Rig, point_mm: Floats, directions: Floats) -> NDArray[np.bool_]:
    """Tell of shaft directions at a point whether two cameras see planes far enough apart."""
    centres = np.stack([pose.translation_mm for pose in rig.reference_from_camera])
    normals = unit(np.cross(directions[:, None], centres - point_mm))
    cosines = np.abs(np.einsum("nci,ndi->ncd", normals, normals))
    return np.asarray(cosines.min(axis=(1, 2)) < np.cos(WARN_DIHEDRAL_RAD))


def _unknown_calibration(imported: ImportedRig) -> Finding:
    return Finding(
        "warning",
        f"calibration uncertainty unknown: the rig was imported ({imported.file_format}), and what "
        "its calibration adds to the uncertainty of the location and to the misses is not in the "
        "stated figures",
        "calibrate with board images of this session for a complete uncertainty",
    )


def _used_pose(line: Triangulated, minimax: float, least_squares: float) -> UsedPose:
    return UsedPose(
        pose=line.pose,
        centerline=line.centerline,
        distance_mm=PoseDistances(float(minimax), float(least_squares)),
        dihedral_deg=float(np.degrees(line.centerline.dihedral_rad)),
        diameters_mm=tuple(line.centerline.diameters_mm.tolist()),
        edges=line.edges,
    )


def _refuse_few(
    poses: Sequence[Triangulated | RejectedPose], lines: Sequence[Triangulated]
) -> None:
    if len(lines) >= 3:
        return
    rejected = [pose for pose in poses if isinstance(pose, RejectedPose)]
    reasons = Counter(pose.reason for pose in rejected)
    shown = "; ".join(f"{reason} ({n}×)" for reason, n in reasons.most_common(3))
    raise TooFewPosesError(
        f"{len(lines)} of {len(poses)} poses are usable, 3 are the least"
        + (f": {shown}" if shown else ""),
        next_step=rejected[0].next_step if rejected else "add poses under shaft/",
    )
