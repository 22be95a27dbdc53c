"""The version, in one place."""

import hashlib
from functools import cache
from pathlib import Path

__version__ = "0.1.0"


@cache
def build() -> str:
    """Name the version and the code that runs: two states of the code may bear one version.

    The second part begins the SHA-256 of all files of the package, whatever their line ends.
    """
    package = Path(__file__).parent
    files = sorted(x for x in package.rglob("*") if x.is_file() and x.suffix != ".pyc")
    whole = hashlib.sha256()
    for file in files:
        content = file.read_bytes().replace(b"\r\n", b"\n")
        whole.update(f"{file.relative_to(package).as_posix()} {len(content)} ".encode() + content)
    return f"{__version__} (code {whole.hexdigest()[:12]})"


def software() -> str:
    """Return what files written by this code say they come from."""
    return f"pivometer {build()}"
