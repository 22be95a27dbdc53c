"""What the edges say beyond their centerlines: columns, chance, and each fault in its place."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy import stats

from pivometer.cameras import Camera, Rig
from pivometer.errors import ShapeError
from pivometer.geometry import RigidTransform
from pivometer.geometry.cylinder import tangent_planes
from pivometer.shaft.cylinder_fit import perpendicular_bases
from pivometer.uncertainty.remainders import remainders
from pivometer.uncertainty.shading import SHADING_PX
from pivometer.uncertainty.shaft_check import check_shaft

TARGET = np.array([6.0, 65.0, 478.0])
DIAMETER_MM, SIGMA_PX, LENGTH_MM = 10.0, 0.02, 160.0


def looking_at(centre):
    z = (TARGET - centre) / np.linalg.norm(TARGET - centre)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return RigidTransform(np.stack([x, np.cross(z, x), z], axis=1), centre)


THREE = Rig(
    [
        Camera("left", 640, 480, [980, 981], [314, 245], [-0.17, 0.08]),
        Camera("right", 640, 480, [1012, 1009], [327, 233], [-0.23, 0.12]),
        Camera("third", 640, 480, [1000, 1000], [320, 240], [-0.2, 0.1]),
    ],
    [
        RigidTransform.identity(),
        looking_at([420.0, 10.0, 320.0]),
        looking_at([50.0, -390.0, 400.0]),
    ],
)
TWO = Rig(THREE.cameras[:2], THREE.reference_from_camera[:2])
UNITS = {"f": 1.0, "o": 1.0, "k": 0.003, "r": 2e-4, "t": 0.1}


def spread(rig, part=1.0):
    """A rig's covariance: 1 px, 0.003 of the distortion, 0.2 mrad and 0.1 mm, times `part`."""
    return np.diag([(part * UNITS[name.split(".")[1][0]]) ** 2 for name in rig.parameter_names])


@dataclass
class Edges:
    camera: str
    points_px: np.ndarray
    normals_covariance: np.ndarray


def poses(rng, count):
    tilt, turn = np.radians(28) * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    directions = np.stack(
        [np.sin(tilt) * np.cos(turn), -np.cos(tilt), np.sin(tilt) * np.sin(turn)], axis=1
    )
    return TARGET + 0.05 * rng.normal(size=(count, 3)), directions


def edges_of(
    rng, rigs, points, directions, *, diameters=DIAMETER_MM, shading_px=None, wrong_px=None
):
    """The edges that the cameras of one rig a pose see, with noise and its covariance."""
    count, cameras = len(points), len(rigs[0].cameras)
    diameters = np.broadcast_to(diameters, (count, cameras))
    shading = np.zeros((cameras, 2)) if shading_px is None else shading_px
    seen = []
    for i, rig in enumerate(rigs):
        pose = []
        for k, (camera, transform) in enumerate(
            zip(rig.cameras, rig.reference_from_camera, strict=True)
        ):
            back = transform.inverse()
            point, axis = back @ points[i], back.rotate(directions[i])
            planes = tangent_planes(
                [point], [axis], [diameters[i, k] / 2], [[0, 0, 0]], perpendicular_bases(axis[None])
            )[0][0, 0]
            tracks, covariance = np.zeros((2, 9, 2)), np.zeros((6, 6))
            for e, plane in enumerate(planes):
                middle, end = point + axis * LENGTH_MM / 2, point + axis * LENGTH_MM
                feet = np.stack([x - (x @ plane) * plane for x in (2 * middle - end, end)])
                ends = (feet[:, :2] / feet[:, 2:]) * camera.focal_px
                outward = plane[:2] / np.linalg.norm(plane[:2])
                length = np.linalg.norm(ends[1] - ends[0])
                off, tilt = SIGMA_PX * rng.normal(), SIGMA_PX * np.sqrt(3) * rng.normal()
                off += shading[k, e] + (0 if wrong_px is None else wrong_px[i, k, e])
                ends = ends + np.outer([off - tilt, off + tilt], outward)
                along = np.linspace(0, 1, 9)[:, None]
                line = (ends[0] + along * (ends[1] - ends[0])) / camera.focal_px
                tracks[e] = camera.pixels_from_normalized(line)
                ray = feet.mean(axis=0) / np.linalg.norm(feet.mean(axis=0))
                turn = np.cross(plane, ray)
                shift = SIGMA_PX / camera.focal_px.mean() * ray[2]
                tilts = SIGMA_PX * np.sqrt(12) / length
                at = slice(3 * e, 3 * e + 3)
                covariance[at, at] = shift**2 * np.outer(ray, ray) + tilts**2 * np.outer(turn, turn)
            pose.append(Edges(camera.name, tracks, covariance))
        seen.append(pose)
    return seen


def turned(rig, camera, degrees):
    delta = np.zeros(len(rig.parameter_names))
    delta[rig.parameter_names.index(f"{camera}.rx_rad")] = np.radians(degrees)
    return rig.perturbed(delta)


def test_columns_are_what_refitted_remainders_change_by():
    rng = np.random.default_rng(1)
    seen = edges_of(rng, [THREE] * 6, *poses(rng, 6))
    del seen[2][1], seen[4][2]
    left = remainders(seen, THREE, spread(THREE), [0.0] * 3)
    for index, sigma in enumerate(np.sqrt(spread(THREE).diagonal())):
        step = np.zeros(len(THREE.parameter_names))
        step[index] = sigma
        there, back = (
            remainders(seen, THREE.perturbed(s), None, [0.0] * 3).values for s in (step, -step)
        )
        change = (there - back) / 2
        column = left.by_calibration[..., np.argmax(np.abs(left.by_calibration).sum(axis=(0, 1)))]
        root = left.by_calibration.reshape(-1, left.by_calibration.shape[2])
        radius = left.by_radius.ravel() / np.linalg.norm(left.by_radius)
        # The covariance is diagonal, so each parameter is a column; the refit takes the radius out.
        distance = [
            np.linalg.norm((c - radius * (radius @ c)) * s - change.ravel())
            for c in root.T
            for s in (1, -1)
        ]
        assert min(distance) < 2e-3 * np.abs(column).max() + 0.01 * np.linalg.norm(change)


@pytest.fixture(scope="module")
def chance_sessions():
    """Check 60 sessions in which all is as stated: noise, shading, calibration."""
    rng = np.random.default_rng(2)
    checks = []
    for _ in range(60):
        true = TWO.perturbed(np.sqrt(spread(TWO).diagonal()) * rng.normal(size=18))
        shading = SHADING_PX * rng.normal(size=(2, 2)) @ [[1, 1], [1, -1]]
        seen = edges_of(rng, [true] * 12, *poses(rng, 12), shading_px=shading)
        checks.append(check_shaft(seen, TWO, spread(TWO), chance=0.05))
    return checks


def test_chance_alarms_no_more_often_than_stated(chance_sessions):
    most = stats.binom(60, 0.05).ppf(1 - 1e-4)
    assert sum((check.chi_squares > check.limits).any() for check in chance_sessions) <= most
    assert sum(check.moved.significant for check in chance_sessions) <= most
    assert sum(check.change.significant for check in chance_sessions) <= most


def test_stated_uncertainty_of_the_diameter_is_that_of_its_errors(chance_sessions):
    found = [check.diameter for check in chance_sessions]
    square = sum(((d.value_mm - DIAMETER_MM) / d.u_mm) ** 2 for d in found)
    assert stats.chi2(60).ppf(1e-4) < square < stats.chi2(60).ppf(1 - 1e-4)
    first = found[0]
    parts = (first.edges_u_mm, first.shading_u_mm, first.calibration_u_mm)
    assert first.u_mm == pytest.approx(np.linalg.norm(parts))
    assert min(parts) > 0


def test_the_diameter_holds_what_responses_move_and_nothing_else_changes():
    rng, moved_px = np.random.default_rng(8), 0.25
    inward = np.full((2, 2), -moved_px)
    seen = edges_of(rng, [TWO] * 14, *poses(rng, 14), shading_px=inward)
    plain = check_shaft(seen, TWO, spread(TWO))
    held = check_shaft(seen, TWO, spread(TWO), outward_px=[moved_px, moved_px])
    assert plain.diameter.value_mm < DIAMETER_MM - 10 * plain.diameter.u_mm
    assert held.diameter.value_mm == pytest.approx(plain.diameter.value_mm)
    # The error is one standard uncertainty of the response; the rest of u is far smaller.
    off = DIAMETER_MM - held.diameter.value_mm
    rest = plain.diameter.u_mm
    assert off == pytest.approx(held.diameter.shading_u_mm, abs=4 * rest)
    one = check_shaft(seen, TWO, spread(TWO), outward_px=[moved_px, 0.0])
    assert rest < one.diameter.u_mm < held.diameter.u_mm


def test_a_pose_with_one_wrong_edge_is_named_and_no_other():
    rng = np.random.default_rng(3)
    wrong = np.zeros((14, 2, 2))
    wrong[9, 1, 0] = 0.8  # half of it widens the shaft, by fourteen times its uncertainty
    check = check_shaft(
        edges_of(rng, [TWO] * 14, *poses(rng, 14), wrong_px=wrong), TWO, spread(TWO)
    )
    assert np.flatnonzero(check.chi_squares > check.limits).tolist() == [9]


def test_another_rod_in_one_camera_is_told_by_its_width():
    rng = np.random.default_rng(4)
    diameters = np.full((14, 2), DIAMETER_MM)
    diameters[6, 0] = 9.6
    seen = edges_of(rng, [TWO] * 14, *poses(rng, 14), diameters=diameters)
    check = check_shaft(seen, TWO, None)
    assert np.flatnonzero(check.chi_squares > check.limits).tolist() == [6]


@pytest.mark.parametrize(("rig", "degrees", "who"), [(TWO, 3.0, ""), (THREE, 0.05, "third")])
def test_a_camera_that_moves_during_the_session_is_told_with_the_moment(rig, degrees, who):
    rng = np.random.default_rng(5)
    rigs = [rig] * 12 + [turned(rig, rig.cameras[-1].name, degrees)] * 8
    check = check_shaft(edges_of(rng, rigs, *poses(rng, 20)), rig, spread(rig, 0.1))
    assert check.change.significant
    assert (check.change.camera, check.change.pose) == (who, 12)


def test_a_wrong_calibration_is_told_unless_its_own_uncertainty_explains_it():
    rng = np.random.default_rng(6)
    seen = edges_of(rng, [turned(TWO, "right", 1.0)] * 16, *poses(rng, 16))
    check = check_shaft(seen, TWO, spread(TWO, 0.1))
    assert check.moved.significant
    assert not check.change.significant
    assert not (check.chi_squares > check.limits).any()
    assert not check_shaft(seen, TWO, spread(TWO, 80.0)).moved.significant


def test_noise_beyond_the_stated_is_a_factor_and_no_alarm():
    rng = np.random.default_rng(7)
    seen = edges_of(rng, [TWO] * 30, *poses(rng, 30))
    for pose in seen:
        for one in pose:
            one.normals_covariance /= 9
    check = check_shaft(seen, TWO, spread(TWO))
    # The median of 30 χ² with 4 degrees of freedom tells the factor to about 12 %.
    assert check.scatter == pytest.approx(3.0, rel=0.5)
    assert not (check.chi_squares > check.limits).any()


def test_edges_of_another_rig_are_refused():
    rng = np.random.default_rng(8)
    seen = edges_of(rng, [THREE] * 5, *poses(rng, 5))
    with pytest.raises(ShapeError, match="edges of camera third"):
        check_shaft(seen, TWO, None)
