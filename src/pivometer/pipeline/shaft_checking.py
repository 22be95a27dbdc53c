"""Whether the edges of all poses and cameras belong to one straight cylinder of one radius."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pivometer.calibration import Calibration
from pivometer.errors import CalibrationError, DegenerateGeometryError
from pivometer.geometry import nearest_points_on_lines
from pivometer.measurement import (
    ImportedRig,
    Measurement,
    PoseCylinder,
    RejectedPose,
    ShaftAgreement,
    UsedPose,
)
from pivometer.pipeline.responding import moved_outward_px
from pivometer.rcm import Finding
from pivometer.shaft.edges import ShaftEdges
from pivometer.shaft.fitting.mosaic_edges import ADVICE, WARNING
from pivometer.shaft.triangulation import Centerline
from pivometer.uncertainty.shaft_bend import shaft_bend
from pivometer.uncertainty.shaft_check import LEAST_POSES, ShaftCheck, check_shaft

Route = Literal["paper", "cylinder"]
"""Where a centerline comes from: eqs. (14)–(16), or the maximum-likelihood cylinder."""

MOST_REJECTED = 0.1
"""More inconsistent poses than this part of a session are no mistakes of single poses."""

NOTABLE_SCATTER = 2.0
"""Edges that scatter twice as much as stated make what is computed from their noise too small."""

LARGEST_SCATTER = 10.0
"""From ten times as much on, they are not those of one cylinder seen from where the calibration has
the cameras. In sessions as they should be it is 1; in one with mirrored pictures of one camera it
was 33, and 18 of 24 poses passed for a shaft all the same, 30 mm from where it was."""


@dataclass(frozen=True, slots=True, eq=False)
class Triangulated:
    """A pose whose centerline is known, before the RCM is."""

    pose: str
    centerline: Centerline
    edges: tuple[ShaftEdges, ...]


Poses = list[Triangulated | RejectedPose]


def checked_poses(
    poses: Poses, calibration: Calibration | ImportedRig, route: Route
) -> tuple[Poses, ShaftCheck | None]:
    """Reject single poses whose edges do not belong to one cylinder, and judge the rest.

    Nothing is judged from fewer than five poses, or from edges without an uncertainty.

    Raises
    ------
    CalibrationError
        If the edges that the cameras see have nothing to do with one another.
    """
    check = _check(poses, calibration)
    if check is None:
        return poses, None
    wrong = check.chi_squares > check.limits
    if 0 < wrong.sum() <= max(1.0, MOST_REJECTED * len(wrong)):
        poses = _without(poses, check)
        check = _check(poses, calibration)
    if check is not None and check.scatter > LARGEST_SCATTER:
        raise CalibrationError(
            "the edges that the cameras see are not those of one cylinder: they miss it "
            f"{check.scatter:.0f} times as far as their stated uncertainty, {LARGEST_SCATTER:g} "
            "times is the most",
            next_step="look at the overlays and at one pose in all cameras: is it the same shaft "
            "at the same moment, neither mirrored nor turned, and do the cameras stand and look as "
            "in the board images?",
        )
    if check is not None and route == "cylinder":
        poses = _from_cylinders(poses, check)
    return poses, check


def _check(poses: Poses, calibration: Calibration | ImportedRig) -> ShaftCheck | None:
    edges = [pose.edges for pose in poses if isinstance(pose, Triangulated)]
    if not _judgeable(edges):
        return None
    covariance = None if isinstance(calibration, ImportedRig) else calibration.covariance
    try:
        outward_px = moved_outward_px(calibration, edges)
        return check_shaft(edges, calibration.rig, covariance, outward_px=outward_px)
    except DegenerateGeometryError:
        return None  # the poses' own centerlines stand; `with_shaft` says that nothing was judged


def _judgeable(edges: Sequence[Sequence[ShaftEdges]]) -> bool:
    stated = all(one.normals_covariance.any() for pose in edges for one in pose)
    return len(edges) >= LEAST_POSES and stated


def _without(poses: Poses, check: ShaftCheck) -> Poses:
    judged = zip(check.chi_squares.tolist(), check.limits.tolist(), strict=True)
    kept: Poses = []
    for pose in poses:
        if isinstance(pose, Triangulated):
            found, limit = next(judged)
            if found > limit:
                pose = RejectedPose(
                    pose.pose,
                    "the edges that the cameras see do not belong to one cylinder of the session's "
                    f"diameter (χ² {found:.0f}, by chance under {limit:.0f})",
                    "look at the overlays: an edge in one of the pictures is not the shaft's",
                    pose.edges,
                )
        kept.append(pose)
    return kept


def _from_cylinders(poses: Poses, check: ShaftCheck) -> Poses:
    numbers = iter(range(len(check.chi_squares)))
    return [
        replace(
            pose,
            centerline=check.fits.centerline(
                next(numbers), pose.centerline.dihedral_rad, pose.centerline.diameters_mm
            ),
        )
        if isinstance(pose, Triangulated)
        else pose
        for pose in poses
    ]


_UNFIT = Finding(
    "warning",
    "whether edges and cameras belong together could not be judged: no cylinders of one diameter "
    "fit the edges",
    "look at the overlays: what was found is not a shaft, or not the same one in all cameras",
)


def with_shaft(measurement: Measurement, check: ShaftCheck | None, route: Route) -> Measurement:
    """Add what the cylinders say of each pose, of the session and of the shaft."""
    measurement = replace(
        measurement, findings=(*measurement.findings, *_mosaic_findings(measurement.used))
    )
    if check is None:
        unfit = _judgeable([pose.edges for pose in measurement.used])
        told = (_UNFIT,) if unfit else ()
        return replace(measurement, findings=measurement.findings + told)
    numbers = iter(range(len(check.chi_squares)))
    at = measurement.rcm.least_squares.point_mm
    poses = tuple(
        replace(pose, cylinder=_cylinder(pose, check, next(numbers), at))
        if isinstance(pose, UsedPose)
        else pose
        for pose in measurement.poses
    )
    names = [pose.pose for pose in measurement.used]
    bend = shaft_bend([pose.edges for pose in measurement.used], measurement.calibration.rig, check)
    agreement = ShaftAgreement(
        route=route,
        diameter=check.diameter,
        scatter=check.scatter,
        moved=check.moved,
        change=check.change,
        change_from=names[check.change.pose],
        bend=bend,
    )
    measurement = replace(measurement, poses=poses, shaft=agreement)
    return replace(measurement, findings=measurement.findings + shaft_findings(measurement))


def _cylinder(pose: UsedPose, check: ShaftCheck, number: int, at_mm: object) -> PoseCylinder:
    point, direction = check.fits.points_mm[number], check.fits.directions[number]
    ends = nearest_points_on_lines(
        np.asarray(at_mm),
        np.stack([point, pose.centerline.point_mm]),
        np.stack([direction, pose.centerline.direction]),
    )
    return PoseCylinder(
        point_mm=point,
        direction=direction,
        apart_mm=float(np.linalg.norm(ends[0] - ends[1])),
        chi_square=float(check.chi_squares[number]),
        limit=float(check.limits[number]),
    )


def shaft_findings(measurement: Measurement) -> tuple[Finding, ...]:
    """Say what does not fit together, and what to do about it."""
    shaft = measurement.shaft
    if shaft is None:
        return ()
    found = [_moved_finding(shaft), _poses_finding(measurement.used), _scatter_finding(shaft)]
    if shaft.bend is not None and shaft.bend.significant:
        found.append(
            Finding(
                "warning",
                f"the shaft is bent, or the lenses are not as calibrated: over "
                f"{shaft.bend.length_mm:.0f} mm it bows by {shaft.bend.sagitta_mm:.3f} mm, to the "
                f"same side in all poses (F {shaft.bend.f_ratio:.0f}, by chance under "
                f"{shaft.bend.limit:.0f})",
                "roll the shaft on a flat table; with a straight one, take more board images in "
                "the corners of the pictures",
            )
        )
    return tuple(finding for finding in found if finding is not None)


def _moved_finding(shaft: ShaftAgreement) -> Finding | None:
    if shaft.change.significant:
        who = f"camera {shaft.change.camera}" if shaft.change.camera else "a camera"
        return Finding(
            "warning",
            f"{who} moved during the session, near pose {shaft.change_from}: from there on the "
            "edges that the cameras see belong to one cylinder only with a camera elsewhere "
            f"(χ² {shaft.change.chi_square:.0f}, by chance under {shaft.change.limit:.0f})",
            "fix the cameras better and repeat the session; the stated uncertainty does not hold "
            "this",
        )
    if shaft.moved.significant:
        return Finding(
            "warning",
            "the cameras do not stand, or their lenses are not, as the calibration says: the edges "
            "of all poses belong to one cylinder only with cameras elsewhere "
            f"(χ² {shaft.moved.chi_square:.0f}, by chance under {shaft.moved.limit:.0f})",
            "calibrate anew, with the cameras as they stood for the shaft images; if these are "
            "compressed with loss, take them without, since that shifts edges, too",
        )
    return None


def _mosaic_findings(used: Sequence[UsedPose]) -> list[Finding]:
    edges = [one for pose in used for one in pose.edges]
    cameras = dict.fromkeys(one.camera for one in edges if WARNING in "".join(one.warnings))
    return [Finding("warning", f"camera {name}: {WARNING}", ADVICE) for name in cameras]


def _poses_finding(used: Sequence[UsedPose]) -> Finding | None:
    wrong = [
        pose.pose
        for pose in used
        if pose.cylinder is not None and pose.cylinder.chi_square > pose.cylinder.limit
    ]
    if not wrong:
        return None
    more = f" and {len(wrong) - 5} more" if len(wrong) > 5 else ""
    return Finding(
        "warning",
        f"in {len(wrong)} of {len(used)} poses the edges that the cameras see do not belong to one "
        f"cylinder of the session's diameter ({', '.join(wrong[:5])}{more})",
        "look at the overlays of these poses; if the edges are right, a camera moved or the "
        "cameras' pictures are not of the same moment",
    )


def _scatter_finding(shaft: ShaftAgreement) -> Finding | None:
    if shaft.scatter < NOTABLE_SCATTER:
        return None
    return Finding(
        "warning",
        f"the edges miss the cylinders {shaft.scatter:.1f} times as far as their stated "
        "uncertainty: shading or clutter moves them, from pose to pose",
        "light the shaft evenly before a plain background; what is computed from the noise of the "
        "edges is too small here",
    )
