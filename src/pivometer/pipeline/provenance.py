"""How and when a measurement was made."""

import hashlib
import platform
from datetime import UTC, datetime
from importlib.metadata import version

from pivometer._version import __version__
from pivometer.errors import SessionError
from pivometer.io.session import Session
from pivometer.measurement import Options, Provenance

SETTINGS = "session.toml"


def provenance_now(options: Options | None = None, *, command: str) -> Provenance:
    """State the moment, the command and the versions of what takes part in a result."""
    packages = ("numpy", "scipy", "opencv-python-headless")
    versions = {
        "pivometer": __version__,
        "Python": platform.python_version(),
        **{name: version(name) for name in packages},
    }
    created = datetime.now(UTC).isoformat(timespec="seconds")
    return Provenance(command, created, versions, options)


def settings_hash(session: Session) -> dict[str, str]:
    """Return the SHA-256 of ``session.toml``, which holds the board and the shaft's diameter.

    Raises
    ------
    SessionError
        If it cannot be read any more.
    """
    path = session.folder / SETTINGS
    try:
        return {SETTINGS: hashlib.sha256(path.read_bytes()).hexdigest()}
    except OSError as error:
        raise SessionError(
            f"cannot be read: {error.strerror}", next_step="leave it in place", path=path
        ) from error
