import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pivometer.errors import ShapeError
from pivometer.geometry import RigidTransform
from pivometer.geometry.rigid import cross_matrix, rotation_from_vector, vector_from_rotation

EPS = np.finfo(float).eps

unit_angles = st.floats(0, 2 * np.pi)
# Random turns, turns next to none, and turns next to half a turn: where formulas break.
angles = st.one_of(
    st.floats(0, np.pi), st.floats(0, 1e-7), st.floats(np.pi - 1e-7, np.pi, exclude_max=True)
)


@st.composite
def rotation_vectors(draw):
    z, phi = draw(st.floats(-1, 1)), draw(unit_angles)
    ring = np.sqrt(1 - z * z)
    return draw(angles) * np.array([ring * np.cos(phi), ring * np.sin(phi), z])


@st.composite
def transforms(draw):
    translation = [draw(st.floats(-1e4, 1e4)) for _ in range(3)]
    return RigidTransform.from_rotation_vector(draw(rotation_vectors()), translation)


@given(rotation_vectors())
def test_rotation_agrees_with_rodrigues_of_opencv(vector):
    oracle = cv2.Rodrigues(vector)[0]
    np.testing.assert_allclose(rotation_from_vector(vector), oracle, atol=1e-12)


@given(rotation_vectors())
def test_rotation_vector_comes_back(vector):
    rotation = rotation_from_vector(vector)
    again = rotation_from_vector(vector_from_rotation(rotation))
    np.testing.assert_allclose(again, rotation, atol=100 * EPS)
    assert np.linalg.norm(vector_from_rotation(rotation)) <= np.pi + 10 * EPS


@given(transforms(), transforms(), transforms())
def test_transforms_form_a_group(a_from_b, b_from_c, c_from_d):
    left = (a_from_b @ b_from_c) @ c_from_d
    right = a_from_b @ (b_from_c @ c_from_d)
    np.testing.assert_allclose(left.rotation, right.rotation, atol=1e-14)
    np.testing.assert_allclose(left.translation_mm, right.translation_mm, atol=1e-10)
    nothing = a_from_b @ a_from_b.inverse()
    np.testing.assert_allclose(nothing.rotation, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(nothing.translation_mm, 0, atol=1e-10)


@given(transforms(), transforms())
def test_composition_maps_points_as_its_parts_do(a_from_b, b_from_c):
    points = np.arange(12.0).reshape(2, 2, 3)
    np.testing.assert_allclose(
        (a_from_b @ b_from_c) @ points, a_from_b @ (b_from_c @ points), atol=1e-9
    )


def test_cross_matrix_is_the_cross_product():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 5, 3))
    np.testing.assert_allclose(
        np.einsum("nij,nj->ni", cross_matrix(a), b), np.cross(a, b), atol=1e-15
    )


@pytest.mark.parametrize("matrix", [np.diag([1.0, 1, -1]), 1.1 * np.eye(3)])
def test_what_is_not_a_rotation_is_refused(matrix):
    with pytest.raises(ShapeError, match="not a rotation matrix"):
        RigidTransform(matrix, np.zeros(3))


def test_arrays_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        RigidTransform.identity().rotation[0, 0] = 2
