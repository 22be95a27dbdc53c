"""The paper's line, (14)–(16), beside the axis of a cylinder that touches all edges.

Run with ``python -m benchmarks.centerline [RENDERED]``: root-mean-square distance at the RCM
between found and true line. Edges of a 10 mm shaft, ideal but for noise, are seen 20 to 110 mm from
the RCM by cameras of 1000 px focal length 480 mm away. A folder of sessions of which the truth is
known adds a row each, measured from their images with their true cameras.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

import pivometer
from pivometer._arrays import Floats
from pivometer.cameras import Camera, Rig
from pivometer.geometry import RigidTransform
from pivometer.measurement import ImportedRig
from pivometer.shaft.cylinder_fit import fit_cylinders
from pivometer.shaft.silhouette import edge_normals
from pivometer.shaft.triangulation import lines_from_edge_normals
from pivometer.simulation.robots import cone_directions
from pivometer.uncertainty.foresight import Shaft, foreseen_edges

POSES, SESSIONS = 20, 20
SHAFT = Shaft(10.0, (20.0, 110.0))
ROW_PX = 0.15
"""Noise of one row's edge: an edge of 200 rows is then known to 0.01 px at its middle."""
RCM_MM = np.array([0.0, 65.0, 480.0])
MIDDLE_PX = np.array([640.0, 512.0])
LEAN_RAD = 0.25
"""Half the angle of the cone that the poses fill."""
Radius = float | Literal["common"]


@dataclass(frozen=True)
class Case:
    """What a row of the table is about.

    Parameters
    ----------
    name
        As printed.
    worse
        By how much the noise of one edge of each image exceeds that of the other.
    outward_px
        By how much both edges are seen too far out.
    cameras
        Their number.
    dihedral_deg
        Angle between the planes through the cameras and each centerline; a cone of poses if none.
    """

    name: str
    worse: float = 1.0
    outward_px: float = 0.0
    cameras: int = 2
    dihedral_deg: float | None = None


CASES = (
    Case("equally good"),
    Case("one edge 2 times worse", worse=2),
    Case("one edge 5 times worse", worse=5),
    Case("2 times, both .1 px outward", worse=2, outward_px=0.1),
    Case("5 times, both .1 px outward", worse=5, outward_px=0.1),
    Case("three cameras", cameras=3),
    Case("three cameras, one edge 4 times", worse=4, cameras=3),
    *(Case(f"planes {angle:g}° apart", dihedral_deg=angle) for angle in (20, 10, 5, 2, 0.5)),
)


def rig(cameras: int) -> Rig:
    """Return cameras 66° apart on a level circle about what they look at."""
    middle = np.array([0.0, 0.0, 480.0])
    names, poses = [], []
    for number in range(cameras):
        turn = RigidTransform.from_rotation_vector([0, -np.radians(66) * number, 0], np.zeros(3))
        poses.append(RigidTransform(turn.rotation, middle - turn.rotation @ middle))
        names.append(
            Camera(f"camera{number}", 1280, 1024, np.full(2, 1000.0), MIDDLE_PX, np.zeros(2))
        )
    return Rig(names, poses)


def directions(case: Case, cameras: Rig) -> Floats:
    """Return the poses' directions: a cone, or as near to the cameras' plane as asked for."""
    if case.dihedral_deg is None:
        x, y, z = cone_directions(POSES, np.degrees(2 * LEAN_RAD)).T
        return np.column_stack([x, -z, y])
    first, second = (RCM_MM - pose.translation_mm for pose in cameras.reference_from_camera)
    level = np.cross(first, second)  # perpendicular to the plane of the RCM and both cameras
    across = np.cross(level, first + second)
    found = []
    for side in np.linspace(-0.3, 0.3, POSES):
        flat = across / np.linalg.norm(across) + side * (first + second) / 960
        angles = np.linspace(0, np.pi / 2, 4000)[:, None]
        tried = np.cos(angles) * flat / np.linalg.norm(flat)
        tried = tried + np.sin(angles) * level / np.linalg.norm(level)
        one, other = (np.cross(tried, ray) for ray in (first, second))
        cosine = np.abs(np.vecdot(one, other)) / np.linalg.norm(one, axis=1)
        cosine = np.clip(cosine / np.linalg.norm(other, axis=1), 0, 1)
        apart = np.degrees(np.arccos(cosine))
        found.append(tried[int(np.abs(apart - case.dihedral_deg).argmin())])
    return np.array(found)


def seen(case: Case, cameras: Rig, axes: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return the edges' normals (n, c, 2, 3) and their covariances (n, c, 6, 6)."""
    normals = np.empty((len(axes), case.cameras, 2, 3))
    covariances = np.empty((len(axes), case.cameras, 6, 6))
    factors = np.repeat([1.0, case.worse], 3)
    for pose, axis in enumerate(axes):
        for place, camera in enumerate(cameras.cameras):
            to = cameras.reference_from_camera[place].inverse()
            ideal = foreseen_edges(camera, to, RCM_MM, axis, SHAFT, edge_px=ROW_PX)
            points = np.array(ideal.points_px)
            ways = points[:, -1] - points[:, 0]
            lengths = np.linalg.norm(ways, axis=1)
            offsets = ROW_PX * rng.standard_normal((2, 2)) * np.sqrt([1.0, 3.0])
            offsets *= np.array([1.0, case.worse])[:, None] / np.sqrt(lengths)[:, None]
            across = np.stack([-ways[:, 1], ways[:, 0]], axis=1) / lengths[:, None]
            outward = np.vecdot(across, points.mean(axis=1) - points.mean(axis=(0, 1)))
            offsets[:, 0] += case.outward_px * np.sign(outward)
            places = np.linspace(-1, 1, points.shape[1])
            moves = offsets[:, :1] + offsets[:, 1:] * places
            normals[pose, place] = edge_normals(points + moves[..., None] * across[:, None], camera)
            covariances[pose, place] = factors[:, None] * ideal.normals_covariance * factors
    return normals, covariances


def rms_mm(points: Floats, axes: Floats, true_axes: Floats, rcm: Floats) -> float:
    """Return how far lines pass from the RCM, through which all true lines pass, across these."""
    steps = np.vecdot(rcm - points, true_axes) / np.vecdot(axes, true_axes)
    off = points + steps[:, None] * axes - rcm
    return float(np.sqrt(np.vecdot(off, off).mean()))


def simulated(case: Case) -> list[float]:
    """Return the rms errors of the paper's lines and of axes with the radius known and common."""
    cameras = rig(case.cameras)
    axes = directions(case, cameras)
    squares = np.zeros(3)
    for seed in range(SESSIONS):
        normals, covariances = seen(case, cameras, axes, np.random.default_rng(seed))
        transforms = cameras.reference_from_camera
        lines = [lines_from_edge_normals(normals, transforms)[:2]]
        radii: Sequence[Radius] = (SHAFT.diameter_mm / 2, "common")
        for radius in radii:
            fits = fit_cylinders(normals, covariances, transforms, radius_mm=radius)
            lines.append((fits.points_mm, fits.directions))
        squares += [rms_mm(*line, axes, RCM_MM) ** 2 for line in lines]
    return list(np.sqrt(squares / SESSIONS))


def true_rig(truth: dict[str, Any]) -> Rig:
    """Return the cameras of a session of which the truth is known."""
    cameras = [
        Camera(
            name,
            c["width"],
            c["height"],
            np.array([c["K"][0][0], c["K"][1][1]]),
            np.array([c["K"][0][2], c["K"][1][2]]),
            np.array(c["dist_k1k2p1p2k3"][:2]),
        )
        for name, c in truth["cameras"].items()
    ]
    pose = truth["stereo"]["x_right_eq_R_x_left_plus_t"]
    right_from_left = RigidTransform(pose["R"], pose["t_mm"])
    return Rig(cameras, [RigidTransform.identity(), right_from_left.inverse()])


def rendered(folder: Path) -> list[float]:
    """Return the rms errors of the paper's lines and of axes with a common radius."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    cameras = ImportedRig(true_rig(truth), "opencv", {})
    poses = {pose["pose"]: pose for pose in truth["poses"]}
    errors = []
    for kind in ("paper", "cylinder"):
        found = pivometer.measure(pivometer.load(folder), rig=cameras, centerline=kind)
        lines = [pose.centerline for pose in found.used]
        true = [poses[pose.pose] for pose in found.used]
        squares = [
            rms_mm(
                line.point_mm[None],
                line.direction[None],
                np.array([one["direction"]]),
                np.array(one["point_left_mm"]),
            )
            ** 2
            for line, one in zip(lines, true, strict=True)
        ]
        errors.append(float(np.sqrt(np.mean(squares))))
    return errors


def main(folder: Path | None = None) -> None:
    """Print the table."""
    print("error of the line at the RCM, rms mm")
    print(f"{'edges':34}{'(14)–(16)':>11}{'radius known':>14}{'common':>9}")
    for case in CASES:
        print(f"{case.name:34}{'{:11.4f}{:14.4f}{:9.4f}'.format(*simulated(case))}", flush=True)
    for one in sorted(folder.glob("*/truth.json")) if folder else ():
        paper, common = rendered(one.parent)
        print(f"{one.parent.name:34}{paper:11.4f}{'–':>14}{common:9.4f}", flush=True)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
