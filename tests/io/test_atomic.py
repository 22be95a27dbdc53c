import errno
import os
from pathlib import Path

import pytest

from pivometer.errors import UsageError
from pivometer.io.atomic import replaced_folder, write_file, write_files


def content(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text(encoding="utf-8") for path in sorted(folder.iterdir())}


def test_files_are_written_and_replaced_and_others_stay(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "results"
    write_files(folder, {"x": "1", "y": b"2"})
    (folder / "mine").write_text("kept", encoding="utf-8")
    paths = write_files(folder, {"x": "3\n"})
    assert content(folder) == {"x": "3\n", "y": "2", "mine": "kept"}
    assert paths == {"x": folder / "x"}
    assert write_file(folder / "é", "ü") == folder / "é"


def test_files_are_readable_by_whom_the_umask_lets(tmp_path: Path) -> None:
    previous = os.umask(0o022)
    try:
        path = write_file(tmp_path / "x", "1")
    finally:
        os.umask(previous)
    assert path.stat().st_mode & 0o777 == 0o644


def test_a_run_that_fails_leaves_the_old_results(tmp_path: Path) -> None:
    write_files(tmp_path, {"a": "old a", "b": "old b"})
    (tmp_path / "c").mkdir()  # in the way of the third file
    with pytest.raises(UsageError, match="cannot be written") as caught:
        write_files(tmp_path, {"a": "new a", "n": "new n", "c": "new c", "b": "new b"})
    assert caught.value.path == tmp_path
    (tmp_path / "c").rmdir()
    assert content(tmp_path) == {"a": "old a", "b": "old b"}


def test_a_full_disk_leaves_the_old_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_files(tmp_path, {"a": "old a"})

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(UsageError, match="cannot be written: No space left on device"):
        write_files(tmp_path, {"a": "new a"})
    assert content(tmp_path) == {"a": "old a"}


def test_a_drive_that_cannot_sync_is_written_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def cannot(_: int) -> None:
        raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr(os, "fsync", cannot)
    write_files(tmp_path, {"a": "1"})
    assert content(tmp_path) == {"a": "1"}


def test_a_path_through_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(UsageError, match="cannot be written: Not a directory"):
        write_files(tmp_path / "file" / "results", {"a": "1"})


def make(folder: Path, text: str, *, fail: bool = False) -> None:
    with replaced_folder(folder, mark="truth.json") as root:
        (root / "truth.json").write_text(text, encoding="utf-8")
        if fail:
            raise KeyboardInterrupt


def test_a_folder_appears_whole_and_is_replaced_whole(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "demo"
    make(folder, "1")
    (folder / "results").mkdir()
    make(folder, "2")
    assert content(folder) == {"truth.json": "2"}
    assert [path.name for path in folder.parent.iterdir()] == ["demo"]


def test_an_empty_folder_is_filled(tmp_path: Path) -> None:
    (tmp_path / "demo").mkdir()
    make(tmp_path / "demo", "1")
    assert content(tmp_path / "demo") == {"truth.json": "1"}


def test_an_interrupted_run_leaves_the_old_folder(tmp_path: Path) -> None:
    make(tmp_path / "demo", "1")
    with pytest.raises(KeyboardInterrupt):
        make(tmp_path / "demo", "2", fail=True)
    assert content(tmp_path / "demo") == {"truth.json": "1"}
    assert [path.name for path in tmp_path.iterdir()] == ["demo"]


def test_a_folder_of_someone_else_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("", encoding="utf-8")
    with pytest.raises(UsageError, match=r"holds no truth.json, so it was not made by this"):
        make(tmp_path, "1")
    with pytest.raises(UsageError, match="is a file"):
        make(tmp_path / "thesis.tex", "1")
    assert content(tmp_path) == {"thesis.tex": ""}
