"""A session that grows picture by picture: described, photographed, added to, corrected.

The folder is the only truth. Every picture is whole on the disk before anything counts it.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Literal, get_args

import cv2

from pivometer.errors import ImageError, SessionError, UsageError
from pivometer.io import exclusions
from pivometer.io.atomic import write_file
from pivometer.io.images import EXTENSIONS, Image, decode_image
from pivometer.io.session import ImageFile, Session, load
from pivometer.io.settings import Settings, read_settings
from pivometer.io.settings_text import settings_text
from pivometer.pipeline.reading import read
from pivometer.report.thumbnails import make_thumbnail

Group = Literal["board", "intrinsics", "shaft", "background", "reference", "closing"]
MOST_PICTURE_BYTES = 64_000_000
"""Of an added picture: 32 million pixels of 16 bit."""
MOST_NAME = 100
SOURCES = "sources.json"
"""What plays each camera: the app's note in the session folder; nothing is measured from it."""
MOST_SOURCES_BYTES = 100_000


def describe(folder: Path, settings: Settings) -> Session:
    """Write a session's ``session.toml`` and make the folders of its cameras.

    Parameters
    ----------
    folder
        The session folder; made where it does not exist.
    settings
        What the session says of itself; cameras must be named.

    Raises
    ------
    SessionError
        If the description has a mistake, or does not fit the pictures that the folder holds; then
        nothing is changed.
    """
    text = settings_text(settings)
    draft = write_file(folder / ".session-draft.toml", text)
    try:
        checked = read_settings(draft)
    except SessionError as error:
        raise SessionError(error.what, next_step="correct the description") from error
    finally:
        draft.unlink(missing_ok=True)
    names = checked.camera_names
    if names is None:
        raise SessionError("no cameras are named", next_step="name at least two cameras")
    _refuse_dropped(folder, names)
    write_file(folder / "session.toml", text)
    for group in ("board", "shaft"):
        for name in names:
            (folder / group / name).mkdir(parents=True, exist_ok=True)
    return load(folder)


def _refuse_dropped(folder: Path, names: Collection[str]) -> None:
    """Refuse to leave out, or rename, a camera of which there are pictures."""
    for group in ("board", "shaft"):
        for place in sorted((folder / group).glob("*/")):
            if place.name not in names and any(place.iterdir()):
                raise SessionError(
                    f"there are pictures of camera {place.name}, which is not among the cameras: "
                    f"{', '.join(names)}",
                    next_step="name it as before, or rename its folders first",
                    path=place,
                )


def capture(session: Session, group: Group, images: Mapping[str, Image]) -> str:
    """Write one moment's pictures into a session and return their common stem.

    Parameters
    ----------
    session
        The session.
    group
        What they show.
    images
        A picture of every camera that saw it, grey, 8 or 16 bit.

    Returns
    -------
    str
        The stem, such as ``"012"``: one more than the largest there is.

    Raises
    ------
    UsageError
        If a camera is none of the session's, ``poses.csv`` does not know the pose, or a file cannot
        be written.
    """
    for name in images:
        _require_camera(session, name)
    stem = _next_stem(session.folder / group)
    _require_row(session, group, stem)
    for name, image in images.items():
        _, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        write_file(session.folder / group / name / f"{stem}.png", data.tobytes())
    return stem


def _next_stem(group: Path) -> str:
    stems = (path.stem for path in group.glob("*/*") if not path.name.startswith("."))
    numbers = [int(stem) for stem in stems if stem.isascii() and stem.isdecimal()]
    return f"{max(numbers, default=-1) + 1:03d}"


def add_picture(session: Session, group: str, camera: str, name: str, data: bytes) -> Path:
    """Put a picture that somebody sends into a session.

    Parameters
    ----------
    session
        The session.
    group, camera
        What it shows, and who took it.
    name
        Its file name, without any folder.
    data
        What it holds.

    Raises
    ------
    UsageError
        If the name is no plain file name of an image, names a file that is there or a pose that
        ``poses.csv`` does not know, or the group or camera does not exist.
    ImageError
        If it is too large, or not one whole image.
    """
    if group not in get_args(Group):
        raise UsageError(f"there are no {group!r} pictures", next_step="name a session's group")
    _require_camera(session, camera)
    _require_plain_name(name)
    if len(data) > MOST_PICTURE_BYTES:
        raise ImageError(
            f"{name} is {len(data) / 1e6:.0f} MB; pictures up to {MOST_PICTURE_BYTES // 10**6} MB "
            "are taken",
            next_step="save it as PNG with 8 or 16 bit",
        )
    decode_image(data, name)
    _require_row(session, group, Path(name).stem)
    folder = session.folder / group / camera
    if any(path.stem == Path(name).stem for path in folder.glob("*")):
        raise UsageError(
            f"camera {camera} has a picture {Path(name).stem} under {group}/ already",
            next_step="give it another name",
        )
    return write_file(folder / name, data)


def _require_camera(session: Session, name: str) -> None:
    if name not in session.cameras:
        raise UsageError(
            f"{name!r} is no camera of this session; they are {', '.join(session.cameras)}",
            next_step="name one of them",
        )


def _require_row(session: Session, group: str, stem: str) -> None:
    """Refuse a pose that ``poses.csv`` does not know: the session could not be read any more."""
    if group == "shaft" and session.pose_table and stem not in session.pose_table.poses:
        raise UsageError(
            f"poses.csv states every pose of this session, and none named {stem}",
            next_step="move poses.csv away while poses are taken, then add a row for each",
            path=session.folder / "poses.csv",
        )


def _require_plain_name(name: str) -> None:
    plain = PurePosixPath(name).name == name and not set(name) & set('\\/:*?"<>|\0')
    if not plain or name.startswith(".") or len(name) > MOST_NAME or not name.isprintable():
        raise UsageError(
            f"{name[:MOST_NAME]!r} is no plain file name", next_step="send a file such as 012.png"
        )
    if Path(name).suffix.lower() not in EXTENSIONS:
        raise UsageError(
            f"{name!r} is no picture: its ending is none of {', '.join(sorted(EXTENSIONS))}",
            next_step="send PNG, TIFF or JPEG pictures",
        )


def exclude(session: Session, view: str, reason: str | None) -> Session:
    """Take a view out of a session with a reason, or take it back without, and return the session.

    Parameters
    ----------
    session
        The session.
    view
        ``"shaft/012"``, ``"board/003"`` or ``"intrinsics/left/000"``.
    reason
        Why; `None` takes it back.

    Raises
    ------
    UsageError
        If there is no such view, or the reason is empty.
    """
    if all(file.view != view for file in _files(session)):
        raise UsageError(
            f"this session has no view {view!r}", next_step="name one such as shaft/012"
        )
    exclusions.log_exclusion(session.folder, view, reason, when=datetime.now(UTC))
    return load(session.folder)


def _files(session: Session) -> Iterator[ImageFile]:
    for views in (
        *(session.board_views, session.intrinsics, session.shaft),
        *(session.background, session.reference_views, session.closing),
    ):
        for files in views.values():
            yield from files.values()


def file_of(session: Session, view: str, camera: str) -> ImageFile | None:
    """Return the picture a camera took of a view; `None` where there is none.

    The session's list is looked up, so that no view can lead to a file outside of it.
    """
    found = (file for file in _files(session) if (file.view, file.camera) == (view, camera))
    return next(found, None)


def picture(session: Session, view: str, camera: str) -> bytes:
    """Return a small JPEG of the picture a camera took of a view.

    Raises
    ------
    UsageError
        If there is none.
    ImageError
        If it cannot be read.
    """
    file = file_of(session, view, camera)
    if file is None:
        raise UsageError(f"no picture of {view} by {camera}", next_step="name one of the session")
    outcome = read(file).outcome
    if isinstance(outcome, ImageError):
        raise outcome
    return make_thumbnail(outcome.image).jpeg


def save_sources(folder: Path, sources: Mapping[str, str], *, rate_hz: float) -> None:
    """Note in the session folder what plays each camera."""
    content = {"rate_hz": rate_hz, "sources": dict(sources)}
    write_file(folder / SOURCES, json.dumps(content, indent=1) + "\n")


def saved_sources(folder: Path) -> tuple[dict[str, str], float | None]:
    """Return what plays each camera, and the rate; nothing where no note is, or a spoilt one.

    The note only saves typing, so a spoilt one is no reason to stop.
    """
    path = folder / SOURCES
    if not path.is_file() or path.stat().st_size > MOST_SOURCES_BYTES:
        return {}, None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}, None
    sources = content.get("sources") if isinstance(content, dict) else None
    rate = content.get("rate_hz") if isinstance(content, dict) else None
    named = sources if isinstance(sources, dict) else {}
    return (
        {str(name): text for name, text in named.items() if isinstance(text, str)},
        float(rate) if isinstance(rate, int | float) and 0 < rate <= 1000 else None,
    )
