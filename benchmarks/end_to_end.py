"""The apparent rms of a perfect RCM, pixels to result, beside its Cramér–Rao bound.

Run with ``python -m benchmarks.end_to_end [SESSIONS]``. Two known cameras see a 10 mm shaft in 20
poses that all pass one point exactly. Every image is rendered in closed form (`shaft_edges`), so
the bound of both its edges is known; carried through triangulation to the sum of squared misses,
tr(RS), it is the least mean square that any unbiased method can show. Noise is drawn anew in every
session; the edges are fitted, triangulated and solved as `measure` does it.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.shaft_edges.scenes import (
    Geometry,
    Look,
    Scene,
    bound_covariance,
    ends,
    exposed,
    middle_of,
    pixel_grid,
    render,
)
from pivometer.cameras import Rig
from pivometer.geometry import RigidTransform, tangent_plane_normals
from pivometer.rcm import least_squares_rcm
from pivometer.shaft.edges import fit_edges
from pivometer.shaft.seed import ShaftSeed
from pivometer.shaft.silhouette import coimage_normal, outward_normals
from pivometer.shaft.triangulation import triangulate_centerline
from pivometer.simulation.robots import cone_directions
from pivometer.uncertainty.intrinsic import noise_effects
from pivometer.uncertainty.line_errors import Noise

Floats = NDArray[np.float64]

SESSIONS, POSES = 20, 20
SIZE, RADIUS_MM, RCM_MM = (640, 480), 5.0, np.array([0.0, 0.0, 500.0])
LOOKS = {
    "clean: contrast 160, blur .8, noise 2": Look(lambda xi: 200 + 0 * xi, 40.0, 0.8, 2.0),
    "faint: contrast 40, blur 1.5, noise 5": Look(lambda xi: 120 + 0 * xi, 80.0, 1.5, 5.0),
}
STEPS = (1e-3, 1e-6)
"""Half the central differences of an edge's offset (px) and angle (rad)."""


def rig() -> Rig:
    """Return two cameras 66° apart that look at the RCM, named apart but alike."""
    camera = pixel_grid(SIZE, ())[0]
    turn = RigidTransform.from_rotation_vector([0, -np.radians(66), 0], [0, 0, 0]).rotation
    second = RigidTransform(turn, RCM_MM - turn @ RCM_MM)
    return Rig([camera, replace(camera, name="b")], [RigidTransform.identity(), second])


def geometry_of(cameras: Rig, place: int, axis: Floats) -> Geometry:
    """Return both edges of the shaft through the RCM along `axis`, in undistorted px."""
    camera_from = cameras.reference_from_camera[place].inverse()
    base, direction = camera_from @ RCM_MM, camera_from.rotate(axis)
    normals, offsets = [], []
    for plane in tangent_plane_normals(base, direction, RADIUS_MM):
        line = plane / cameras.cameras[place].focal_px[0]
        scale = np.hypot(line[0], line[1])
        normal = line[:2] / scale
        normals.append(normal)
        offsets.append(normal @ cameras.cameras[place].principal_point_px - plane[2] / scale)
    return Geometry(np.array(normals), np.array(offsets))


def normals_of(scene: Scene) -> Floats:
    """Return the coimage normals of a scene's edges, shape (2, 3)."""
    camera = scene.camera
    rays = [
        (ends(camera, scene.geometry, edge) - camera.principal_point_px) / camera.focal_px
        for edge in range(2)
    ]
    directions, middles = np.array([[r[1] - r[0], r.mean(axis=0)] for r in rays]).swapaxes(0, 1)
    inside = np.append(middles.mean(axis=0), 1.0)
    return outward_normals(coimage_normal(directions, middles), inside)


def bound_of_normals(scene: Scene) -> Floats:
    """Return the Cramér–Rao bound of both normals, shape (6, 6)."""
    jacobian = np.zeros((6, 4))
    for edge in range(2):
        about = middle_of(scene, edge)
        for k, step in enumerate(STEPS):
            ahead, back = (
                normals_of(replace(scene, geometry=scene.geometry.moved(edge, *move, about)))
                for move in (
                    (step * (k == 0), step * (k == 1)),
                    (-step * (k == 0), -step * (k == 1)),
                )
            )
            jacobian[:, 2 * edge + k] = ((ahead - back) / (2 * step)).ravel()
    return np.asarray(jacobian @ bound_covariance(scene) @ jacobian.T)


def scenes_of(look: Look, cameras: Rig) -> list[list[Scene]]:
    """Return the scene of every pose in every camera, without noise."""
    upright = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # the cone's axis along the images
    made = []
    for axis in cone_directions(POSES, 57.0) @ upright.T:
        pose = []
        for place, camera in enumerate(cameras.cameras):
            g = geometry_of(cameras, place, axis)
            clean = render((SIZE, ()), g, look)
            seed = np.stack([ends(camera, g, edge) for edge in range(2)])
            pose.append(Scene(camera, g, look, clean, clean.astype(np.uint8), None, seed))
        made.append(pose)
    return made


def compare(name: str, look: Look, sessions: int) -> None:
    """Print what a perfect RCM reads, and the bound."""
    cameras = rig()
    scenes = scenes_of(look, cameras)
    transforms = list(cameras.reference_from_camera)
    exact = [
        triangulate_centerline(
            np.stack([normals_of(scene) for scene in pose]),
            transforms,
            covariances=np.stack([bound_of_normals(scene) for scene in pose]),
        )
        for pose in scenes
    ]
    points, axes = np.stack([c.point_mm for c in exact]), np.stack([c.direction for c in exact])
    alone = np.stack([c.position_covariance_mm2(RCM_MM) for c in exact])
    (effect,) = noise_effects(points, axes, [Noise(alone, np.zeros((POSES, 3, 0)))])
    least = effect.squares_mm2
    squares = []
    for number in range(sessions):
        random = np.random.default_rng([number, 7])
        lines = [
            triangulate_centerline(np.stack([_fitted(scene, random) for scene in pose]), transforms)
            for pose in scenes
        ]
        found = least_squares_rcm([c.point_mm for c in lines], [c.direction for c in lines])
        squares.append(float(found.distances_mm @ found.distances_mm))
    ratio = np.sqrt(np.mean(squares) / least)
    chance = 1 / np.sqrt(2 * sessions * (2 * POSES - 3))
    print(
        f"{name:40}{np.sqrt(np.mean(squares) / POSES) * 1e3:12.3f}"
        f"{np.sqrt(least / POSES) * 1e3:12.3f}{ratio:9.3f} ± {chance:.3f}"
        f"   ≤ 1.1 {'pass' if ratio <= 1.1 else 'FAIL'}",
        flush=True,
    )


def _fitted(scene: Scene, random: np.random.Generator) -> Floats:
    """Return the normals of the edges fitted to the scene with new noise, from a rough start."""
    image = exposed(scene.clean, scene.look.noise, random)
    off = random.uniform(-1, 1, (2, 2, 1)) * scene.geometry.normals[:, None]
    return fit_edges(image, scene.camera, ShaftSeed(scene.seed_px + off)).normals


def main(sessions: int = SESSIONS) -> None:
    """Print a row for each look."""
    print(f"{sessions} sessions of {POSES} poses; exact geometry is solved to rounding")
    print(f"{'images':40}{'rms, µm':>12}{'bound, µm':>12}{'ratio':>9}")
    for name, look in LOOKS.items():
        compare(name, look, sessions)


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else SESSIONS)
