import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pivometer.errors import DegenerateGeometryError, ShapeError
from pivometer.geometry import (
    RigidTransform,
    angle_between_planes,
    distances_to_lines,
    nearest_points_on_lines,
    tangent_plane_normals,
)
from pivometer.geometry.line import unit

seeds = st.integers(0, 2**32 - 1)


@given(seeds)
def test_nearest_point_is_on_the_line_and_the_miss_perpendicular(seed):
    rng = np.random.default_rng(seed)
    point, origins, directions = rng.normal(size=3), *rng.normal(size=(2, 4, 3))
    nearest = nearest_points_on_lines(point, origins, directions)
    on_line = np.cross(nearest - origins, unit(directions))
    np.testing.assert_allclose(on_line, 0, atol=1e-12)
    np.testing.assert_allclose(
        np.einsum("ij,ij->i", nearest - point, unit(directions)), 0, atol=1e-12
    )


@given(seeds)
def test_distances_do_not_depend_on_the_frame(seed):
    rng = np.random.default_rng(seed)
    point, origins, directions = rng.normal(size=3), *rng.normal(size=(2, 4, 3))
    frame = RigidTransform.from_rotation_vector(rng.normal(size=3), rng.normal(size=3))
    np.testing.assert_allclose(
        distances_to_lines(frame @ point, frame @ origins, 3 * frame.rotate(directions)),
        distances_to_lines(point, origins, directions),
        atol=1e-12,
    )


def test_a_direction_without_length_is_refused():
    with pytest.raises(ShapeError, match="zero length"):
        distances_to_lines([0, 0, 0], [[0, 0, 0]], [[0, 0, 0]])


def test_directions_of_any_scale_are_fine():
    np.testing.assert_allclose(unit([[1e-200, 0, 0], [0, 1e200, 0]]), [[1, 0, 0], [0, 1, 0]])


@given(st.floats(0, np.pi / 2), seeds)
def test_angle_between_planes_ignores_length_and_sense(angle, seed):
    rng = np.random.default_rng(seed)
    frame = RigidTransform.from_rotation_vector(rng.normal(size=3), np.zeros(3))
    a, b = frame.rotate([[1.0, 0, 0], [np.cos(angle), np.sin(angle), 0]])
    assert angle_between_planes(a, -7 * b) == pytest.approx(angle, abs=1e-14)


@given(seeds, st.floats(0.01, 50))
def test_tangent_planes_touch_the_cylinder_and_point_away(seed, radius):
    rng = np.random.default_rng(seed)
    axis = unit(rng.normal(size=3))
    point = rng.normal(size=3) + 60 * unit(np.cross(axis, rng.normal(size=3)))
    normals = tangent_plane_normals(point, axis, radius)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-14)
    np.testing.assert_allclose(normals @ axis, 0, atol=1e-14)
    np.testing.assert_allclose(normals @ point + radius, 0, atol=1e-11)  # (10) and (11)


def test_a_viewpoint_inside_the_cylinder_is_refused():
    with pytest.raises(DegenerateGeometryError, match="inside it"):
        tangent_plane_normals([0, 0, 2], [0, 1, 0], 2.5)
