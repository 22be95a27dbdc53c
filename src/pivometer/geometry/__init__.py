"""Rigid transforms, lines, planes and cylinders: arrays in, values out."""

from pivometer.geometry.cylinder import tangent_plane_normals
from pivometer.geometry.line import distances_to_lines, nearest_points_on_lines
from pivometer.geometry.plane import angle_between_planes
from pivometer.geometry.rigid import RigidTransform

__all__ = [
    "RigidTransform",
    "angle_between_planes",
    "distances_to_lines",
    "nearest_points_on_lines",
    "tangent_plane_normals",
]
