"""How and when a measurement was made."""

import hashlib
import platform
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from pivometer._version import build
from pivometer.errors import SessionError
from pivometer.io.exclusions import FILE_NAME as EXCLUSIONS
from pivometer.io.session import Session
from pivometer.measurement import Options, Provenance

SETTINGS = "session.toml"


def provenance_now(options: Options | None = None, *, command: str) -> Provenance:
    """State the moment, the command and the versions of what takes part in a result."""
    packages = ("numpy", "scipy", "opencv-python-headless")
    versions = {
        "pivometer": build(),
        "Python": platform.python_version(),
        **{name: version(name) for name in packages},
    }
    created = datetime.now(UTC).isoformat(timespec="seconds")
    return Provenance(command, created, versions, options)


def settings_hashes(session: Session) -> dict[str, str]:
    """Return the SHA-256 of what is no picture: ``session.toml``, and ``exclusions.csv`` if any.

    Raises
    ------
    SessionError
        If one cannot be read any more.
    """
    names = [SETTINGS, *([EXCLUSIONS] if (session.folder / EXCLUSIONS).is_file() else [])]
    return {name: _sha256(session.folder / name) for name in names}


def _sha256(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise SessionError(
            f"cannot be read: {error.strerror}", next_step="leave it in place", path=path
        ) from error
