"""Images of a session, read in threads; what cannot be read says why."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

from pivometer.errors import ImageError
from pivometer.io.images import HashedImage, Image, read_hashed_image
from pivometer.io.session import ImageFile

Progress = Callable[[str, int, int], None]
"""Called as ``progress(stage, done, total)``."""

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
        return self.file.view.rpartition("/")[2]

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height, px; `None` where the file could not be read."""
        if isinstance(self.outcome, ImageError):
            return None
        height, width = self.outcome.image.shape
        return width, height


def read(file: ImageFile) -> ReadImage:
    """Read an image, or keep the reason why it cannot be read."""
    try:
        return ReadImage(file, read_hashed_image(file.path))
    except ImageError as error:
        return ReadImage(file, error)


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
