"""Whether a report or a result still says what its inputs say."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path

from pivometer.calibration import Calibration
from pivometer.errors import PivometerError, UsageError
from pivometer.io.result import result_content
from pivometer.io.session import load
from pivometer.measurement import ImportedRig, Measurement, Options, Provenance
from pivometer.pipeline.checking import with_decision
from pivometer.pipeline.differences import differences
from pivometer.pipeline.examining import Examined, Opened, named, opened_file, seal_examined
from pivometer.pipeline.measuring import measure
from pivometer.pipeline.provenance import SETTINGS
from pivometer.pipeline.reading import Progress
from pivometer.pipeline.showing_again import shown_again


@dataclass(frozen=True, slots=True, eq=False)
class Verification:
    """What was verified of a file.

    Parameters
    ----------
    file
        The file.
    examined
        Everything that was looked at, in order.
    """

    file: Path
    examined: tuple[Examined, ...]

    @property
    def exit_code(self) -> int:
        """0 all holds, 4 something changed, 5 something could not be checked."""
        statuses = {one.status for one in self.examined}
        return 4 if "changed" in statuses else 5 if "not checked" in statuses else 0

    @property
    def sentence(self) -> str:
        """The outcome in one sentence."""
        changed, unchecked = (
            [one.name for one in self.examined if one.status == status]
            for status in ("changed", "not checked")
        )
        if changed:
            return f"Changed: {', '.join(changed)}."
        if unchecked:
            return f"Nothing found changed, but not all could be checked: {', '.join(unchecked)}."
        return "Verified: everything is as it was when the report was made."


def verify(
    file: Path | str,
    session: Path | str | None = None,
    *,
    rig: Calibration | ImportedRig | None = None,
    file_only: bool = False,
    progress: Progress | None = None,
) -> Verification:
    """Verify a report or a result: its own bytes, its inputs, and every figure.

    Parameters
    ----------
    file
        A ``result.json``, ``report.html`` or ``report.pdf`` that Pivometer wrote.
    session
        The session folder; the one the file lies in, or in whose ``results`` it lies, where none
        is given.
    rig
        The calibration that the measurement was given, if it was given one: without it that in the
        file is used, and not checked.
    file_only
        Whether to leave the session alone, and look at the file only.
    progress
        Called as ``progress(stage, done, total)``.

    Raises
    ------
    UsageError
        If the file cannot be read or is none of Pivometer's, or `session` is no session.
    """
    path = Path(file)
    opened = opened_file(path)
    if isinstance(opened, Examined):
        return Verification(path, (opened,))
    found = [*opened.examined, seal_examined(opened.content)]
    if not file_only:
        folder = _session_of(path) if session is None else _folder(Path(session))
        found += _against_session(opened, folder, rig, progress)
    return Verification(path, tuple(found))


def _folder(session: Path) -> Path:
    if not session.is_dir():
        raise UsageError("is no folder", next_step="name the session’s folder", path=session)
    return session


def _session_of(path: Path) -> Path | None:
    """Return the session that a file lies in."""
    near = path.resolve().parents[:2]
    return next((folder for folder in near if (folder / SETTINGS).is_file()), None)


# --- Its inputs ---


def _against_session(
    opened: Opened,
    folder: Path | None,
    rig: Calibration | ImportedRig | None,
    progress: Progress | None,
) -> Iterator[Examined]:
    if folder is None:
        text = "the file lies in no session: name the session's folder, too"
        yield Examined("the inputs", "not checked", text)
        yield Examined("the figures", "not checked", "without inputs nothing can be measured again")
        return
    inputs = _inputs(opened.measurement.inputs, folder)
    yield inputs
    if opened.report is not None and inputs.status != "changed":
        yield from shown_again(opened.report, opened.measurement, folder, progress)
    provenance = opened.measurement.provenance
    if rig is None and provenance and provenance.options and provenance.options.rig_given:
        text = "it came from elsewhere and is taken as the file states it: name it with --rig"
        yield Examined("the calibration", "not checked", text)
    yield _figures(opened, folder, inputs, rig, progress)


def _inputs(stated: Mapping[str, str], folder: Path) -> Examined:
    """Compare the hashes of all files."""
    changed = []
    for name, digest in stated.items():
        found = _digest(folder / name) if _is_inside(name) else None
        if found != digest:
            changed.append(name if found else f"{name} (missing)")
    if changed:
        return Examined("the inputs", "changed", named(changed))
    if SETTINGS not in stated:
        text = f"{len(stated)} files are unchanged, but {SETTINGS} was not recorded then"
        return Examined("the inputs", "not checked", text)
    return Examined("the inputs", "holds", f"{len(stated)} files, byte for byte")


def _is_inside(name: str) -> bool:
    """Tell whether a name stays in the session: a file from elsewhere is not to be trusted."""
    path = Path(name)
    return not path.is_absolute() and ".." not in path.parts


def _digest(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


# --- Its figures ---


def _figures(
    opened: Opened,
    folder: Path,
    inputs: Examined,
    rig: Calibration | ImportedRig | None,
    progress: Progress | None,
) -> Examined:
    """Measure again and compare."""
    name, provenance = "the figures", opened.measurement.provenance
    if inputs.status == "changed":
        return Examined(name, "not checked", "the inputs are not those they were measured from")
    if provenance is None or provenance.options is None:
        return Examined(name, "not checked", "the file does not state how it was measured")
    try:
        again = _measured_again(opened.measurement, provenance.options, folder, rig, progress)
    except PivometerError as error:
        return Examined(name, "changed", f"measured again, the session is refused: {error.what}")
    unknown = again.inputs.keys() - opened.measurement.inputs.keys() - {SETTINGS}
    if unknown:
        text = f"the session has files that were not there then: {named(sorted(unknown))}"
        return Examined(name, "changed", text)
    found = differences(opened.content, result_content(again))
    if found.beyond:
        other = _other_versions(provenance, again)
        return Examined(name, "changed", f"{named(found.beyond)}{other}")
    how = "to the last bit"
    if not found.identical:
        how = f"within {found.largest:.0e} of their size; rounding may make {found.TOLERANCE:g}"
    return Examined(name, "holds", f"{found.count} measured again are the same {how}")


def _other_versions(provenance: Provenance, again: Measurement) -> str:
    """Name the software that differs from what the file was made with."""
    now = again.provenance.versions if again.provenance else {}
    others = [
        f"{name} {version}, now {now[name]}"
        for name, version in provenance.versions.items()
        if now.get(name, version) != version
    ]
    return f" (made with {', '.join(others)})" if others else ""


def _measured_again(
    measurement: Measurement,
    options: Options,
    folder: Path,
    rig: Calibration | ImportedRig | None,
    progress: Progress | None,
) -> Measurement:
    asked = {field.name: getattr(options, field.name) for field in fields(options)}
    given = (rig or measurement.calibration) if asked.pop("rig_given") else None
    again = measure(load(folder), rig=given, floor=measurement.floor, progress=progress, **asked)
    decided = measurement.decision
    if decided is None:
        return again
    return with_decision(again, decided.limit_mm, guard_mm=decided.guard_mm)
