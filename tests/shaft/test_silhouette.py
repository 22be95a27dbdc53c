import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pivometer.errors import DegenerateGeometryError, ShapeError
from pivometer.geometry import tangent_plane_normals
from pivometer.shaft.silhouette import (
    centerline_normal_algebraic,
    centerline_normal_average,
    coimage_normal,
    normalized_line,
    outward_normals,
)

EPS = np.finfo(float).eps


@st.composite
def cylinders(draw, largest_ratio=0.999):
    """A foot point, a direction across it and a radius, up to the camera touching the cylinder."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    foot = rng.normal(size=3)
    foot *= rng.uniform(50, 2000) / np.linalg.norm(foot)
    direction = np.cross(foot, rng.normal(size=3))
    ratio = draw(st.floats(1e-3, largest_ratio))
    return foot, direction / np.linalg.norm(direction), ratio * np.linalg.norm(foot)


@given(cylinders())
@settings(max_examples=200, deadline=None)
def test_average_and_algebraic_normals_agree_to_rounding_for_any_width(cylinder):
    foot, direction, radius = cylinder
    normals = tangent_plane_normals(foot, direction, radius)
    average = centerline_normal_average(normals)
    algebraic = centerline_normal_algebraic(normals)
    # (8) divides by the sine of the angle between the planes, (10)-(12) solve with it once more.
    sine = np.linalg.norm(np.cross(*normals))
    assert np.abs(average - algebraic).max() < 50 * EPS / sine


@given(cylinders())
@settings(max_examples=200, deadline=None)
def test_centerline_plane_holds_the_axis(cylinder):
    foot, direction, radius = cylinder
    normal = centerline_normal_average(tangent_plane_normals(foot, direction, radius))
    assert abs(normal @ direction) < 1e-12
    assert abs(normal @ foot) < 1e-12 * np.linalg.norm(foot)


def test_a_plain_average_of_the_image_lines_would_be_wrong_for_a_wide_cylinder():
    """The paper's remark: l_c is not the average of l_l and l_r; n_c is that of n_l and n_r."""
    foot, direction = np.array([60.0, 0.0, 100.0]), np.array([0.0, -1.0, 0.0])
    normals = tangent_plane_normals(foot, direction, 40.0)
    image_lines = -normals[:, 2] / normals[:, 0]  # u of each edge at f = 1
    assert abs(image_lines.mean() - 0.6) > 0.1
    normal = centerline_normal_average(normals)
    assert -normal[2] / normal[0] == pytest.approx(0.6, abs=1e-12)


def test_both_ways_take_batches():
    rng = np.random.default_rng(1)
    normals = np.array(
        [
            tangent_plane_normals([x, 0.0, 400.0], [0.1, -1.0, 0.0], 5.0)
            for x in rng.uniform(-90, 90, 6)
        ]
    ).reshape(2, 3, 2, 3)
    average = centerline_normal_average(normals)
    assert average.shape == (2, 3, 3)
    assert np.abs(average - centerline_normal_algebraic(normals)).max() < 1e-12
    assert np.array_equal(average[1, 2], centerline_normal_average(normals[1, 2]))


def test_coimage_normal_is_perpendicular_to_every_ray_of_the_line():
    a, b, f = np.array([0.3, -0.8]), np.array([12.0, 5.0]), 7.5
    normal = coimage_normal(a, b, f)
    for tau in (-20.0, 0.0, 13.0):
        point = np.append(a * tau + b, f)
        assert abs(normal @ point) < 1e-14 * np.linalg.norm(point) * 10
    assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-15)


def test_coimage_normal_does_not_depend_on_the_point_chosen_or_the_unit():
    a, b = np.array([0.3, -0.8]), np.array([0.12, 0.05])
    reference = coimage_normal(a, b)
    assert np.allclose(coimage_normal(5 * a, b - 3 * a), reference, atol=1e-15)
    assert np.allclose(coimage_normal(a, 800 * b, 800.0), reference, atol=1e-15)
    assert np.allclose(coimage_normal(-a, b), -reference, atol=1e-15)


def test_normalized_line_is_the_line_through_normalized_points():
    K = np.array([[950.0, 0, 310], [0, 970, 250], [0, 0, 1]])
    a_px, b_px = np.array([3.0, 11.0]), np.array([400.0, 100.0])
    a, b = normalized_line(a_px, b_px, K)
    for tau in (-10.0, 0.0, 40.0):
        point = np.linalg.solve(K, np.append(a_px * tau + b_px, 1.0))
        assert np.allclose(a * tau + b, point[:2], atol=1e-15)


def test_outward_normals_undo_any_sign_and_length():
    normals = tangent_plane_normals([30.0, 0.0, 400.0], [0.1, -1.0, 0.2], 8.0)
    spoilt = normals * np.array([[-3.0], [0.5]])
    foot = np.array([30.0, 0.0, 400.0])
    assert np.allclose(outward_normals(spoilt, foot), normals, atol=1e-15)


def test_equal_edges_are_refused():
    normals = np.array([[1.0, 0.0, 0.1], [1.0, 0.0, 0.1]])
    with pytest.raises(DegenerateGeometryError, match="one line"):
        centerline_normal_average(normals)
    with pytest.raises(DegenerateGeometryError, match="one line"):
        centerline_normal_algebraic(normals)


def test_wrong_shapes_are_refused():
    with pytest.raises(ShapeError):
        centerline_normal_average(np.ones((3, 3)))
    with pytest.raises(ShapeError):
        coimage_normal([0.0, 0.0], [1.0, 2.0])
