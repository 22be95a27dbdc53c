"""Robots that should pivot about a point, and how far their errors make them miss it.

Each robot's frame has the design pivot as its origin and z along the middle of its cone, towards
the robot's carriage. Directions run from the pivot out to the carriage.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.errors import UsageError
from pivometer.geometry import RigidTransform
from pivometer.geometry.line import unit


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The true centerlines of a robot's poses, and the joint values it believes in.

    Parameters
    ----------
    joint_names
        Names with their unit, e.g. ``"pitch_rad"``.
    joints
        Joint values, shape (n, k).
    points_mm, directions
        The point of each centerline nearest to the design pivot (mm) and its unit direction,
        shape (n, 3).
    """

    joint_names: tuple[str, ...]
    joints: Floats
    points_mm: Floats
    directions: Floats

    def moved(self, target_from_robot: RigidTransform) -> Motion:
        """Return the same motion in another frame."""
        return Motion(
            self.joint_names,
            self.joints,
            target_from_robot @ self.points_mm,
            target_from_robot.rotate(self.directions),
        )


class Robot(Protocol):
    """A robot that holds a shaft through a pivot."""

    def move(self, directions: Floats, rng: np.random.Generator) -> Motion:
        """Return where the shaft truly is when the robot is told these directions, shape (n, 3)."""
        ...


def cone_directions(count: int, apex_deg: float) -> Floats:
    """Return `count` unit directions spread evenly through a cone about z, shape (count, 3).

    A sunflower: equal solid angles, turned by the golden angle from one to the next; the last
    lie on the cone itself.

    Examples
    --------
    >>> directions = cone_directions(70, 57.0)
    >>> round(float(np.degrees(np.arccos(directions[:, 2].min()))), 6)
    28.5
    """
    if count < 1 or not 0 < apex_deg < 180:
        raise UsageError(
            f"{count} poses in a cone of {apex_deg}°",
            next_step="take at least one pose and a cone between 0° and 180°",
        )
    k = np.arange(count)
    height = 1 - (1 - np.cos(np.radians(apex_deg) / 2)) * k / max(count - 1, 1)
    turn = np.pi * (3 - np.sqrt(5)) * k
    across = np.sqrt((1 - height) * (1 + height))
    return np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=-1)


def motion_from_lines(
    names: tuple[str, ...], joints: ArrayLike, points_mm: ArrayLike, directions: ArrayLike
) -> Motion:
    """Return a motion whose points are moved along their lines next to the origin."""
    points, axes = checked(points_mm, (None, 3), "points_mm"), unit(directions)
    feet = points - np.sum(points * axes, axis=1, keepdims=True) * axes
    return Motion(names, read_only(joints), read_only(feet), read_only(axes))


@dataclass(frozen=True, slots=True, eq=False)
class SphericalBearing:
    """The gold standard: a shaft in a spherical bearing, whose axis all but meets the centre.

    Parameters
    ----------
    offset_sigma_mm
        Standard deviation of the axis's offset from the centre, in each of two directions, mm.
    """

    offset_sigma_mm: float = 0.015

    def move(self, directions: Floats, rng: np.random.Generator) -> Motion:
        """Return where the shaft truly is when told these directions, shape (n, 3)."""
        offsets = rng.normal(0.0, self.offset_sigma_mm, directions.shape)
        tilts = np.arctan2(directions[:, :2], directions[:, 2:])
        return motion_from_lines(("tilt_x_rad", "tilt_y_rad"), tilts, offsets, directions)


@dataclass(frozen=True, slots=True, eq=False)
class DoubleParallelogram:
    """A yaw axis and two coupled parallelograms, as on the da Vinci's instrument arms.

    In the plane of the linkage, x along the yaw axis and z up, a crank of two joints at
    `crank_mm` turns about A = (−reach, 0); a second crank about B = A + (ground, 0). The first
    coupler ties them and carries on to the shaft's holder; the second coupler ties the first
    crank's upper joint to the holder. Free of errors the holder is parallel to the crank and
    its line passes through the origin at every pitch.

    Parameters
    ----------
    reach_mm, ground_mm, crank_mm
        Nominal lengths, mm; `crank_mm` from A to the lower and to the upper joint.
    length_errors_mm
        Errors of the lower and upper crank joint, the second crank, the first coupler between the
        cranks and on to the holder, the second coupler, the holder, and the ground; shape (8,).
    holder_offset_mm, holder_tilt_rad
        The shaft against its holder, in and across the linkage's plane, shape (2,) each.
    yaw_offset_mm, yaw_tilt_rad
        The linkage against the yaw axis: along y and z, and about y and z, shape (2,) each.
    """

    reach_mm: float = 420.0
    ground_mm: float = 90.0
    crank_mm: tuple[float, float] = (190.0, 330.0)
    length_errors_mm: Floats = (0.0,) * 8  # type: ignore[assignment]
    holder_offset_mm: Floats = (0.0, 0.0)  # type: ignore[assignment]
    holder_tilt_rad: Floats = (0.0, 0.0)  # type: ignore[assignment]
    yaw_offset_mm: Floats = (0.0, 0.0)  # type: ignore[assignment]
    yaw_tilt_rad: Floats = (0.0, 0.0)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "length_errors_mm", read_only(checked(self.length_errors_mm, (8,), "lengths"))
        )
        for name in ("holder_offset_mm", "holder_tilt_rad", "yaw_offset_mm", "yaw_tilt_rad"):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), (2,), name)))

    def move(self, directions: Floats, rng: np.random.Generator) -> Motion:  # noqa: ARG002
        """Return where the shaft truly is when told these directions, shape (n, 3)."""
        pitch = np.arccos(directions[:, 0])
        yaw = np.arctan2(-directions[:, 1], directions[:, 2])
        lines = [self._line(p, y) for p, y in zip(pitch, yaw, strict=True)]
        points, axes = np.array(lines).transpose(1, 0, 2)
        return motion_from_lines(
            ("yaw_rad", "pitch_rad"), np.column_stack([yaw, pitch]), points, axes
        )

    def _line(self, pitch_rad: float, yaw_rad: float) -> tuple[Floats, Floats]:
        foot, along = self._holder(pitch_rad)
        across = np.array([-along[1], along[0]])
        foot = foot + self.holder_offset_mm[0] * across
        along = along + self.holder_tilt_rad[0] * across
        point = np.array([foot[0], self.holder_offset_mm[1], foot[1]])
        axis = np.array([along[0], self.holder_tilt_rad[1], along[1]])
        mounted = RigidTransform.from_rotation_vector(
            [0.0, *self.yaw_tilt_rad], [0.0, *self.yaw_offset_mm]
        )
        turned = RigidTransform.from_rotation_vector([yaw_rad, 0.0, 0.0], np.zeros(3)) @ mounted
        return turned @ point, turned.rotate(axis)

    def _holder(self, pitch_rad: float) -> tuple[Floats, Floats]:
        """Return a point of the holder and its direction in the linkage's plane."""
        lower, upper, second, first, onward, coupler, holder, ground = self.length_errors_mm
        crank = np.array([np.cos(pitch_rad), np.sin(pitch_rad)])
        A = np.array([-self.reach_mm, 0.0])
        B = np.array([self.ground_mm + ground - self.reach_mm, 0.0])
        C = A + (self.crank_mm[0] + lower) * crank
        D = _joint(C, self.ground_mm + first, B, self.crank_mm[0] + second)
        E = C + (self.reach_mm + onward) * (D - C) / np.linalg.norm(D - C)
        top = A + (self.crank_mm[1] + upper) * crank
        height = self.crank_mm[1] - self.crank_mm[0] + holder
        F = _joint(top, self.reach_mm + coupler, E, height)
        return E, (F - E) / np.linalg.norm(F - E)


def _joint(a: Floats, from_a: float, b: Floats, from_b: float) -> Floats:
    """Return the point at given distances from a and b, on the left of the way from a to b."""
    way = b - a
    distance = float(np.linalg.norm(way))
    along = (distance**2 + from_a**2 - from_b**2) / (2 * distance)
    aside = np.sqrt(max(from_a**2 - along**2, 0.0))
    normal = np.array([-way[1], way[0]]) / distance
    joint: Floats = a + along * way / distance + aside * normal
    return joint


@dataclass(frozen=True, slots=True, eq=False)
class SoftwareRcm:
    """A 6-axis arm whose controller holds the pivot, with joint offsets it does not know of.

    Denavit–Hartenberg (standard): joint turns about z, link d along z, a along x, α about x. The
    tool is the last z axis, pointing down to the pivot.

    Parameters
    ----------
    d_mm, a_mm, alpha_rad
        Link parameters, shape (6,).
    joint_offsets_rad
        What the true joint angles have on top of those commanded, shape (6,).
    robot_from_base
        Where the arm stands.
    insertion_mm
        From the flange to the pivot, mm.
    start_rad
        Joint angles near the working pose, where the search for a pose starts, shape (6,).
    """

    d_mm: Floats
    a_mm: Floats
    alpha_rad: Floats
    joint_offsets_rad: Floats
    robot_from_base: RigidTransform
    insertion_mm: float
    start_rad: Floats

    def __post_init__(self) -> None:
        for name in ("d_mm", "a_mm", "alpha_rad", "joint_offsets_rad", "start_rad"):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), (6,), name)))

    def flange(self, joints_rad: Floats) -> RigidTransform:
        """Return `robot_from_flange` for joint angles, shape (6,)."""
        flange = self._joint_frames(joints_rad)[-1]
        return RigidTransform(flange[:3, :3], flange[:3, 3])

    def _joint_frames(self, joints_rad: Floats) -> list[Floats]:
        """Return the base, then the frame after each joint, (4, 4) in the robot's frame."""
        base = np.eye(4)
        base[:3, :3], base[:3, 3] = (
            self.robot_from_base.rotation,
            self.robot_from_base @ np.zeros(3),
        )
        frames = [base]
        links = zip(joints_rad, self.d_mm, self.a_mm, self.alpha_rad, strict=True)
        for angle, d, a, alpha in links:
            (c, s), (ca, sa) = (np.cos(angle), np.sin(angle)), (np.cos(alpha), np.sin(alpha))
            link = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0.0, sa, ca, d]]
            frames.append(frames[-1] @ np.array([*link, [0.0, 0.0, 0.0, 1.0]]))
        return frames

    def move(self, directions: Floats, rng: np.random.Generator) -> Motion:  # noqa: ARG002
        """Return where the shaft truly is when told these directions, shape (n, 3).

        Raises
        ------
        UsageError
            If the arm does not reach a direction.
        """
        joints = np.array([self.joints_for(direction) for direction in directions])
        flanges = [self.flange(angles + self.joint_offsets_rad) for angles in joints]
        points = np.array([flange.translation_mm for flange in flanges])
        axes = np.array([-flange.rotation[:, 2] for flange in flanges])
        names = tuple(f"joint{k}_rad" for k in range(1, 7))
        return motion_from_lines(names, joints, points, axes)

    def joints_for(self, direction: ArrayLike) -> Floats:
        """Return the joint angles, shape (6,), that nominally hold the tool through the pivot."""
        wanted = _tool_pose(unit(direction), self.insertion_mm)
        joints = np.array(self.start_rad)
        for _ in range(60):
            step = self._newton_step(joints, wanted)
            joints = joints + step * min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-12))
            if np.abs(step).max() < 1e-12:
                return joints
        raise UsageError(
            f"the arm does not reach direction {np.round(unit(direction), 3)}",
            next_step="take a narrower cone or move the arm's base",
        )

    def _newton_step(self, joints: Floats, wanted: RigidTransform) -> Floats:
        """Return the joint step towards a flange pose, from the geometric Jacobian."""
        frames = np.array(self._joint_frames(joints))
        tip, axes = frames[-1, :3, 3], frames[:-1, :3, 2]
        arms = tip - frames[:-1, :3, 3]
        jacobian = np.concatenate([np.cross(axes, arms).T, self.insertion_mm * axes.T])
        turn = RigidTransform(wanted.rotation @ frames[-1, :3, :3].T, np.zeros(3))
        miss = [wanted.translation_mm - tip, self.insertion_mm * turn.rotation_vector_rad()]
        step: Floats = np.linalg.lstsq(jacobian, np.concatenate(miss), rcond=1e-9)[0]
        return step


def _tool_pose(direction: Floats, insertion_mm: float) -> RigidTransform:
    """Return `robot_from_flange` at the end of the shaft, z down to the pivot, x kept forward."""
    z = -direction
    y = unit(np.cross(z, [1.0, 0.0, 0.0]))
    return RigidTransform(np.column_stack([np.cross(y, z), y, z]), insertion_mm * direction)
