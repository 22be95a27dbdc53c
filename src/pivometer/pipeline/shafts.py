"""The shaft's edges in all frames of one camera, found and fitted as a stream.

Two passes: some frames tell what stands still and how the shaft moves, then every frame is searched
on its own. So memory does not grow with the number of frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from threading import Lock

import numpy as np

from pivometer._arrays import Floats
from pivometer.cameras import Camera, Rig
from pivometer.errors import CalibrationError, DataError, ShaftNotFoundError
from pivometer.io.images import HashedImage, Image
from pivometer.io.session import ImageFile, Session
from pivometer.pipeline.reading import (
    Progress,
    ReadImage,
    fitting_threads,
    hashes,
    streamed,
    usable,
)
from pivometer.shaft.backdrop import backdrop_of
from pivometer.shaft.concurrence import agreed_finders
from pivometer.shaft.detection import MOST_SAMPLES, SeedRejection, ShaftFinder, learn_shaft
from pivometer.shaft.edges import ShaftEdges, fit_edges
from pivometer.shaft.finding.background import sampled
from pivometer.shaft.hint import ShaftHint
from pivometer.shaft.seed import ShaftSeed
from pivometer.shaft.stillness import CameraMovement, Scenery, camera_movement

KEPT_BYTES = 64_000_000
"""Frames of the first pass that are kept for the second, so that short sessions are read once."""

MOST_EMPTY = 9
"""Empty frames that are looked at: their median has a third of one's noise."""

MOST_BOARDS = 8
"""Pictures of the board that tell whether the camera still stands where it stood before them."""

TURNED_BOARDS = 3
"""So many pictures of the board must have the scenery mirrored or turned alike, none as it is."""

SHAFT_ADVICE = (
    "look at this image: is the shaft in view, in focus and unlike what is behind it? If it is, "
    "say where it turns: --hint CAMERA=X,Y"
)


@dataclass(frozen=True, slots=True, eq=False)
class CameraShafts:
    """What one camera saw: edges or why none by pose, hashes, and what is uncertain.

    ``shifts_px`` is by view what `Scenery.shift_px` says, in the order of `camera_movement`.
    """

    edges: dict[str, ShaftEdges | DataError]
    inputs: dict[str, str]
    warning: str | None
    shifts_px: dict[str, Floats | None]


def session_shafts(
    session: Session, rig: Rig, *, hints: Mapping[str, ShaftHint], progress: Progress | None
) -> dict[str, CameraShafts]:
    """Find and fit the shaft's edges in all frames of all cameras of a rig.

    Each camera first learns what turns before it; then all of them agree on what the shaft is.

    Raises
    ------
    CalibrationError
        If a camera's pictures of the shaft are mirrored or turned against those of the board.
    ShaftNotFoundError
        If a camera moved, so that its pictures do not tell what turns before it.
    """
    looks = [_Look(session, camera, hints.get(camera.name), progress) for camera in rig.cameras]
    for look in looks:
        look.refuse_unlike()
    finders = [look.finder for look in looks]
    known = [finder for finder in finders if finder is not None]
    if len(known) == len(looks):
        poses = [look.first.poses for look in looks]
        agreed = agreed_finders(known, poses, rig, diameter_mm=session.diameter_mm)
        for look, finder in zip(looks, agreed, strict=True):
            look.finder = finder
    return {look.camera.name: look.shafts() for look in looks}


def camera_shafts(
    session: Session, camera: Camera, *, hint: ShaftHint | None, progress: Progress | None
) -> CameraShafts:
    """Find and fit the shaft's edges in all frames of one camera; say what went wrong in others."""
    look = _Look(session, camera, hint, progress)
    look.refuse_unlike()
    return look.shafts()


def moved_camera(
    session: Session, camera: str, shifts_px: Mapping[str, Floats | None]
) -> CameraMovement | None:
    """Return where a camera moved most, without the pictures that a person took out."""
    views = [view for view in shifts_px if view not in session.excluded]
    return camera_movement(camera, views, [shifts_px[view] for view in views])


def fitted_at(
    seed: ShaftSeed | SeedRejection,
    image: Image,
    camera: Camera,
    empty: Image | None,
    backdrop: Backdrop,
) -> ShaftEdges | DataError:
    """Fit the shaft's edges where a search found them, or say why there are none."""
    if isinstance(seed, SeedRejection):
        return ShaftNotFoundError(seed.reason, next_step=SHAFT_ADVICE)
    try:
        return fit_edges(image, camera, seed, background=empty, backdrop=backdrop)
    except DataError as error:
        return error.with_traceback(None)  # which would keep the image


class Backdrop:
    """What stands behind the shaft, as frames tell; found out when it is first asked for.

    Parameters
    ----------
    frames
        Gives frames of one camera, each with where the shaft is in it.
    """

    def __init__(
        self, frames: Callable[[], Iterable[tuple[Image, ShaftSeed | SeedRejection]]]
    ) -> None:
        self._frames = frames
        self._told: list[Floats | None] = []
        self._telling = Lock()

    def __call__(self) -> Floats | None:
        """Return grey levels, shape of a frame, NaN where they are unknown; None of few frames."""
        with self._telling:
            if not self._told:
                found = [(i, seed) for i, seed in self._frames() if isinstance(seed, ShaftSeed)]
                images, edges = [i for i, _ in found], [seed.edges_px for _, seed in found]
                self._told.append(backdrop_of(images, edges))
            return self._told[0]


class _Look:
    """One camera's frames: what some of them tell of the shaft, then its edges in all."""

    def __init__(
        self,
        session: Session,
        camera: Camera,
        hint: ShaftHint | None,
        progress: Progress | None,
    ) -> None:
        self.camera = camera
        self._files = list(session.shaft_images(camera.name))
        self._progress = progress
        self._background, self._inputs = empty_frame(session, camera)
        self.first = _FirstPass(self._files, camera, progress)
        self.finder = self.first.learned(self._background, hint)
        self._turned_over: str | None = None
        self._shifts_px = self._shifted(session)
        self._moved = moved_camera(session, camera.name, self._shifts_px)
        self._seeds: dict[str, ShaftSeed | SeedRejection] = {}
        self._backdrop = Backdrop(self._shown)

    def shafts(self) -> CameraShafts:
        """Find and fit the shaft in all frames."""
        inputs, stage = dict(self._inputs), f"fitting edges {self.camera.name}"
        outcomes: dict[str, ShaftEdges | DataError] = {}
        threads = fitting_threads(self.camera.width, self.camera.height)
        fitted = streamed(self._edges, self._files, stage, self._progress, self.first.kept, threads)
        for file, (digests, outcome) in zip(self._files, fitted, strict=True):
            inputs |= digests
            outcomes[file.stem] = outcome
        warning = None if self.finder is None else self.finder.warning
        return CameraShafts(outcomes, inputs, warning, self._shifts_px)

    def refuse_unlike(self) -> None:
        """Refuse pictures of a camera that was turned over, or moved so that nothing is told.

        See `session_shafts`.
        """
        if self._turned_over is not None:
            raise CalibrationError(
                f"the shaft images of camera {self.camera.name} are {self._turned_over} against "
                "its board images: the scenery behind both shows it",
                next_step="switch mirroring and turning off in the camera's software, or turn the "
                "images of one of the two back",
            )
        moved = self._moved
        if self.finder is None or self.finder.refusal is None or not (moved and moved.significant):
            return
        raise ShaftNotFoundError(
            f"camera {moved.camera} moved by {moved.shift_px:.1f} px between {moved.before} and "
            f"{moved.after}, so that what turns before it cannot be told from what stands still",
            next_step="fix the camera better and repeat the session, or measure the poses before "
            "and after as two sessions",
        )

    def _shifted(self, session: Session) -> dict[str, Floats | None]:
        """Return how far the scenery is shifted in pictures of the board, then of the shaft."""
        scenery, name = self.first.scenery, self.camera.name
        if scenery is None:
            return {}
        files = [images[name] for images in session.board_views.values() if name in images]
        chosen = [files[i] for i in sampled(len(files), MOST_BOARDS)]
        size, shifts = (self.camera.width, self.camera.height), dict[str, Floats | None]()
        over: list[str] = []
        for frame in streamed(_same, chosen, f"comparing scenery {name}", self._progress):
            self._inputs |= hashes([frame])
            if isinstance(frame.outcome, HashedImage) and frame.size == size:
                image = frame.outcome.image
                shift = shifts[frame.file.view] = scenery.shift_px(image)
                if shift is None and (how := scenery.turned_over(image)) is not None:
                    over.append(how)
        alike = len(over) >= TURNED_BOARDS and len(set(over)) == 1
        if alike and all(shift is None for shift in shifts.values()):
            self._turned_over = over[0]
        return shifts | self.first.shifts_px

    def _edges(self, frame: ReadImage) -> tuple[dict[str, str], ShaftEdges | DataError]:
        """Find and fit the shaft's edges in one frame, or say what went wrong."""
        return hashes([frame]), self._fitted(frame)

    def _fitted(self, frame: ReadImage) -> ShaftEdges | DataError:
        try:
            image = usable(frame, (self.camera.width, self.camera.height))
            if self.finder is None:
                return ShaftNotFoundError(_NO_SAMPLE, next_step=SHAFT_ADVICE)
        except DataError as error:
            return error.with_traceback(None)  # which would keep the image
        seed = self._seed(self.finder, frame.file.view, image)
        return fitted_at(seed, image, self.camera, self._background, self._backdrop)

    def _seed(self, finder: ShaftFinder, view: str, image: Image) -> ShaftSeed | SeedRejection:
        if view not in self._seeds:
            self._seeds[view] = finder.find(image, sample=self.first.samples.get(view))
        return self._seeds[view]

    def _shown(self) -> Iterator[tuple[Image, ShaftSeed | SeedRejection]]:
        """Give the frames that are kept, and where the shaft is in each."""
        for view in (view for view in self.first.samples if view in self.first.kept):
            outcome = self.first.kept[view].outcome
            if self.finder is not None and isinstance(outcome, HashedImage):
                yield outcome.image, self._seed(self.finder, view, outcome.image)


class _FirstPass:
    """Some frames, evenly spread: their places among the samples, those kept, and their scenery."""

    def __init__(
        self, files: Sequence[ImageFile], camera: Camera, progress: Progress | None
    ) -> None:
        chosen = [files[i] for i in sampled(len(files), MOST_SAMPLES)]
        self._frames = streamed(_same, chosen, f"reading {camera.name}", progress)
        self._camera = camera
        self._left = KEPT_BYTES
        self.samples: dict[str, int] = {}
        self.scenery: Scenery | None = None
        self.shifts_px: dict[str, Floats | None] = {}
        self.kept: dict[str, ReadImage] = {}

    @property
    def poses(self) -> dict[int, str]:
        """The pose that each sample shows."""
        return {sample: view.rpartition("/")[2] for view, sample in self.samples.items()}

    def learned(self, background: Image | None, hint: ShaftHint | None) -> ShaftFinder | None:
        """Return what the frames tell; None where none can be read."""
        images = self._images()
        first = next(images, None)
        if first is None:
            return None
        return learn_shaft(chain([first], images), background=background, hint=hint)

    def _images(self) -> Iterator[Image]:
        for frame in self._frames:
            image = frame.outcome.image if isinstance(frame.outcome, HashedImage) else None
            if image is not None and image.nbytes <= self._left:
                self._left -= image.nbytes
                self.kept[frame.file.view] = frame
            if image is not None and frame.size == (self._camera.width, self._camera.height):
                self.samples[frame.file.view] = len(self.samples)
                self.scenery = self.scenery or Scenery(image)
                self.shifts_px[frame.file.view] = self.scenery.shift_px(image)
                yield image


def _same(frame: ReadImage) -> ReadImage:
    return frame


_NO_SAMPLE = "none of the frames looked at first can be used, so what moves is unknown"


def empty_frame(session: Session, camera: Camera) -> tuple[Image | None, dict[str, str]]:
    """Return the median of the empty frames, if there are any, and their hashes."""
    files = list(session.background_images(camera.name))
    reads = list(streamed(_same, [files[i] for i in sampled(len(files), MOST_EMPTY)], "", None))
    empty = [usable(frame, (camera.width, camera.height)) for frame in reads]
    if not empty:
        return None, {}
    return np.median(empty, axis=0).astype(empty[0].dtype), hashes(reads)
