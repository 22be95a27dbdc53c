"""The shaft while poses are taken: live edges, and the RCM of the poses so far.

The pictures on the disk tell how the shaft moves, and the cameras choose it together as `measure`
lets them; a live picture is then searched alone. Poses that were taken are fitted as `measure` fits
them, with what the poses so far tell of the scenery, and again if more poses tell that the shaft is
another rod.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration import Calibration
from pivometer.cameras import Camera
from pivometer.errors import DataError, PivometerError
from pivometer.geometry.line import unit
from pivometer.io.images import HashedImage, Image
from pivometer.io.session import ImageFile, Session
from pivometer.measurement import ImportedRig, Measurement
from pivometer.pipeline.measuring import measure_edges
from pivometer.pipeline.reading import ReadImage, read
from pivometer.pipeline.shafts import Backdrop, empty_frame, fitted_at
from pivometer.shaft.concurrence import agreed_finders
from pivometer.shaft.detection import (
    LEAST_FRAMES,
    MOST_SAMPLES,
    SeedRejection,
    ShaftFinder,
    learn_shaft,
)
from pivometer.shaft.edges import ShaftEdges
from pivometer.shaft.finding.background import sampled
from pivometer.shaft.seed import ShaftSeed
from pivometer.shaft.silhouette import edge_normals
from pivometer.shaft.triangulation import triangulate_centerline

RELEARN = 1.5
"""What moves is learned again when there are this many times the poses it was learned from."""
NEW_POSE_DEG = 2.0
"""A pose whose shaft is turned by less against one there is says little new: a fifteenth of the
paper's half cone."""
TRIED = 3
"""Poses in which what was learned anew must find the rod that was fitted before."""
SAME_ROD_PX = 4.0
"""Edges before the fit are good to about 2 px; further off, all poses are fitted again."""


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


@dataclass(frozen=True, slots=True, eq=False)
class _Learned:
    """What some poses told of one camera: how the shaft moves, and the empty scene if it is known.

    `samples` are pictures of some poses and their places among those looked at, `count` how many
    poses there were.
    """

    finder: ShaftFinder
    samples: Mapping[ImageFile, int]
    count: int
    empty: Image | None


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
        self._learned: dict[str, _Learned] = {}
        self._backdrops: dict[str, Backdrop] = {}
        self._seen: dict[str, dict[str, ShaftEdges | DataError]] = {}

    @property
    def ready(self) -> bool:
        """Whether the poses so far tell how the shaft moves, for every camera."""
        return len(self._finders) == len(self.calibration.rig.cameras)

    def follow(self, session: Session) -> None:
        """Take in the poses that came since: learn again where they are many, and fit them."""
        cameras = self.calibration.rig.cameras
        files = {camera.name: list(session.shaft_images(camera.name)) for camera in cameras}
        learned = [self._learn(session, camera, files[camera.name]) for camera in cameras]
        if any(learned):
            self._finders = self._agreed(session)
            self._backdrops = {n: Backdrop(partial(self._shown, n)) for n in self._finders}
        self._seen = {
            camera.name: self._looked_at(
                files[camera.name], camera, self._still_known(files[camera.name], camera, new)
            )
            for camera, new in zip(cameras, learned, strict=True)
            if camera.name in self._finders
        }

    def _still_known(
        self, files: Sequence[ImageFile], camera: Camera, new: bool
    ) -> Mapping[str, ShaftEdges | DataError]:
        """Return what was fitted before and stands: nothing where it is of another rod.

        Fewer poses may not have told the rods apart. What was not found is looked for again.
        """
        known = self._seen.get(camera.name, {})
        if not new:
            return known
        found = {stem: one for stem, one in known.items() if isinstance(one, ShaftEdges)}
        shown = [file for file in files if file.stem in found]
        tried = [shown[i] for i in sampled(len(shown), TRIED)]
        same = all(self._finds(read(file), camera, found[file.stem]) for file in tried)
        return found if same else {}

    def _finds(self, one: ReadImage, camera: Camera, edges: ShaftEdges) -> bool:
        """Tell whether the finder as it is now finds what was fitted before."""
        if not isinstance(one.outcome, HashedImage):
            return False
        seed = self._finders[camera.name].find(one.outcome.image)
        if isinstance(seed, SeedRejection):
            return False
        start, along = seed.edges_px[:, :1], np.diff(seed.edges_px, axis=1)
        across = along[..., ::-1] * [-1.0, 1.0] / np.linalg.norm(along, axis=-1, keepdims=True)
        ends = edges.points_px[:, [0, -1]]
        away = [((either - start) * across).sum(axis=-1) for either in (ends, ends[::-1])]
        return min(float(np.abs(one).max()) for one in away) < SAME_ROD_PX

    def _looked_at(
        self,
        files: Sequence[ImageFile],
        camera: Camera,
        known: Mapping[str, ShaftEdges | DataError],
    ) -> dict[str, ShaftEdges | DataError]:
        """Return what a camera saw in each pose, fitted where it is not known."""
        return {
            file.stem: known[file.stem] if file.stem in known else self._fitted(read(file), camera)
            for file in files
        }

    def _learn(self, session: Session, camera: Camera, files: Sequence[ImageFile]) -> bool:
        """Learn how the shaft moves before a camera if its poses are many more than before."""
        hint = session.hints.get(camera.name)
        least = LEAST_FRAMES if hint is None else 1
        before = self._learned.get(camera.name)
        if len(files) < max(least, RELEARN * before.count if before else 0):
            return False
        reads = [read(files[i]) for i in sampled(len(files), MOST_SAMPLES)]
        reads = [one for one in reads if one.size == (camera.width, camera.height)]
        if not reads:
            return False
        empty = before.empty if before else empty_frame(session, camera)[0]
        finder = learn_shaft(map(_image, reads), background=empty, hint=hint)
        samples = {one.file: i for i, one in enumerate(reads)}
        self._learned[camera.name] = _Learned(finder, samples, len(files), empty)
        return True

    def _shown(self, name: str) -> Iterator[tuple[Image, ShaftSeed | SeedRejection]]:
        """Give the pictures that a camera's finder was learned from, and where the shaft is."""
        for file, sample in self._learned[name].samples.items():
            outcome = read(file).outcome
            if isinstance(outcome, HashedImage):
                yield outcome.image, self._finders[name].find(outcome.image, sample=sample)

    def _agreed(self, session: Session) -> dict[str, ShaftFinder]:
        """Return the cameras' finders: of what they choose together, as in `measure`."""
        rig = self.calibration.rig
        own = {name: learned.finder for name, learned in self._learned.items()}
        names = [camera.name for camera in rig.cameras]
        if len(own) < len(names):
            return own
        samples = [self._learned[name].samples for name in names]
        poses = [{i: file.stem for file, i in shown.items()} for shown in samples]
        finders = [own[name] for name in names]
        agreed = agreed_finders(finders, poses, rig, diameter_mm=session.diameter_mm)
        return dict(zip(names, agreed, strict=True))

    def _fitted(self, one: ReadImage, camera: Camera) -> ShaftEdges | DataError:
        if not isinstance(one.outcome, HashedImage):
            return one.outcome
        image, learned = one.outcome.image, self._learned[camera.name]
        seed = self._finders[camera.name].find(image, sample=learned.samples.get(one.file))
        return fitted_at(seed, image, camera, learned.empty, self._backdrops[camera.name])

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
