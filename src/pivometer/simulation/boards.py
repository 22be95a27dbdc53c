"""Calibration boards: their pattern, their image, and where they are held."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats, read_only
from pivometer.cameras import Camera, Rig
from pivometer.errors import UsageError
from pivometer.geometry import RigidTransform
from pivometer.simulation.optics import Rays, coverage, edge_at
from pivometer.simulation.shapes import NEAR_MM, Lighting, Painted

RIM_ALBEDO = 0.10
"""Reflectance of the backing plate that shows around the paper."""


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """What is printed on a board.

    The board's frame: origin at inner corner 0, x across, y down, z away from the viewer, mm. The
    top-left square is black; ChArUco markers stand in the white squares, numbered row by row.

    Parameters
    ----------
    kind
        ``"checkerboard"`` or ``"charuco"``.
    squares
        Squares across and down.
    square_mm
        Side of a square, mm.
    dictionary
        Name of the ChArUco dictionary, e.g. ``"DICT_4X4_50"``.
    marker_mm
        Side of a ChArUco marker, mm.
    margin_mm
        White paper around the squares, mm.
    black, white
        Reflectances of ink and paper.
    """

    kind: str = "checkerboard"
    squares: tuple[int, int] = (9, 7)
    square_mm: float = 15.0
    dictionary: str = "DICT_4X4_50"
    marker_mm: float | None = None
    margin_mm: float | None = None
    black: float = 0.04
    white: float = 0.75

    def __post_init__(self) -> None:
        if self.kind not in ("checkerboard", "charuco") or min(self.squares) < 3:
            raise UsageError(
                f"a board of kind {self.kind!r} with {self.squares} squares",
                next_step='take "checkerboard" or "charuco" with at least 3 × 3 squares',
            )

    @property
    def marker(self) -> float:
        """Side of a ChArUco marker, mm."""
        return 0.74 * self.square_mm if self.marker_mm is None else self.marker_mm

    @property
    def margin(self) -> float:
        """White paper around the squares, mm."""
        return 0.6 * self.square_mm if self.margin_mm is None else self.margin_mm

    def corners_mm(self) -> Floats:
        """Return the inner corners in the board's frame, shape (n, 3), mm, row by row."""
        across, down = self.squares
        y, x = np.mgrid[: down - 1, : across - 1]
        corners = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
        return read_only(corners * self.square_mm)

    def outline_mm(self, margin_mm: float) -> Floats:
        """Return the four corners of the squares' area widened by a margin, shape (4, 3), mm."""
        across, down = self.squares
        low, s = -self.square_mm - margin_mm, self.square_mm
        right, bottom = (across - 1) * s + margin_mm, (down - 1) * s + margin_mm
        return read_only([[low, low, 0], [right, low, 0], [right, bottom, 0], [low, bottom, 0]])

    def albedo(self) -> tuple[Floats, Floats, Floats]:
        """Return the pattern as a table: breaks along x and y (mm), and albedo between them."""
        cells = self._module_table()
        breaks = [self._breaks(count) for count in self.squares]
        pad = np.pad(cells, 1, constant_values=self.white)
        pad = np.pad(pad, 1, constant_values=RIM_ALBEDO)
        return breaks[0], breaks[1], pad

    def _modules(self) -> int:
        """Return into how many strips a square is divided: 1, or margin, modules, margin."""
        if self.kind == "checkerboard":
            return 1
        return 2 + len(marker_bits(self.dictionary, 0))

    def _breaks(self, count: int) -> Floats:
        inner = np.zeros(1)
        if self.kind == "charuco":
            edge = (self.square_mm - self.marker) / 2
            inner = np.append(0.0, np.linspace(edge, self.square_mm - edge, self._modules() - 1))
        starts = self.square_mm * (np.arange(count) - 1)
        lines = np.append((starts[:, None] + inner).ravel(), self.square_mm * (count - 1))
        low, high = lines[0] - self.margin, lines[-1] + self.margin
        rim = self.margin / 3
        return np.concatenate([[low - rim, low], lines, [high, high + rim]])

    def _module_table(self) -> Floats:
        across, down = self.squares
        parity = np.add.outer(np.arange(down), np.arange(across)) % 2
        n = self._modules()
        table = np.where(np.kron(parity, np.ones((n, n))) == 0, self.black, self.white)
        if self.kind == "charuco":
            for number, (row, column) in enumerate(np.argwhere(parity == 1)):
                bits = marker_bits(self.dictionary, number)
                corner = (slice(row * n + 1, row * n + n - 1), slice(column * n + 1, None))
                table[corner][:, : n - 2] = np.where(bits, self.white, self.black)
        return table


def marker_bits(dictionary: str, number: int) -> NDArray[np.bool_]:
    """Return a marker as printed, True where white, with its one-module black border."""
    import cv2

    table = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    side = table.markerSize + 2
    picture = np.asarray(table.generateImageMarker(number, side))
    return picture > 127


@dataclass(frozen=True, slots=True, eq=False)
class BoardShape:
    """A board as the renderer paints it.

    Parameters
    ----------
    pattern
        What is printed on it.
    camera_from_board
        Where it is.
    lighting
        The lamps in the camera's frame.
    flat
        Whether radiance is the albedo itself, whatever the light.
    """

    pattern: Pattern
    camera_from_board: RigidTransform
    lighting: Lighting
    flat: bool = False
    _tables: tuple[Floats, Floats, Floats] = field(init=False)
    _board_from_ray: Floats = field(init=False)

    def __post_init__(self) -> None:
        R, t = self.camera_from_board.rotation, self.camera_from_board.translation_mm
        x, y, albedo = self.pattern.albedo()
        light = 1.0 if self.flat else float(self.lighting.irradiance(-R[:, 2]))
        object.__setattr__(self, "_tables", (x, y, np.pad(light * albedo, 1)))
        object.__setattr__(self, "_board_from_ray", np.linalg.inv(np.column_stack([R[:, :2], t])))

    def outline_mm(self) -> Floats:
        """Return the corners of the backing plate."""
        outline = self.camera_from_board @ self.pattern.outline_mm(1.34 * self.pattern.margin)
        return outline[outline[:, 2] > NEAR_MM]

    def paint(self, rays: Rays, cell: float) -> Painted:
        """Return coverage, radiance and edge flags of the cells."""
        H = self._board_from_ray
        u, v, w = (row[0] * rays.x + row[1] * rays.y + row[2] for row in H)
        u, v = u / w, v / w
        column, right, off_u = _nearest(self._tables[0], u, H[0], H[2], w, rays, cell)
        row, below, off_v = _nearest(self._tables[1], v, H[1], H[2], w, rays, cell)
        table = self._tables[2]
        value = (table[row, column] * (1 - right) + table[row, column + 1] * right) * (1 - below)
        value += (table[row + 1, column] * (1 - right) + table[row + 1, column + 1] * right) * below
        share = _inside(column, right, table.shape[1]) * _inside(row, below, table.shape[0])
        edge = ((off_u < 0.75 * cell) | (off_v < 0.75 * cell)) & (share > 0)
        return share, value / np.maximum(share, 1e-12), edge


def _nearest(
    breaks: Floats, place: Floats, row: Floats, scale: Floats, w: Floats, rays: Rays, cell: float
) -> tuple[NDArray[np.intp], Floats, Floats]:
    """Return the strip before the nearest break, how far a cell lies beyond it, and how near."""
    after = np.searchsorted((breaks[1:] + breaks[:-1]) / 2, place)
    phi = place - breaks[after]
    edge = edge_at(rays, phi, (row[0] - place * scale[0]) / w, (row[1] - place * scale[1]) / w)
    return after, coverage(edge, cell), np.abs(edge.distance_px)


def _inside(index: NDArray[np.intp], beyond: Floats, length: int) -> Floats:
    """Return how much of a cell lies on the board rather than in the table's empty border."""
    first: Floats = np.where(index > 0, 1 - beyond, 0.0)
    return first + np.where(index + 1 < length - 1, beyond, 0.0)


def fits(
    pattern: Pattern, camera: Camera, camera_from_board: RigidTransform, border_px: float
) -> bool:
    """Return whether all squares and some white around them lie in the image, seen from the front.

    A board seen at more than 65° from its normal does not fit either: its squares run together.
    """
    corners = camera_from_board @ pattern.outline_mm(0.35 * pattern.square_mm)
    if (corners[:, 2] <= NEAR_MM).any():
        return False
    middle = corners.mean(axis=0)
    facing = camera_from_board.rotation[:, 2] @ middle / np.linalg.norm(middle)
    if facing < np.cos(np.radians(65)):
        return False
    pixels = camera.project(corners)
    size = np.array([camera.width, camera.height]) - 1
    return bool((pixels >= border_px).all() and (pixels <= size - border_px).all())


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Where boards are held for the calibration views.

    Parameters
    ----------
    middle_mm, spread_mm
        Middle and half extent of the region the boards' centres come from, reference frame,
        shape (3,), mm.
    tilt_deg
        How far boards lean from facing between the cameras (pairs) or the camera (singles).
    border_px
        How near to the image's border the outermost squares may come.
    """

    middle_mm: Floats
    spread_mm: Floats
    tilt_deg: float = 22.0
    border_px: float = 8.0


def pair_poses(
    pattern: Pattern, rig: Rig, placement: Placement, count: int, rng: np.random.Generator
) -> list[RigidTransform]:
    """Return `reference_from_board` of boards that every camera sees whole, spread apart.

    Raises
    ------
    UsageError
        If the cameras have no room in common for the board.
    """
    cameras_from_reference = [t.inverse() for t in rig.reference_from_camera]

    def draw() -> tuple[RigidTransform, Floats] | None:
        centre = placement.middle_mm + placement.spread_mm * rng.uniform(-1, 1, 3)
        sights = [centre - t.translation_mm for t in rig.reference_from_camera]
        towards = np.sum([sight / np.linalg.norm(sight) for sight in sights], axis=0)
        pose = _held(pattern, centre, towards, placement.tilt_deg, rng)
        seen = [
            (camera, transform @ pose)
            for camera, transform in zip(rig.cameras, cameras_from_reference, strict=True)
        ]
        if not all(fits(pattern, camera, view, placement.border_px) for camera, view in seen):
            return None
        return pose, np.concatenate([_feature(pattern, camera, view) for camera, view in seen])

    return _spread(draw, count)


def single_poses(
    pattern: Pattern, camera: Camera, distance_mm: float, count: int, rng: np.random.Generator
) -> list[RigidTransform]:
    """Return `camera_from_board` of boards one camera sees whole, reaching its image's corners.

    Raises
    ------
    UsageError
        If the board does not fit into the image at this distance.
    """

    def draw() -> tuple[RigidTransform, Floats] | None:
        pixel = rng.uniform(0.1, 0.9, 2) * [camera.width, camera.height]
        sight = np.append(camera.normalized_from_pixels(pixel), 1.0)
        centre = sight * distance_mm * rng.uniform(0.75, 1.35)
        pose = _held(pattern, centre, sight, 45.0, rng)
        if not fits(pattern, camera, pose, 4.0):
            return None
        return pose, _feature(pattern, camera, pose)

    return _spread(draw, count)


def _held(
    pattern: Pattern, centre: Floats, towards: Floats, tilt_deg: float, rng: np.random.Generator
) -> RigidTransform:
    """Return a board around `centre`, leaning at most `tilt_deg` from facing along `towards`."""
    z = towards / np.linalg.norm(towards)
    x = np.array([z[2], 0.0, -z[0]]) / np.hypot(z[0], z[2])
    facing = np.column_stack([x, np.cross(z, x), z])
    heading, lean = rng.uniform(0, 2 * np.pi), np.radians(tilt_deg) * np.sqrt(rng.uniform())
    roll = rng.uniform(-0.35, 0.35)
    c, s = np.cos(lean), np.sin(lean)
    leaning = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    turn = facing @ _about_z(heading) @ leaning @ _about_z(roll - heading)
    across, down = pattern.squares
    middle = 0.5 * pattern.square_mm * np.array([across - 2, down - 2, 0.0])
    return RigidTransform(turn, centre - turn @ middle)


def _about_z(angle_rad: float) -> Floats:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _feature(pattern: Pattern, camera: Camera, view: RigidTransform) -> Floats:
    """Return what tells views apart: place in the image, size, and lean, each about 0 to 1."""
    corners = view @ pattern.outline_mm(0.0)
    pixels = camera.project(corners) / camera.width
    size = np.sqrt(np.linalg.det(np.cov(pixels.T)) + 1e-12)
    return np.concatenate([2 * pixels.mean(axis=0), [8 * size], 0.8 * view.rotation[:2, 2]])


def _spread(
    draw: Callable[[], tuple[RigidTransform, Floats] | None], count: int
) -> list[RigidTransform]:
    """Return `count` of many drawn poses, each farthest from those before it."""
    if count == 0:
        return []
    drawn: list[tuple[RigidTransform, Floats]] = []
    attempts = 200 + 40 * count
    for _ in range(attempts):
        pose = draw()
        if pose is not None:
            drawn.append(pose)
        if len(drawn) == 5 * count:
            break
    if len(drawn) < count:
        raise UsageError(
            f"only {len(drawn)} of {attempts} places hold the whole board in view, "
            f"{count} are wanted",
            next_step="take a smaller board or fewer views",
        )
    features = np.array([feature for _, feature in drawn])
    chosen = [int(np.argmin(np.linalg.norm(features - features.mean(axis=0), axis=1)))]
    gap = np.linalg.norm(features - features[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(gap)))
        gap = np.minimum(gap, np.linalg.norm(features - features[chosen[-1]], axis=1))
    return [drawn[k][0] for k in chosen]
