"""Images of a session, read in threads; what cannot be read says why."""

from __future__ import annotations

import os
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from types import MappingProxyType
from typing import TypeVar

from pivometer.errors import ImageError
from pivometer.io.images import HashedImage, Image, read_hashed_image
from pivometer.io.session import ImageFile
from pivometer.io.video import sha256, video_frames

Progress = Callable[[str, int, int], None]
"""Called as ``progress(stage, done, total)``."""

MOST_THREADS = 8
"""Each has a frame in memory."""

FITS_AT_ONCE_PX = 1_000_000
"""Fits of smaller images wait for one another: `measure` of 640 × 480 px took 6.8 s in one thread,
6.7 s in two and 9 s in eight, and more of the processor; 7.3 s and 6.7 s of 1280 × 960 px, 17 s and
12 s of 1920 × 1440 px."""

_In = TypeVar("_In")
_Out = TypeVar("_Out")


def in_threads(
    work: Callable[[_In], _Out], items: Sequence[_In], stage: str, progress: Progress | None
) -> list[_Out]:
    """Do `work` on every item in threads, in order, telling how far it is."""
    results: list[_Out] = []
    with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:
        for result in pool.map(work, items):
            results.append(result)
            if progress is not None:
                progress(stage, len(results), len(items))
    return results


@dataclass(frozen=True, slots=True, eq=False)
class ReadImage:
    """One image file of a session, read or not."""

    file: ImageFile
    outcome: HashedImage | ImageError

    @property
    def stem(self) -> str:
        """The view's last part: the pose, in images of the shaft."""
        return self.file.stem

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height, px; `None` where the file could not be read."""
        if isinstance(self.outcome, ImageError):
            return None
        height, width = self.outcome.image.shape
        return width, height


def read(file: ImageFile) -> ReadImage:
    """Read an image, or keep the reason why it cannot be read."""
    if file.frame is not None:
        return next(iter(_decoded([file])))
    try:
        return ReadImage(file, read_hashed_image(file.path))
    except ImageError as error:
        return ReadImage(file, error)


def fitting_threads(width: int, height: int) -> int:
    """Return in how many threads images of this size are best fitted."""
    return MOST_THREADS if width * height >= FITS_AT_ONCE_PX else 1


def streamed(
    work: Callable[[ReadImage], _Out],
    files: Sequence[ImageFile],
    stage: str,
    progress: Progress | None,
    known: Mapping[str, ReadImage] = MappingProxyType({}),
    threads: int = MOST_THREADS,
) -> Iterator[_Out]:
    """Do `work` on every frame in threads, in order, with only a few frames in memory.

    There are at most as many `threads` as given, and no more than processors.
    A video is decoded here, one frame after the other; image files are read in the threads. Frames
    that are `known`, by their views, are not read again.
    """
    threads = min(os.cpu_count() or 1, threads)
    pending: deque[Future[_Out]] = deque()
    done = 0
    with ThreadPoolExecutor(max_workers=threads) as pool:
        for ready in _readers(files, known):
            pending.append(pool.submit(lambda ready: work(ready()), ready))
            if len(pending) > threads:
                yield pending.popleft().result()
                done = _told(progress, stage, done + 1, len(files))
        while pending:
            yield pending.popleft().result()
            done = _told(progress, stage, done + 1, len(files))


def _told(progress: Progress | None, stage: str, done: int, total: int) -> int:
    if progress is not None:
        progress(stage, done, total)
    return done


def _readers(
    files: Iterable[ImageFile], known: Mapping[str, ReadImage]
) -> Iterator[Callable[[], ReadImage]]:
    """Yield for each frame what gives it: reads the file, or has it already."""
    for path, group in groupby(files, lambda file: None if file.frame is None else file.path):
        frames = list(group)
        if path is None:
            for file in frames:
                yield partial(_known_or_read, file, known)
        elif all(file.view in known for file in frames):
            yield from (partial(known.__getitem__, file.view) for file in frames)
        else:
            for frame in _decoded(frames):
                yield partial(_same, frame)


def _known_or_read(file: ImageFile, known: Mapping[str, ReadImage]) -> ReadImage:
    return known[file.view] if file.view in known else read(file)


def _same(frame: ReadImage) -> ReadImage:
    return frame


def _decoded(files: Sequence[ImageFile]) -> Iterator[ReadImage]:
    """Decode frames of videos, in rising order within each."""
    for path, group in groupby(files, lambda file: file.path):
        frames, digest = list(group), sha256(path)
        for file, frame in zip(frames, video_frames(path, _numbers(frames)), strict=True):
            if isinstance(frame, ImageError):
                yield ReadImage(file, frame)
            else:
                yield ReadImage(file, HashedImage(frame, digest))


def _numbers(frames: Iterable[ImageFile]) -> Iterator[int]:
    return (frame.frame for frame in frames if frame.frame is not None)


def hashes(reads: Iterable[ReadImage]) -> dict[str, str]:
    """SHA-256 of every file that was read, by its path inside the session."""
    return {r.file.name: r.outcome.sha256 for r in reads if isinstance(r.outcome, HashedImage)}


def usual_size(camera: str, files: Sequence[ReadImage]) -> tuple[int, int]:
    """Return the size most images of a camera have."""
    sizes = Counter(file.size for file in files if file.size is not None)
    if not sizes:
        raise ImageError(
            f"camera {camera} has no readable image",
            next_step="check the files; copy them again from the camera",
            path=files[0].file.path.parent if files else None,
        )
    return sizes.most_common(1)[0][0]


def _odd_size(file: ReadImage, usual: tuple[int, int]) -> ImageError | None:
    """Say so if an image does not have its camera's usual size."""
    if file.size == usual or file.size is None:
        return None
    return ImageError(
        f"{file.size[0]}×{file.size[1]} px, but images of camera {file.file.camera} are "
        f"{usual[0]}×{usual[1]} px",
        next_step="take all images of a camera at one resolution, uncropped",
        path=file.file.path,
    )


def usable(read: ReadImage, size: tuple[int, int]) -> Image:
    """Return the image, or raise what is wrong with it."""
    if isinstance(read.outcome, ImageError):
        raise read.outcome
    wrong = _odd_size(read, size)
    if wrong is not None:
        raise wrong
    return read.outcome.image
