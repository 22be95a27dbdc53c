"""Write files whole or not at all.

Everything is first written beside its destination and then moved there in one step, so a reader
sees the old content or the new, and a run that fails leaves the old.
"""

import errno
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from pivometer.errors import UsageError


def write_file(path: Path | str, content: str | bytes) -> Path:
    """Write one file, UTF-8 where it is text, replacing what is there only when all is written.

    Parameters
    ----------
    path
        The file; its folder is made where it does not exist.
    content
        Text (line ends are kept as they are) or bytes.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    UsageError
        If it cannot be written.
    """
    target = Path(path)
    return write_files(target.parent, {target.name: content})[target.name]


def write_files(folder: Path | str, contents: Mapping[str, str | bytes]) -> dict[str, Path]:
    """Write several files of one folder: all of them, or none.

    All are written beside their destinations before the first one is replaced; should replacing one
    fail, those already replaced get their old content back. Other files in the folder stay.

    Parameters
    ----------
    folder
        The folder; made where it does not exist.
    contents
        Text or bytes by file name.

    Returns
    -------
    dict
        The files by name.

    Raises
    ------
    UsageError
        If one cannot be written.
    """
    root = Path(folder)
    targets = {name: root / name for name in contents}
    with _writing(root):
        root.mkdir(parents=True, exist_ok=True)
        staging = root / f".writing-{uuid4().hex}"
        staging.mkdir()
        try:
            for name, content in contents.items():
                _write_through(staging / name, content)
            _move_all({staging / name: target for name, target in targets.items()})
        finally:
            shutil.rmtree(staging, ignore_errors=True)
    return targets


@contextmanager
def replaced_folder(folder: Path | str, *, mark: str) -> Iterator[Path]:
    """Fill a whole new folder, which takes its place when the block ends well.

    Parameters
    ----------
    folder
        The folder to make. One that is there is replaced if it is empty or bears the mark.
    mark
        Name of a file that only folders made this way hold, such as ``truth.json``: no other
        folder is ever replaced.

    Yields
    ------
    pathlib.Path
        The folder to write into, beside the final one.

    Raises
    ------
    UsageError
        If another folder, or a file, is in the way, or nothing can be written there.
    """
    target = Path(os.path.realpath(folder))
    _check_replaceable(target, mark)
    staging = target.with_name(f".{target.name}-writing-{uuid4().hex}")
    with _writing(target):
        staging.mkdir(parents=True)
        try:
            yield staging
            _move_folder(staging, target)
        finally:
            shutil.rmtree(staging, ignore_errors=True)


def _check_replaceable(target: Path, mark: str) -> None:
    if target.is_file():
        raise UsageError("is a file", next_step="name a folder", path=target)
    if target.is_dir() and any(target.iterdir()) and not (target / mark).is_file():
        raise UsageError(
            f"is there already and holds no {mark}, so it was not made by this command",
            next_step="name a new or an empty folder",
            path=target,
        )


def _move_folder(staging: Path, target: Path) -> None:
    """Put `staging` in the place of `target`, or leave `target` as it was."""
    old = target.with_name(f".{target.name}-old-{uuid4().hex}")
    if target.exists():
        target.replace(old)
    try:
        staging.replace(target)
    except OSError:
        if old.exists():
            old.replace(target)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _move_all(moves: Mapping[Path, Path]) -> None:
    """Move every file to its target, or put back what was there."""
    before = {target: target.read_bytes() for target in moves.values() if target.is_file()}
    done: list[Path] = []
    try:
        for source, target in moves.items():
            source.replace(target)
            done.append(target)
    except OSError:
        for target in done:
            if target in before:
                _write_through(target, before[target])
            else:
                target.unlink()
        raise


def _write_through(path: Path, content: str | bytes) -> None:
    """Write and wait until the disk has it: a file that is moved into place must be whole."""
    data = content.encode("utf-8") if isinstance(content, str) else content
    with path.open("wb") as stream:
        stream.write(data)
        stream.flush()
        try:
            os.fsync(stream.fileno())
        except OSError as error:  # some network drives cannot; the content is written all the same
            if error.errno not in (errno.EINVAL, errno.ENOTSUP):
                raise


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Turn what the operating system refuses into a message."""
    try:
        yield
    except OSError as error:
        raise UsageError(
            f"cannot be written: {error.strerror or error}",
            next_step="check the disk and the permissions, or name another folder",
            path=path,
        ) from error
