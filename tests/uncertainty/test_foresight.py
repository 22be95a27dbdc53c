"""What is foreseen is what simulated sessions then show."""

import numpy as np
import pytest

from pivometer.cameras import Camera, Rig
from pivometer.errors import UsageError
from pivometer.geometry import RigidTransform, tangent_plane_normals
from pivometer.rcm import solve
from pivometer.shaft.silhouette import edge_normals
from pivometer.shaft.triangulation import lines_from_edge_normals
from pivometer.simulation.robots import cone_directions
from pivometer.uncertainty.foresight import (
    Shaft,
    foresee,
    foreseen_edges,
    foreseen_lines,
    foreseen_location,
)
from pivometer.uncertainty.propagation import square_root

POINT = np.array([6.4, 65.7, 478.3])
SHAFT = Shaft(10.0, (30.0, 120.0))
EDGE_PX, SESSIONS, ROWS, COUNT = 0.2, 300, 80, 12


@pytest.fixture
def rig(rig) -> Rig:
    """The rig of the other tests with larger pictures, which hold the shaft in every pose."""
    shift = np.array([320.0, 240.0])
    cameras = [
        Camera(c.name, 1280, 960, c.focal_px, c.principal_point_px + shift, c.distortion)
        for c in rig.cameras
    ]
    return Rig(cameras, rig.reference_from_camera)


@pytest.fixture
def axes() -> np.ndarray:
    """Directions in a cone of 57°, the shaft's end up in the picture: −y."""
    return cone_directions(COUNT, 57.0)[:, [0, 2, 1]] * [1.0, -1.0, 1.0]


def rows_of(rig, axes) -> tuple[np.ndarray, np.ndarray]:
    """Return points on all edges, (n, c, 2, ROWS, 2), and how long each edge is, px."""
    along = np.linspace(*SHAFT.span_mm, ROWS)[:, None]
    points = np.empty((len(axes), len(rig.cameras), 2, ROWS, 2))
    for c, (camera, to) in enumerate(zip(rig.cameras, rig.reference_from_camera, strict=True)):
        base = to.inverse() @ POINT
        for i, axis in enumerate(to.inverse().rotate(axes)):
            for side, normal in enumerate(tangent_plane_normals(base, axis, 5.0)):
                points[i, c, side] = camera.project(base + 5.0 * normal + along * axis)
    return points, np.linalg.norm(points[..., -1, :] - points[..., 0, :], axis=-1)


def measured(points, rig):
    normals = np.stack(
        [edge_normals(points[:, c], camera) for c, camera in enumerate(rig.cameras)], axis=1
    )
    return solve(*lines_from_edge_normals(normals, rig.reference_from_camera)[:2])


@pytest.mark.parametrize("calibrated", [True, False])
def test_simulated_sessions_scatter_as_foreseen(rig, rig_covariance, axes, calibrated):
    rng = np.random.default_rng(0)
    covariance = rig_covariance if calibrated else 1e-12 * rig_covariance
    root = square_root(covariance)
    exact, lengths = rows_of(rig, axes)
    sigma = EDGE_PX * np.sqrt(ROWS / lengths)[..., None, None]  # as one row for each pixel
    errors, misses = [], []
    for _ in range(SESSIONS):
        seen = exact + sigma * rng.standard_normal(exact.shape)
        believed = rig.perturbed(root @ rng.standard_normal(root.shape[1])) if calibrated else rig
        rcm = measured(seen, believed)
        errors.append(rcm.least_squares.point_mm - POINT)
        misses.append((rcm.least_squares.rms_mm, rcm.minimax.max_mm))
    lines = foreseen_lines(rig, POINT, axes, SHAFT, edge_px=EDGE_PX)
    foresight = foresee(lines, rig, covariance)
    location = foresight.uncertainty
    off = np.einsum("si,ij,sj->s", errors, np.linalg.inv(location.total_mm2), errors)
    assert off.mean() == pytest.approx(3, abs=4 * np.sqrt(6 / SESSIONS))
    ratio = np.std(errors, axis=0) / np.sqrt(location.total_mm2.diagonal())
    np.testing.assert_allclose(ratio, 1, atol=4 / np.sqrt(2 * SESSIONS))
    rms, largest = np.array(misses).T
    # Each session's sum of squares has 2n − 3 degrees of freedom, at the least a third of them.
    tolerance = 4 * np.sqrt(2 / (SESSIONS * (2 * COUNT - 3) / 3))
    assert np.mean(rms**2) == pytest.approx(foresight.instrument_rms_mm**2, rel=tolerance)
    spread = np.hypot(largest.std() / np.sqrt(SESSIONS), largest.std() / np.sqrt(200))
    assert largest.mean() == pytest.approx(foresight.instrument_max_mm, abs=4 * spread)


def test_a_robot_that_scatters_is_less_certain(rig, rig_covariance, axes):
    lines = foreseen_lines(rig, POINT, axes, SHAFT, edge_px=EDGE_PX)
    u = [foreseen_location(lines, rig, rig_covariance, robot_rms_mm=r) for r in (0.0, 3.0)]
    added = u[1].lines_mm2 - u[0].lines_mm2
    information = (np.eye(3) - axes[:, :, None] * axes[:, None, :]).sum(axis=0)
    np.testing.assert_allclose(added, 4.5 * np.linalg.inv(information), rtol=1e-6, atol=1e-9)


def test_a_shaft_out_of_view_is_named(rig, axes):
    away = RigidTransform.from_rotation_vector([0, 1.0, 0], [0, 0, 0])
    with pytest.raises(UsageError, match="camera left sees less than a third of the shaft"):
        foreseen_edges(rig.cameras[0], away, POINT, axes[0], SHAFT, edge_px=EDGE_PX)
