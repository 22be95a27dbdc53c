"""The shaft while poses are taken: live edges, and the RCM of the poses so far.

The pictures on the disk tell how the shaft moves; a live picture is then searched alone. Poses
that were taken are fitted as `measure` fits them, once each.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration import Calibration
from pivometer.cameras import Camera
from pivometer.errors import DataError, PivometerError, ShaftNotFoundError
from pivometer.geometry.line import unit
from pivometer.io.images import HashedImage, Image
from pivometer.io.session import Session
from pivometer.measurement import ImportedRig, Measurement
from pivometer.pipeline.measuring import measure_edges
from pivometer.pipeline.reading import ReadImage, read
from pivometer.pipeline.shafts import SHAFT_ADVICE
from pivometer.shaft.background import sampled
from pivometer.shaft.detection import (
    LEAST_FRAMES,
    MOST_SAMPLES,
    SeedRejection,
    ShaftFinder,
    learn_shaft,
)
from pivometer.shaft.edges import ShaftEdges, edge_normals, fit_edges
from pivometer.shaft.triangulation import triangulate_centerline

RELEARN = 1.5
"""What moves is learned again when there are this many times the poses it was learned from."""
NEW_POSE_DEG = 2.0
"""A pose whose shaft is turned by less against one there is says little new: a fifteenth of the
paper's half cone."""


@dataclass(frozen=True, slots=True, eq=False)
class LivePose:
    """What one live moment shows of the shaft.

    Parameters
    ----------
    edges_px
        By camera that found it, both edges' ends, shape (2, 2, 2), raw px, good to about 2 px.
    reasons
        By camera that did not, why.
    direction
        The shaft's direction in the reference camera's frame, shape (3,), good to about a degree;
        `None` where fewer than two cameras found it.
    """

    edges_px: Mapping[str, Floats]
    reasons: Mapping[str, str]
    direction: Floats | None


class LiveShaft:
    """What is known of the shaft so far.

    Parameters
    ----------
    calibration
        Of the session's cameras.
    """

    def __init__(self, calibration: Calibration | ImportedRig) -> None:
        self.calibration = calibration
        self._finders: dict[str, ShaftFinder] = {}
        self._learned_from: dict[str, int] = {}
        self._seen: dict[str, dict[str, ShaftEdges | DataError]] = {}

    @property
    def ready(self) -> bool:
        """Whether the poses so far tell how the shaft moves, for every camera."""
        return len(self._finders) == len(self.calibration.rig.cameras)

    def follow(self, session: Session) -> None:
        """Take in the poses that came since: learn again where they are many, and fit them."""
        for camera in self.calibration.rig.cameras:
            files = list(session.shaft_images(camera.name))
            if len(files) < (1 if camera.name in session.hints else LEAST_FRAMES):
                continue
            if len(files) >= RELEARN * self._learned_from.get(camera.name, 0):
                self._learn(session, camera)
            seen = self._seen.setdefault(camera.name, {})
            for file in files:
                stem = file.view.rpartition("/")[2]
                if stem not in seen and camera.name in self._finders:
                    seen[stem] = self._fitted(read(file), camera)

    def _learn(self, session: Session, camera: Camera) -> None:
        """Learn how the shaft moves; what was not found before is then looked for again."""
        files = list(session.shaft_images(camera.name))
        reads = [read(files[i]) for i in sampled(len(files), MOST_SAMPLES)]
        size = (camera.width, camera.height)
        images = [_image(one) for one in reads if one.size == size]
        if not images:
            return
        hint = session.hints.get(camera.name)
        self._finders[camera.name] = learn_shaft(images, hint=hint)
        self._learned_from[camera.name] = len(files)
        known = self._seen.get(camera.name, {})
        self._seen[camera.name] = {k: v for k, v in known.items() if isinstance(v, ShaftEdges)}

    def _fitted(self, one: ReadImage, camera: Camera) -> ShaftEdges | DataError:
        try:
            if not isinstance(one.outcome, HashedImage):
                return one.outcome
            seed = self._finders[camera.name].find(one.outcome.image)
            if isinstance(seed, SeedRejection):
                return ShaftNotFoundError(seed.reason, next_step=SHAFT_ADVICE)
            return fit_edges(one.outcome.image, camera, seed)
        except DataError as error:
            return error.with_traceback(None)

    def glimpse(self, images: Mapping[str, Image]) -> LivePose:
        """Look for the shaft in one moment's pictures.

        Parameters
        ----------
        images
            By camera.
        """
        edges: dict[str, Floats] = {}
        reasons: dict[str, str] = {}
        rig = self.calibration.rig
        for camera in rig.cameras:
            if camera.name not in images or camera.name not in self._finders:
                continue
            if images[camera.name].shape != (camera.height, camera.width):
                reasons[camera.name] = "the pictures have another size than those calibrated with"
                continue
            seed = self._finders[camera.name].find(images[camera.name])
            if isinstance(seed, SeedRejection):
                reasons[camera.name] = seed.reason
            else:
                edges[camera.name] = seed.edges_px
        return LivePose(edges, reasons, self._direction(edges))

    def _direction(self, edges: Mapping[str, Floats]) -> Floats | None:
        rig = self.calibration.rig
        if len(edges) < 2:
            return None
        rows = [rig.index(name) for name in edges]
        normals = [edge_normals(edges[rig.cameras[i].name][None], rig.cameras[i])[0] for i in rows]
        try:
            line = triangulate_centerline(
                np.stack(normals), [rig.reference_from_camera[i] for i in rows]
            )
        except PivometerError:
            return None
        return line.direction

    def directions(self, session: Session) -> Floats:
        """Return the directions of the poses taken that count, shape (n, 3), reference frame."""
        found = [
            self._direction({edge.camera: edge.points_px[:, [0, -1]] for edge in seen})
            for stem in session.shaft
            if f"shaft/{stem}" not in session.excluded and len(seen := self._edges_of(stem)) > 1
        ]
        return np.array([d for d in found if d is not None]).reshape(-1, 3)

    def _edges_of(self, stem: str) -> list[ShaftEdges]:
        found = (seen.get(stem) for seen in self._seen.values())
        return [edges for edges in found if isinstance(edges, ShaftEdges)]

    def fault_of(self, stem: str) -> str | None:
        """Return why a pose that was taken does not count so far; `None` where nothing is wrong."""
        for name, seen in self._seen.items():
            if isinstance(fault := seen.get(stem), DataError):
                return f"camera {name}: {fault.what}"
        return None

    def measured(self, session: Session) -> Measurement:
        """Measure the RCM of the poses so far.

        Raises
        ------
        DataError
            If they cannot support an answer yet: its subclasses say why.
        """
        names = [camera.name for camera in self.calibration.rig.cameras]
        seen = {name: dict(self._seen.get(name, {})) for name in names}
        return measure_edges(session, self.calibration, seen, {})


def is_new_pose(direction: Floats, before: Floats) -> bool:
    """Tell whether a shaft is turned by at least `NEW_POSE_DEG` against all of those before.

    Examples
    --------
    >>> is_new_pose(np.array([0, 0, 1.0]), np.array([[0, 0.02, -1.0]]))
    False
    >>> is_new_pose(np.array([0, 0, 1.0]), np.array([[0, 0.05, -1.0]]))
    True
    """
    if not len(before):
        return True
    along = np.abs(unit(before) @ unit(direction))
    return bool(along.max() < np.cos(np.radians(NEW_POSE_DEG)))


def _image(one: ReadImage) -> Image:
    if not isinstance(one.outcome, HashedImage):
        raise one.outcome
    return one.outcome.image
