"""The renderer against exact geometry and against brute-force integration."""

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from pivometer.cameras import Camera
from pivometer.errors import UsageError
from pivometer.geometry import RigidTransform, tangent_plane_normals
from pivometer.simulation.boards import BoardShape, Pattern
from pivometer.simulation.optics import Edge, Sensor, coverage
from pivometer.simulation.render import Renderer
from pivometer.simulation.shapes import Box, Cylinder, Lighting, Material, Polygon, Sphere

CAMERA = Camera("left", 640, 480, [1012.4, 1009.1], [316.8, 243.9], [-0.205, 0.108])
LIGHT = Lighting(np.array([[-0.4, -0.7, -0.5]]), np.array([0.6]), 0.3)
FLAT = ((0.0, Material("flat", 0.8)),)
DARK = 0.1
SENSOR = Sensor(psf_sigma_px=0.6)


def shaft(direction, point=(6.4, 65.7, 478.3), bands=FLAT, span=(9.0, 150.0)):
    return Cylinder(np.array(point), np.array(direction), 5.0, span, bands, LIGHT)


def silhouette_px(cylinder, side):
    """Raw pixels of the line where a tangent plane touches the cylinder."""
    axis = cylinder.direction
    normal = tangent_plane_normals(cylinder.point_mm, axis, cylinder.radius_mm)[side]
    places = np.linspace(*cylinder.span_mm, 2000)[:, None]
    contact = cylinder.point_mm + cylinder.radius_mm * normal + places * axis
    return CAMERA.project(contact)


@pytest.mark.parametrize("angle", [0.0, 0.3, 0.9])
@pytest.mark.parametrize("cell", [1.0, 0.25])
def test_coverage_is_the_area_of_a_cut_square(angle, cell):
    grid = (np.arange(400) + 0.5) / 400 - 0.5
    u, v = np.meshgrid(cell * grid, cell * grid)
    for distance in np.linspace(-0.8, 0.8, 17) * cell:
        field = distance + u * np.cos(angle) + v * np.sin(angle)
        edge = Edge(*(np.array([k]) for k in (distance, np.cos(angle), np.sin(angle), 1.0)))
        # A 400 × 400 raster resolves a share to one of its 400 columns at worst.
        assert coverage(edge, cell)[0] == pytest.approx((field > 0).mean(), abs=1.3e-3)


@pytest.mark.parametrize(
    "direction", [(0.0, -1.0, 0.0), (0.02, -1.0, 0.0), (0.3, -0.9, -0.3), (-0.4, -0.85, 0.3)]
)
def test_flat_shaft_covers_the_exact_area_row_by_row(direction):
    cylinder = shaft(direction)
    image = Renderer(CAMERA, SENSOR, dark=DARK).radiance([cylinder])
    share = (image.astype(float) - DARK) / (0.8 - DARK)
    left, right = (silhouette_px(cylinder, side) for side in (0, 1))
    rows = np.arange(
        np.ceil(max(left[:, 1].min(), right[:, 1].min())) + 8,
        np.floor(min(left[:, 1].max(), right[:, 1].max())) - 8,
    ).astype(int)
    x_left, x_right = (np.interp(rows, e[::-1, 1], e[::-1, 0]) for e in (left, right))
    middle = np.rint((x_left + x_right) / 2).astype(int)
    found_left = [m + 0.5 - share[row, : m + 1].sum() for row, m in zip(rows, middle, strict=True)]
    found_right = [m + 0.5 + share[row, m + 1 :].sum() for row, m in zip(rows, middle, strict=True)]
    for found, true in ((found_left, x_left), (found_right, x_right)):
        error = np.array(found) - true
        assert abs(error.mean()) < 2e-4  # float32 radiance, an area of some 15 px
        assert np.sqrt((error**2).mean()) < 1e-3


@pytest.mark.parametrize("direction", [(0.05, -1.0, 0.0), (0.3, -0.9, -0.3), (0.7, -0.7, 0.1)])
def test_half_intensity_lies_on_the_true_silhouette(direction):
    cylinder = shaft(direction, point=(0.0, 20.0, 480.0), span=(-60.0, 60.0))
    image = Renderer(CAMERA, SENSOR, dark=DARK).radiance([cylinder]).astype(float)
    edge = silhouette_px(cylinder, 0)
    points = edge[400:1600:40]
    tangent = np.gradient(edge, axis=0)[400:1600:40]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    inside = np.sign(np.sum(normal * (silhouette_px(cylinder, 1)[400:1600:40] - points), axis=1))
    offsets = [
        fitted_offset(image, point, sign * n)
        for point, n, sign in zip(points, normal, inside, strict=True)
    ]
    assert abs(np.mean(offsets)) < 5e-4
    assert np.std(offsets) < 1.5e-3


def fitted_offset(image, point, normal):
    """Offset of an ideal blurred edge (Gaussian and box) that fits a 9 × 9 patch best."""
    column, row = np.rint(point).astype(int)
    v, u = np.mgrid[row - 4 : row + 5, column - 4 : column + 5].astype(float)
    patch = (image[row - 4 : row + 5, column - 4 : column + 5] - DARK) / (0.8 - DARK)
    sub = (np.arange(16) + 0.5) / 16 - 0.5
    shift = np.add.outer(sub * normal[1], sub * normal[0]).ravel()
    distance = (u - point[0]) * normal[0] + (v - point[1]) * normal[1]
    offset = 0.0
    for _ in range(6):
        argument = (distance[..., None] + shift - offset) / 0.6
        model = ndtr(argument).mean(axis=-1)
        slope = (np.exp(-0.5 * argument**2) / np.sqrt(2 * np.pi) / 0.6).mean(axis=-1)
        near = np.abs(distance) < 4
        offset -= float((slope * (patch - model))[near].sum() / (slope**2)[near].sum())
    return offset


def brute_force(shape, column, row, half, fine=40, psf=0.6):
    """Radiance of a patch by point samples on a fine grid, blurred there and averaged."""
    reach = half + 4
    coarse = np.arange(-reach - 1, reach + 2)
    u, v = np.meshgrid(column + coarse, row + coarse)
    xy = CAMERA.normalized_from_pixels(np.stack([u, v], axis=-1)).reshape(-1, 2)
    board = np.linalg.inv(
        np.column_stack(
            [shape.camera_from_board.rotation[:, :2], shape.camera_from_board.translation_mm]
        )
    )
    place = np.column_stack([xy, np.ones(len(xy))]) @ board.T
    place = place[:, :2] / place[:, 2:]
    # From pixel to pixel the board's coordinates are linear to 1e-4 px.
    offset = (np.arange((2 * reach + 1) * fine) + 0.5) / fine - 0.5 - reach
    weights = np.maximum(1 - np.abs(offset[:, None] - coarse), 0)
    place = weights @ place.reshape(len(coarse), len(coarse), 2).transpose(2, 0, 1) @ weights.T
    x, y, table = shape.pattern.albedo()
    samples = table[np.searchsorted(y, place[1]) - 1, np.searchsorted(x, place[0]) - 1]
    samples = cv2.GaussianBlur(samples, (0, 0), psf * fine, borderType=cv2.BORDER_REPLICATE)
    side = 2 * reach + 1
    pixels = samples.reshape(side, fine, side, fine).mean(axis=(1, 3))
    return pixels[4:-4, 4:-4]


@pytest.mark.parametrize("kind", ["checkerboard", "charuco"])
def test_board_corners_match_brute_force(kind):
    pattern = Pattern(kind=kind, marker_mm=11.0)
    turn = RigidTransform.from_rotation_vector([0.2, 0.6, 0.1], [-50.0, -35.0, 430.0])
    shape = BoardShape(pattern, turn, LIGHT, flat=True)
    image = Renderer(CAMERA, SENSOR).radiance([shape]).astype(float)
    corners = CAMERA.project(turn @ pattern.corners_mm())
    apart = []
    for corner in corners[[0, 14, 33, 47]]:
        column, row = np.rint(corner).astype(int)
        wanted = brute_force(shape, column, row, 7)
        got = image[row - 7 : row + 8, column - 7 : column + 8]
        # Edge cells widen an edge by up to h²/6 more or less than on average, h = 1/4 px: that
        # is 2.8e-3 of the step at most where the blurred edge bends most, PSF 0.6 px.
        assert np.abs(got - wanted).max() < 2 * 2.8e-3 * 0.71
        apart.append(located(got) - located(wanted))
        if kind == "checkerboard":  # a marker beside the corner draws cornerSubPix aside
            assert np.abs(located(got) + np.array([column - 7, row - 7]) - corner).max() < 0.03
    assert np.abs(np.mean(apart, axis=0)).max() < 1e-3
    assert np.abs(apart).max() < 3e-3


def located(patch):
    start = np.array([[[7.0, 7.0]]], dtype=np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-6)
    scaled = (255 * patch).astype(np.float32)
    return cv2.cornerSubPix(scaled, start, (5, 5), (-1, -1), criteria)[0, 0].astype(float)


def test_shapes_without_seams_and_in_range():
    turned = RigidTransform.from_rotation_vector([0.4, 0.5, 0.2], [0.0, 0.0, 450.0])
    box = Box(turned, np.array([40.0, 30.0, 20.0]), Material("flat", 0.5), LIGHT)
    image = Renderer(CAMERA, SENSOR, dark=0.5).radiance([box])
    assert np.abs(image - 0.5).max() < 1e-6
    ball = Sphere(np.array([10.0, -5.0, 450.0]), 20.0, Material("flat", 0.9), LIGHT)
    image = Renderer(CAMERA, SENSOR, dark=0.0).radiance([ball])
    # The outline of a ball is a circular cone: its pixel area from the ellipse, undistorted.
    plain = Camera("plain", 640, 480, [1000, 1000], [320, 240], [0, 0])
    ball = Sphere(np.array([0.0, 0.0, 450.0]), 20.0, Material("flat", 0.9), LIGHT)
    area = Renderer(plain, SENSOR, dark=0.0).radiance([ball]).astype(float).sum() / 0.9
    assert area == pytest.approx(np.pi * 1000**2 * 20**2 / (450**2 - 20**2), rel=2e-5)


def test_shape_partly_behind_the_camera_is_clipped():
    floor = np.array([[-500.0, 40, -300], [500, 40, -300], [500, 40, 900], [-500, 40, 900]])
    image = Renderer(CAMERA, SENSOR, dark=0.0).radiance([Polygon(floor, 0.5)])
    assert image[-5:].min() > 0.499
    assert image[:200].max() < 1e-3


def test_sensor_noise_has_the_stated_variance():
    sensor = Sensor(full_well_e=20000.0, read_noise_e=40.0, pedestal=0.1, bits=16)
    image = sensor.expose(np.full((400, 400), 0.5, np.float32), np.random.default_rng(1))
    assert image.dtype == np.uint16
    electrons = image.astype(float) / 65535 * 20000
    # Standard errors: mean sd/400, variance sqrt(2)/400; four of them.
    variance = 0.5 * 20000 + 40**2
    assert electrons.mean() == pytest.approx(0.6 * 20000, abs=4 * np.sqrt(variance) / 400)
    assert electrons.var() == pytest.approx(variance, rel=4 * np.sqrt(2) / 400)


def test_sensor_without_noise_only_rounds():
    image = Sensor(noise=0.0, pedestal=0.0).expose(
        np.linspace(-0.1, 1.1, 100, dtype=np.float32), np.random.default_rng(0)
    )
    expected = np.rint(255 * np.linspace(-0.1, 1.1, 100)).clip(0, 255)
    assert image.dtype == np.uint8
    assert np.abs(image - expected).max() <= 1


def test_sensor_refuses_what_it_cannot_do():
    with pytest.raises(UsageError, match="12 bits"):
        Sensor(bits=12)
