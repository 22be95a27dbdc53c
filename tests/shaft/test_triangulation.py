import numpy as np
import pytest

from pivometer.errors import DegenerateGeometryError, ShapeError
from pivometer.geometry import RigidTransform, tangent_plane_normals
from pivometer.shaft.silhouette import centerline_normal_average
from pivometer.shaft.triangulation import (
    REFUSE_DIHEDRAL_RAD,
    lines_from_edge_normals,
    triangulate_centerline,
    triangulate_two_view,
)

RADIUS_MM = 5.0


def looking_at(centre, target):
    """Reference-from-camera transform of a camera at `centre` that looks at `target`."""
    z = (np.asarray(target) - centre) / np.linalg.norm(np.asarray(target) - centre)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return RigidTransform(np.stack([x, np.cross(z, x), z], axis=1), centre)


TARGET = np.array([6.0, 65.0, 478.0])
TWO = [RigidTransform.identity(), looking_at([420.0, 10.0, 320.0], TARGET)]
FOUR = [
    *TWO,
    looking_at([-380.0, -40.0, 300.0], TARGET),
    looking_at([50.0, -390.0, 400.0], TARGET),
]


def edge_normals(point, direction, transforms, radius=RADIUS_MM):
    normals = []
    for reference_from_camera in transforms:
        camera_from_reference = reference_from_camera.inverse()
        normals.append(
            tangent_plane_normals(
                camera_from_reference @ point, camera_from_reference.rotate(direction), radius
            )
        )
    return np.array(normals)


def random_line(rng):
    direction = np.array([0.0, -1.0, 0.0]) + 0.5 * rng.normal(size=3)
    return TARGET + 20 * rng.normal(size=3), direction / np.linalg.norm(direction)


def across(vector, direction):
    return vector - (vector @ direction) * direction


@pytest.mark.parametrize("transforms", [TWO, FOUR])
def test_noiseless_edges_give_the_line_back(transforms):
    rng = np.random.default_rng(2)
    for _ in range(20):
        point, direction = random_line(rng)
        line = triangulate_centerline(edge_normals(point, direction, transforms), transforms)
        # The edges of a 5 mm radius at 500 mm are known to 1e-16, their difference (2 r / d) and
        # with it the depth to 1e-12 mm.
        assert np.linalg.norm(across(point - line.point_mm, direction)) < 1e-9
        assert 1 - abs(line.direction @ direction) < 1e-15
        assert abs(line.point_mm @ line.direction) < 1e-9
        assert np.abs(line.diameters_mm - 2 * RADIUS_MM).max() < 1e-9
        assert line.diameters_mm.shape == (len(transforms),)


def test_general_form_equals_the_papers_for_two_cameras():
    rng = np.random.default_rng(3)
    for _ in range(20):
        edges = edge_normals(*random_line(rng), TWO) + rng.normal(0, 1e-3, (2, 2, 3))
        line = triangulate_centerline(edges, TWO)
        centre_normals = centerline_normal_average(edges)
        b, a = triangulate_two_view(*centre_normals, TWO[1])
        assert np.abs(b - line.point_mm).max() < 1e-9
        assert np.abs(a - np.sign(a @ line.direction) * line.direction).max() < 1e-12


def test_paper_equations_hold_at_the_solution():
    n_l, n_r = np.array([0.9, 0.1, -0.2]), np.array([0.8, -0.2, 0.3])
    n_l, n_r = n_l / np.linalg.norm(n_l), n_r / np.linalg.norm(n_r)
    R, t = TWO[1].rotation, TWO[1].translation_mm
    b, a = triangulate_two_view(n_l, n_r, TWO[1])
    assert abs(n_l @ b) < 1e-10  # (15)
    assert abs(n_r @ R.T @ (b - t)) < 1e-10  # (16)
    assert abs(a @ b) < 1e-10  # (12)
    assert np.abs(np.cross(a, np.cross(n_l, R @ n_r))).max() < 1e-14  # (14)


def test_many_lines_at_once_equal_one_by_one():
    rng = np.random.default_rng(4)
    edges = np.array([edge_normals(*random_line(rng), FOUR) for _ in range(5)])
    points, directions, dihedrals = lines_from_edge_normals(edges, FOUR)
    for k, one in enumerate(edges):
        line = triangulate_centerline(one, FOUR)
        assert np.allclose(points[k], line.point_mm, atol=1e-9)
        assert np.allclose(directions[k], line.direction, atol=1e-12)
        assert dihedrals[k] == pytest.approx(line.dihedral_rad, abs=1e-12)


def test_result_does_not_depend_on_the_frame():
    """Moving all cameras together moves the line with them."""
    rng = np.random.default_rng(5)
    edges = edge_normals(*random_line(rng), TWO) + rng.normal(0, 1e-3, (2, 2, 3))
    line = triangulate_centerline(edges, TWO)
    moved_from_reference = RigidTransform.from_rotation_vector(
        [0.3, -0.2, 0.5], [10.0, -70.0, 30.0]
    )
    moved = triangulate_centerline(edges, [moved_from_reference @ x for x in TWO])
    assert np.allclose(moved.direction, moved_from_reference.rotate(line.direction), atol=1e-12)
    offset = (moved_from_reference @ line.point_mm) - moved.point_mm
    assert np.linalg.norm(across(offset, moved.direction)) < 1e-9


def line_with_dihedral(angle_rad):
    """A line whose planes through both camera centres are `angle_rad` apart."""
    c1 = TWO[1].translation_mm
    baseline = c1 / np.linalg.norm(c1)
    away = across(TARGET, baseline)
    depth = np.linalg.norm(away)
    away /= depth
    side = np.cross(baseline, away)
    # In the plane of baseline and target for angle 0; tilted out of it otherwise.
    for tilt in np.linspace(0, np.pi / 2, 20001):
        direction = np.cos(tilt) * (0.5 * baseline + away) / np.hypot(0.5, 1) + np.sin(tilt) * side
        n1, n2 = np.cross(TARGET, direction), np.cross(TARGET - c1, direction)
        cosine = abs(n1 @ n2) / np.linalg.norm(n1) / np.linalg.norm(n2)
        if np.arccos(min(cosine, 1.0)) >= angle_rad:
            return TARGET, direction
    raise AssertionError


def test_five_degrees_is_the_limit():
    edges = edge_normals(*line_with_dihedral(REFUSE_DIHEDRAL_RAD * 1.02), TWO)
    assert triangulate_centerline(edges, TWO).dihedral_rad > REFUSE_DIHEDRAL_RAD
    edges = edge_normals(*line_with_dihedral(REFUSE_DIHEDRAL_RAD * 0.9), TWO)
    with pytest.raises(DegenerateGeometryError, match="contains the baseline"):
        triangulate_centerline(edges, TWO)
    with pytest.raises(DegenerateGeometryError, match="contains the baseline"):
        triangulate_two_view(*centerline_normal_average(edges), TWO[1])


def test_any_centerline_coplanar_with_the_baseline_is_refused_not_only_a_parallel_one():
    baseline = TWO[1].translation_mm
    for direction in (baseline, 0.3 * baseline + TARGET):
        point = TARGET
        edges = edge_normals(point, direction / np.linalg.norm(direction), TWO)
        with pytest.raises(DegenerateGeometryError):
            triangulate_centerline(edges, TWO)


def test_a_third_camera_rescues_a_pose_coplanar_with_the_first_baseline():
    direction = 0.3 * TWO[1].translation_mm + TARGET
    direction /= np.linalg.norm(direction)
    line = triangulate_centerline(edge_normals(TARGET, direction, FOUR), FOUR)
    assert np.linalg.norm(across(TARGET - line.point_mm, direction)) < 1e-9


@pytest.mark.parametrize("transforms", [TWO, FOUR])
def test_covariance_predicts_the_scatter_everywhere_along_the_line(transforms):
    rng = np.random.default_rng(6)
    point, direction = random_line(rng)
    clean = edge_normals(point, direction, transforms)
    count = len(transforms)
    factor = 1e-4 * rng.normal(size=(count, 6, 6))
    covariances = factor @ np.swapaxes(factor, 1, 2)
    line = triangulate_centerline(clean, transforms, covariances=covariances)
    trials = 4000
    noise = np.einsum("cij,ncj->nci", factor, rng.normal(size=(trials, count, 6)))
    points, directions, _ = lines_from_edge_normals(
        clean + noise.reshape(trials, count, 2, 3), transforms
    )
    for tau in (-200.0, 0.0, 150.0):
        at = line.point_mm + tau * line.direction
        offset = points - at
        offset -= ((offset @ line.direction) / (directions @ line.direction))[:, None] * directions
        measured = offset.T @ offset / trials
        predicted = line.position_covariance_mm2(at)
        # A variance from 4000 trials has a relative standard deviation of √(2/4000) = 2.2 %.
        assert np.abs(measured - predicted).max() < 5 * 0.0224 * np.trace(predicted)
        assert np.abs(predicted @ line.direction).max() < 1e-12 * np.trace(predicted)


def test_covariance_of_two_planes_is_the_closed_form():
    """S = Ñ⁻¹ diag(s_l², s_r²) Ñ⁻ᵀ for planes shifted by s_l and s_r at the point asked for."""
    edges = edge_normals(TARGET, np.array([0.0, -1.0, 0.0]), TWO)
    sigma = 1e-5
    covariances = np.array([sigma**2 * np.eye(6)] * 2)
    line = triangulate_centerline(edges, TWO, covariances=covariances)
    normals = [x.rotate(centerline_normal_average(e)) for x, e in zip(TWO, edges, strict=True)]
    shifts = []
    for x, e in zip(TWO, edges, strict=True):
        distance = np.linalg.norm(TARGET - x.translation_mm)
        # Only what is perpendicular to an edge's normal turns it: a part 1 − (r/d)² of σ².
        turned = sigma * np.sqrt(1 - (RADIUS_MM / distance) ** 2)
        shifts.append(turned * np.sqrt(2) * distance / np.linalg.norm(e[0] - e[1]))
    N = np.stack([*normals, line.direction])
    inverse = np.linalg.inv(N)
    expected = inverse @ np.diag([*np.square(shifts), 0.0]) @ inverse.T
    measured = line.position_covariance_mm2(TARGET)
    assert np.abs(measured - expected).max() < 1e-6 * np.trace(expected)


def test_no_covariance_given_means_none_stated():
    edges = edge_normals(TARGET, np.array([0.0, -1.0, 0.0]), TWO)
    assert not triangulate_centerline(edges, TWO).position_covariance_mm2(TARGET).any()


def test_wrong_numbers_of_cameras_are_refused():
    edges = edge_normals(TARGET, np.array([0.0, -1.0, 0.0]), TWO)
    with pytest.raises(ShapeError):
        triangulate_centerline(edges[:1], TWO[:1])
    with pytest.raises(ShapeError):
        triangulate_centerline(edges, FOUR)
