"""The cylinder behind all edges: derivatives, exactness, its covariance and what is left over."""

import numpy as np
import pytest
from scipy import stats

from pivometer.errors import DegenerateGeometryError, ShapeError
from pivometer.geometry import RigidTransform, tangent_plane_normals
from pivometer.geometry.cylinder import tangent_planes
from pivometer.shaft.cylinder_fit import fit_cylinders, perpendicular_bases
from pivometer.shaft.triangulation import lines_from_edge_normals

RADIUS_MM = 5.0
TARGET = np.array([6.0, 65.0, 478.0])
FOCAL_PX, LENGTH_PX = 1000.0, 350.0


def looking_at(centre, target):
    """Reference-from-camera transform of a camera at `centre` that looks at `target`."""
    z = (np.asarray(target) - centre) / np.linalg.norm(np.asarray(target) - centre)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return RigidTransform(np.stack([x, np.cross(z, x), z], axis=1), centre)


TWO = [RigidTransform.identity(), looking_at([420.0, 10.0, 320.0], TARGET)]
THREE = [*TWO, looking_at([50.0, -390.0, 400.0], TARGET)]


def axes(rng, count):
    direction = np.array([0.0, -1.0, 0.0]) + 0.2 * rng.normal(size=(count, 3))
    return TARGET + 20 * rng.normal(size=(count, 3)), direction / np.linalg.norm(
        direction, axis=1, keepdims=True
    )


def edges(points, directions, transforms, radius=RADIUS_MM):
    return np.array(
        [
            [
                tangent_plane_normals(
                    back @ point,
                    back.rotate(direction),
                    np.broadcast_to(radius, len(transforms))[c],
                )
                for c, back in enumerate(x.inverse() for x in transforms)
            ]
            for point, direction in zip(points, directions, strict=True)
        ]
    )


def noisy(rng, normals, sigma_px):
    """Shift and turn each edge as a fit to `LENGTH_PX` of it would; return its covariance too."""
    ray = np.array([0.0, 0.0, 1.0]) - normals[..., 2:] * normals
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    shift = ray * np.broadcast_to(sigma_px, normals.shape[:-1])[..., None] / FOCAL_PX
    turn = np.cross(normals, shift) * np.sqrt(12) * FOCAL_PX / LENGTH_PX
    roots = np.stack([shift, turn], axis=-1)
    moved = normals + (roots @ rng.normal(size=(*normals.shape[:-1], 2, 1)))[..., 0]
    covariances = np.zeros((*normals.shape[:2], 6, 6))
    for edge in range(2):
        at = slice(3 * edge, 3 * edge + 3)
        covariances[..., at, at] = (roots @ np.swapaxes(roots, -1, -2))[..., edge, :, :]
    return moved / np.linalg.norm(moved, axis=-1, keepdims=True), covariances


def displacement(fits, points, directions):
    """Offsets (mm) and slopes (rad) of the true axes along the bases of the fitted ones."""
    along = np.vecdot(points - fits.points_mm, fits.directions) / np.vecdot(
        directions, fits.directions
    )
    offsets = points - along[:, None] * directions - fits.points_mm
    slopes = directions / np.vecdot(directions, fits.directions)[:, None]
    return np.concatenate(
        [np.einsum("nki,ni->nk", fits.bases, x) for x in (offsets, slopes)], axis=1
    )


def test_batched_planes_are_those_of_the_single_function():
    points, directions = axes(np.random.default_rng(1), 4)
    centres = np.stack([x.translation_mm for x in THREE])
    found, _ = tangent_planes(
        points, directions, np.full(4, RADIUS_MM), centres, perpendicular_bases(directions)
    )
    for i, (point, direction) in enumerate(zip(points, directions, strict=True)):
        for c, centre in enumerate(centres):
            assert np.allclose(
                found[i, c], tangent_plane_normals(point - centre, direction, RADIUS_MM), atol=1e-14
            )


def test_slopes_are_the_central_differences():
    points, directions = axes(np.random.default_rng(2), 5)
    bases = perpendicular_bases(directions)
    centres = np.stack([x.translation_mm for x in THREE])
    radii = np.linspace(0.5, 40, 5)
    _, slopes = tangent_planes(points, directions, radii, centres, bases)
    for k, step in enumerate([1e-3, 1e-3, 1e-5, 1e-5, 1e-3]):
        ends = []
        for s in (step, -step):
            p = points + s * bases[:, k] if k < 2 else points
            d = directions + s * bases[:, k - 2] if 2 <= k < 4 else directions
            d = d / np.linalg.norm(d, axis=1, keepdims=True)
            r = radii + s if k == 4 else radii
            ends.append(tangent_planes(p, d, r, centres, bases)[0])
        numeric = (ends[0] - ends[1]) / (2 * step)
        # Truncation is (step / distance)² and rounding 1e-16 / step, relative to the slope.
        assert np.abs(slopes[..., k] - numeric).max() < 1e-6 * np.abs(numeric).max()


@pytest.mark.parametrize("radius", [RADIUS_MM, "common", "free"])
@pytest.mark.parametrize("transforms", [TWO, THREE])
def test_noiseless_edges_give_the_cylinder_back(transforms, radius):
    rng = np.random.default_rng(3)
    points, directions = axes(rng, 12)
    normals = edges(points, directions, transforms)
    _, covariances = noisy(rng, normals, 0.02)
    normals[::2, 1] = normals[::2, 1, ::-1]  # which edge comes first does not matter
    seen = np.ones((12, len(transforms)), bool)
    seen[3:5, 2:] = False
    normals[3:5, 2:] = [0.0, 1.0, 0.0]
    fits = fit_cylinders(normals, covariances, transforms, radius_mm=radius, seen=seen)
    assert fits.converged.all()
    assert np.abs(displacement(fits, points, directions)).max() < 1e-9
    assert np.abs(fits.radii_mm - RADIUS_MM).max() < 1e-9
    assert np.vecdot(fits.directions, directions).min() > 0
    assert np.abs(np.vecdot(fits.points_mm, fits.directions)).max() < 1e-9
    assert fits.chi_squares.max() < 1e-12


@pytest.mark.parametrize(
    ("transforms", "radius", "freedom"),
    [(TWO, RADIUS_MM, 4), (TWO, "common", 4), (TWO, "free", 3), (THREE, "common", 8)],
)
def test_what_is_left_is_chi_square_and_errors_are_as_stated(transforms, radius, freedom):
    rng = np.random.default_rng(4)
    points, directions = axes(rng, 400)
    sigma = 0.02 * 10 ** rng.uniform(0, 0.7, (400, len(transforms), 2))
    normals, covariances = noisy(rng, edges(points, directions, transforms), sigma)
    fits = fit_cylinders(normals, covariances, transforms, radius_mm=radius)
    errors = displacement(fits, points, directions)
    square = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(fits.covariances), errors)
    # Each fails once in 10 000 seeds; the one common radius takes 1 of 1600 degrees of freedom.
    assert stats.kstest(square, stats.chi2(4).cdf).pvalue > 1e-4
    assert stats.kstest(fits.chi_squares, stats.chi2(freedom).cdf).pvalue > 1e-4
    if radius == "common":
        assert abs(fits.radii_mm[0] - RADIUS_MM) < 3.9 * fits.radii_u_mm[0]


def test_unequal_edges_are_weighted_and_a_width_seen_wrong_by_all_does_no_harm():
    """Where one edge is five times worse, the better one and the common radius decide."""
    rng = np.random.default_rng(5)
    points, directions = axes(rng, 200)
    sigma = np.full((200, 2, 2), 0.01)
    sigma[np.arange(200)[:, None], np.arange(2), rng.integers(0, 2, (200, 2))] = 0.05
    normals, covariances = noisy(rng, edges(points, directions, TWO, RADIUS_MM * 1.005), sigma)
    fits = fit_cylinders(normals, covariances, TWO, radius_mm="common")
    papers = lines_from_edge_normals(normals, TWO)[:2]
    ours = np.square(displacement(fits, points, directions)[:, :2]).sum()
    as_fits = displacement(fits, *papers) - displacement(fits, points, directions)
    assert 4 * ours < np.square(as_fits[:, :2]).sum()


def test_a_known_radius_determines_a_pose_in_one_plane_with_the_cameras():
    baseline = TWO[1].translation_mm / np.linalg.norm(TWO[1].translation_mm)
    flat = np.cross(baseline, TARGET)
    direction = np.cross(flat, baseline) / np.linalg.norm(flat)
    points, directions = np.tile(TARGET, (300, 1)), np.tile(direction, (300, 1))
    rng = np.random.default_rng(6)
    normals, covariances = noisy(rng, edges(points, directions, TWO), 0.02)
    fits = fit_cylinders(normals, covariances, TWO, radius_mm=RADIUS_MM)
    errors = displacement(fits, points, directions)
    # The depth follows from a width of 20 px alone, so it is 40 times worse than across.
    ratio = np.square(errors).mean(axis=0) / np.einsum("nii->ni", fits.covariances).mean(axis=0)
    assert np.abs(ratio - 1).max() < 4 * np.sqrt(2 / 300)
    assert np.sqrt(np.square(errors[:, :2]).sum(axis=1).mean()) > 0.1


def test_what_cannot_be_is_refused():
    rng = np.random.default_rng(7)
    points, directions = axes(rng, 2)
    normals = edges(points, directions, TWO)
    _, covariances = noisy(rng, normals, 0.02)
    with pytest.raises(ShapeError, match="two cameras in every pose"):
        fit_cylinders(
            normals, covariances, TWO, radius_mm="free", seen=[[True, False], [True, True]]
        )
    with pytest.raises(ShapeError, match="not positive definite"):
        fit_cylinders(normals, 0 * covariances, TWO, radius_mm="free")
    with pytest.raises(DegenerateGeometryError, match="do not determine the cylinder"):
        fit_cylinders(normals, covariances, TWO, radius_mm=600.0)
