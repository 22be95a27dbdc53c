"""The app: leads a person through a measurement in the browser of this computer.

It parses what the person does, calls functions of `pivometer.pipeline` and shows what they return.
The session folder is the only truth (decision 18).
"""

from __future__ import annotations

import importlib.util
import os
import socket
from pathlib import Path

from pivometer.errors import UsageError

HOST = "127.0.0.1"
MOST_PIXELS = 2**27
"""Of a picture that is sent: a small file can unpack to gigabytes. 134 million are more than any
camera's."""


def run_app(folder: Path, *, port: int = 0, browser: bool = True) -> None:
    """Serve the app for one session folder until it is interrupted.

    Parameters
    ----------
    folder
        The session folder; a new one is described in the app.
    port
        The port on the loopback address; a free one where it is 0.
    browser
        Whether to open the browser.

    Raises
    ------
    UsageError
        If the extra is not installed, the port is taken, or the folder is a file.
    """
    if importlib.util.find_spec("nicegui") is None:
        raise UsageError(
            "the app needs NiceGUI, which is not installed",
            next_step='pip install "pivometer[app]"',
        )
    if folder.exists() and not folder.is_dir():
        raise UsageError("is a file, not a session folder", next_step="name a folder", path=folder)
    chosen = free_port(port)
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MOST_PIXELS))  # before it is imported
    from pivometer.app.server import serve

    serve(folder, port=chosen, browser=browser)


def free_port(port: int) -> int:
    """Return a port of the loopback address that is free: the one asked for, or any for 0.

    Raises
    ------
    UsageError
        If it is taken.
    """
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except (OSError, OverflowError) as error:
            raise UsageError(
                f"port {port} of this computer cannot be used: {error}",
                next_step="name another one with --port, or none",
            ) from error
        return int(probe.getsockname()[1])
