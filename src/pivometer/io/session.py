"""The session folder: its description and its images, listed and checked, not yet read.

::

    SESSION/
      session.toml
      board/<camera>/<view>.png         the board seen by several cameras at one moment
      intrinsics/<camera>/<view>.png    more board views of one camera
      shaft/<camera>/<pose>.png         the shaft; same stem = same robot pose
      shaft/<camera>.mp4                or a video of it; same frame number = same moment
      background/<camera>/*.png         the empty scene
      reference/<camera>/<view>.png     a board fixed near the RCM
      closing/<camera>/<view>.png       the board again at the end
      poses.csv                         joints, time and side of approach of each pose
      exclusions.csv                    pictures that a person took out, and why
"""

import difflib
import re
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from pivometer.calibration.board import Board
from pivometer.errors import ImageError, SessionError
from pivometer.io import exclusions, video
from pivometer.io.images import EXTENSIONS
from pivometer.io.joints import FILE_NAME, PoseTable, read_pose_table
from pivometer.io.settings import EXAMPLE, Settings, read_settings
from pivometer.shaft.hint import ShaftHint

_GROUPS = ("board", "intrinsics", "shaft", "background", "reference", "closing")
_VIDEO_GROUPS = ("shaft", "background")
_CLUTTER = frozenset({"thumbs.db", "desktop.ini"})


@dataclass(frozen=True, slots=True, eq=False)
class ImageFile:
    """Where one image lies, and what it shows.

    Parameters
    ----------
    path
        The file.
    name
        Its path relative to the session folder, with ``/``: the key under ``inputs``.
    camera
        The camera that took it.
    view
        What it shows: ``"board/000"``, ``"intrinsics/left/003"``, ``"shaft/012"`` and so on. The
        same view of several cameras is the same moment.
    frame
        The frame's number where the file is a video, from 0.
    """

    path: Path
    name: str
    camera: str
    view: str
    frame: int | None = None

    @property
    def stem(self) -> str:
        """The view's last part: the pose, in images of the shaft."""
        return self.view.rpartition("/")[2]


Views = Mapping[str, Mapping[str, ImageFile]]
"""By file stem in natural order, then by camera; a camera without an image is not there."""


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """A checked session folder. Its images are listed; they are read when they are needed.

    Parameters
    ----------
    folder
        The session folder.
    board
        The calibration board.
    diameter_mm
        The shaft's nominal diameter, mm; `None` where the session does not state one.
    cameras
        The camera names, the reference first.
    device, operator
        Free-form tables of ``session.toml``; dates are ISO 8601 text.
    notes
        Free text.
    board_views, shaft, reference_views, closing
        Images by stem and camera; the same stem is the same moment, or the same robot pose.
    intrinsics, background
        Images by stem and camera; every image stands for itself.
    ignored
        Files and folders beside the images that are no images, by their path in the session.
    pose_table
        What ``poses.csv`` says of each pose; `None` without that file.
    hints
        By camera, where the shaft is, from ``[shaft.hint]``; empty where none is needed.
    excluded
        By view (``"shaft/012"``), why a person took it out, from ``exclusions.csv``. The images are
        listed all the same.
    """

    folder: Path
    board: Board
    diameter_mm: float | None
    cameras: tuple[str, ...]
    device: Mapping[str, object]
    operator: Mapping[str, object]
    notes: str
    board_views: Views
    intrinsics: Views
    shaft: Views
    background: Views
    reference_views: Views
    closing: Views
    ignored: tuple[str, ...]
    pose_table: PoseTable | None = None
    hints: Mapping[str, ShaftHint] = field(default_factory=dict)
    excluded: Mapping[str, str] = field(default_factory=dict)

    @property
    def reference(self) -> str:
        """The camera whose frame all results are in."""
        return self.cameras[0]

    def board_images(self) -> Iterator[ImageFile]:
        """All images that calibrate the cameras: the shared views, then the single ones."""
        for views in (self.board_views, self.intrinsics):
            for images in views.values():
                yield from (images[camera] for camera in self.cameras if camera in images)

    def shaft_images(self, camera: str) -> Iterator[ImageFile]:
        """All shaft images of one camera, in the order of the poses."""
        yield from (images[camera] for images in self.shaft.values() if camera in images)

    def background_images(self, camera: str) -> Iterator[ImageFile]:
        """All images of the empty scene by one camera."""
        yield from (images[camera] for images in self.background.values() if camera in images)

    def fixed_board_images(self, group: Literal["reference", "closing"]) -> Iterator[ImageFile]:
        """All images of the board beside the RCM, or of the board at the end."""
        for images in (self.reference_views if group == "reference" else self.closing).values():
            yield from (images[camera] for camera in self.cameras if camera in images)

    def require(self, group: Literal["board", "shaft"]) -> None:
        """Check that the session has images of the board, or of the shaft.

        Raises
        ------
        SessionError
            If it has none.
        """
        if not (self.shaft if group == "shaft" else (self.board_views or self.intrinsics)):
            raise SessionError(
                f"no {group} images in this session",
                next_step=f"put them into {group}/{self.reference}/000.png and so on, one folder "
                "for each camera",
                path=self.folder / group,
            )


def load(folder: Path | str) -> Session:
    """Check a session folder and list its images.

    Parameters
    ----------
    folder
        The folder that holds ``session.toml``.

    Returns
    -------
    Session
        The description and the image files. A pose or view that only some cameras have is kept as
        it is: whoever uses it says what is missing.

    Raises
    ------
    SessionError
        If this is not a session: no ``session.toml`` or mistakes in it, fewer than two cameras,
        camera folders that do not match, two files for one image.
    """
    root = Path(folder)
    try:
        return _load(root)
    except OSError as error:
        raise SessionError(
            f"cannot be read: {error.strerror or error}",
            next_step="check the folder and its permissions",
            path=error.filename or root,
        ) from error


def _load(root: Path) -> Session:
    _check_is_session(root)
    settings = read_settings(root / "session.toml")
    folders = {group: _subfolders(root / group) for group in _GROUPS}
    folders |= {group: folders[group] | _videos(root / group) for group in _VIDEO_GROUPS}
    cameras = _cameras(root, settings, folders)
    ignored: list[str] = []
    views = {
        group: _views(root, group, folders[group], cameras, ignored=ignored) for group in _GROUPS
    }
    return Session(
        folder=root,
        board=settings.board,
        diameter_mm=settings.diameter_mm,
        cameras=cameras,
        device=MappingProxyType(dict(settings.device)),
        operator=MappingProxyType(dict(settings.operator)),
        notes=settings.notes,
        board_views=views["board"],
        intrinsics=views["intrinsics"],
        shaft=views["shaft"],
        background=views["background"],
        reference_views=views["reference"],
        closing=views["closing"],
        ignored=tuple(ignored),
        pose_table=_pose_table(root / FILE_NAME, views["shaft"]),
        hints=MappingProxyType(_hints(root, settings, cameras)),
        excluded=exclusions.excluded_now(exclusions.read_exclusions(root / exclusions.FILE_NAME)),
    )


def _hints(root: Path, settings: Settings, cameras: tuple[str, ...]) -> dict[str, ShaftHint]:
    """Return the hints by camera, after checking that there are such cameras."""
    hints = {_nfc(name): hint for name, hint in settings.hints.items()}
    for stray in (name for name in hints if name not in cameras):
        raise SessionError(
            f"shaft.hint: '{stray}' is no camera; they are {', '.join(cameras)}",
            next_step="correct session.toml",
            path=root / "session.toml",
        )
    return hints


def _pose_table(file: Path, shaft: Views) -> PoseTable | None:
    return read_pose_table(file, shaft) if file.is_file() and shaft else None


# --- Is it a session at all? ---


def _check_is_session(root: Path) -> None:
    if not root.exists():
        near = _near(root.name, _subfolders(root.parent))
        raise SessionError(
            "no such folder",
            next_step=f"did you mean {root.parent / near[0]}?" if near else "check the path",
            path=root,
        )
    if not root.is_dir():
        owner = root.parent if root.name == "session.toml" else "the folder with session.toml"
        raise SessionError("is a file, not a session folder", next_step=f"name {owner}", path=root)
    if not (root / "session.toml").is_file():
        raise SessionError(
            "is not a session: it has no session.toml",
            next_step=_instead_of_session_toml(root),
            path=root,
        )
    if not any((root / group).is_dir() for group in ("board", "shaft")):
        near = _near("shaft", _subfolders(root)) or _near("board", _subfolders(root))
        raise SessionError(
            "has neither a folder shaft nor a folder board",
            next_step=f"rename {near[0]}, or put the images into shaft/<camera>/<pose>.png"
            if near
            else "put the images into shaft/<camera>/<pose>.png, board/<camera>/<view>.png",
            path=root,
        )


def _instead_of_session_toml(root: Path) -> str:
    """Say what to do about a missing ``session.toml``, from what lies there instead."""
    inside = [name for name, path in _subfolders(root).items() if (path / "session.toml").is_file()]
    if inside:
        return f"name a session in it: {', '.join(inside[:3])}"
    if (root.parent / "session.toml").is_file() and root.name in _GROUPS:
        return f"name the folder above: {root.parent}"
    files = [path.name for path in root.iterdir() if path.is_file()]
    near = _near("session.toml", files)
    if near:
        return f"rename {near[0]} to session.toml"
    return f"write session.toml: {EXAMPLE}"


# --- Which cameras? ---


def _cameras(
    root: Path, settings: Settings, folders: Mapping[str, Mapping[str, Path]]
) -> tuple[str, ...]:
    """Return the camera names, the reference first, after checking the folders against them."""
    source = "shaft" if (root / "shaft").is_dir() else "board"
    listed = settings.camera_names
    names = tuple(_nfc(name) for name in listed) if listed else tuple(sorted(folders[source]))
    if len(names) < 2:
        has = f"only one camera folder, {names[0]}" if names else "no camera folders"
        raise SessionError(
            f"has {has}; at least two cameras must see the shaft",
            next_step=f"put each camera's images into a folder of its own: {source}/left/000.png, "
            f"{source}/right/000.png",
            path=root / source,
        )
    for group in _GROUPS:
        if (root / group).is_dir():
            _check_camera_folders(root / group, names, folders[group], listed=listed is not None)
    return _reference_first(root, names, settings.reference)


def _check_camera_folders(
    group: Path, names: tuple[str, ...], folders: Mapping[str, Path], *, listed: bool
) -> None:
    """Check that a group's folders are those of the cameras.

    A folder that no camera claims is a mistake, unless the session lists its cameras and the folder
    looks like none of them. Only ``board`` and ``shaft`` need every camera.
    """
    missing = [name for name in names if name not in folders]
    for stray in (name for name in folders if name not in names):
        near = _near(stray, missing)
        if near or not listed:
            raise SessionError(
                f"is the folder of no camera; the cameras are {', '.join(names)}",
                next_step=f"rename it to {near[0]}"
                if near
                else "rename or remove it, or list "
                "the cameras in session.toml: [cameras] names = [...]",
                path=group / stray,
            )
    if missing and group.name in ("board", "shaft"):
        raise SessionError(
            f"no such folder, but {missing[0]} is one of the cameras: {', '.join(names)}",
            next_step=f"add the images of {missing[0]}, or correct [cameras] names in session.toml",
            path=group / missing[0],
        )


def _reference_first(root: Path, names: tuple[str, ...], reference: str | None) -> tuple[str, ...]:
    first = min(names) if reference is None else _nfc(reference)
    if first not in names:
        near = _near(first, names)
        hint = f" Did you mean '{near[0]}'?" if near else ""
        raise SessionError(
            f"cameras.reference: '{first}' is no camera; they are {', '.join(names)}.{hint}",
            next_step="correct session.toml",
            path=root / "session.toml",
        )
    return (first, *(name for name in names if name != first))


# --- Which images? ---


def _views(
    root: Path,
    group: str,
    folders: Mapping[str, Path],
    cameras: Iterable[str],
    *,
    ignored: list[str],
) -> Views:
    """List the images of a group by stem and camera; what is no image goes to `ignored`."""
    found: dict[str, dict[str, ImageFile]] = {}
    for camera in (name for name in cameras if name in folders):
        single = f"{camera}/" if group in ("intrinsics", "background") else ""
        if folders[camera].is_file():
            for frame in _frames(root, folders[camera], camera, f"{group}/{single}"):
                found.setdefault(str(frame.frame), {})[camera] = frame
            continue
        for stem, path in _images(folders[camera], ignored).items():
            name = path.relative_to(root).as_posix()
            view = f"{group}/{single}{stem}"
            found.setdefault(stem, {})[camera] = ImageFile(path, name, camera, view)
    if group == "shaft":
        _check_lengths(root / group, folders)
    in_order = sorted(found, key=natural_order)
    return MappingProxyType({stem: MappingProxyType(found[stem]) for stem in in_order})


def _videos(group: Path) -> dict[str, Path]:
    """Return the videos in a group's folder by camera; none beside a folder of the same name."""
    videos: dict[str, Path] = {}
    for path in sorted(group.iterdir()) if group.is_dir() else ():
        if path.name.startswith(".") or path.suffix.lower() not in video.EXTENSIONS:
            continue
        name = _nfc(path.stem)
        if name in videos or (group / path.stem).is_dir():
            raise SessionError(
                f"holds {path.name} and other frames of the same camera",
                next_step="keep one of them",
                path=group,
            )
        videos[name] = path
    return videos


def _frames(root: Path, path: Path, camera: str, view: str) -> list[ImageFile]:
    """List the frames of one camera's video."""
    name = path.relative_to(root).as_posix()
    return [ImageFile(path, name, camera, f"{view}{i}", i) for i in range(_length(path))]


def _length(path: Path) -> int:
    try:
        return video.frame_count(path)
    except ImageError as error:
        raise SessionError(error.what, next_step=error.next_step, path=path) from error


def _check_lengths(group: Path, folders: Mapping[str, Path]) -> None:
    """Check that videos have equally many frames: a number is one moment only then."""
    counts = {path.name: _length(path) for path in folders.values() if path.is_file()}
    if len(set(counts.values())) > 1:
        shown = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise SessionError(
            f"holds videos of different numbers of frames ({shown}), so it is unknown which frames "
            "are of one moment",
            next_step="start and stop the cameras together, or cut the videos to the same moments",
            path=group,
        )
    if counts and len(counts) < len(folders):
        raise SessionError(
            "holds a video of one camera and images of another, so it is unknown which are of one "
            "moment",
            next_step="give all cameras a video, or none",
            path=group,
        )


def _images(folder: Path, ignored: list[str]) -> dict[str, Path]:
    """Return one camera's image files by stem."""
    images: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or path.name.casefold() in _CLUTTER:
            continue
        if path.is_dir() or path.suffix.lower() not in EXTENSIONS:
            ignored.append(f"{folder.parent.name}/{folder.name}/{path.name}")
            continue
        stem = _nfc(path.stem)
        if stem in images:
            raise SessionError(
                f"holds two files for one image: {images[stem].name} and {path.name}",
                next_step="keep one of them, or give them different names",
                path=folder,
            )
        images[stem] = path
    return images


def natural_order(stem: str) -> list[tuple[str, int]]:
    """Sort key that puts 2 before 10.

    Examples
    --------
    >>> sorted(["pose10", "pose2", "Pose1"], key=natural_order)
    ['Pose1', 'pose2', 'pose10']
    """
    parts = re.findall(r"([^0-9]*)([0-9]*)", stem)
    return [(text.casefold(), int(number or -1)) for text, number in parts] + [(stem, 0)]


def _subfolders(folder: Path) -> dict[str, Path]:
    """Return the folders in a folder by name, without hidden ones."""
    if not folder.is_dir():
        return {}
    paths = sorted(folder.iterdir())
    return {_nfc(p.name): p for p in paths if p.is_dir() and not p.name.startswith(".")}


def _near(name: str, known: Iterable[str]) -> list[str]:
    """Return the known name that is nearest, if any is near; upper and lower case are the same."""
    folded = {entry.casefold(): entry for entry in known}
    return [folded[n] for n in difflib.get_close_matches(name.casefold(), folded, n=1)]


def _nfc(name: str) -> str:
    """Return a name with composed accents: macOS and others spell the same name differently."""
    try:
        name.encode("utf-8")
    except UnicodeEncodeError as error:  # the file system has bytes there that are no text
        raise SessionError(
            f"the name {name!r} is not UTF-8 text", next_step="rename it", path=name
        ) from error
    return unicodedata.normalize("NFC", name)
