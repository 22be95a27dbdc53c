"""The app as a process of its own, as a user starts it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from http.client import HTTPConnection
from pathlib import Path

import pytest

STARTS_WITHIN_S = 60.0
"""Of a loaded test machine; the app itself starts in one or two seconds."""


@dataclass(frozen=True)
class RunningApp:
    port: int
    token: str
    process: subprocess.Popen[str]

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/?token={self.token}"

    def get(
        self,
        path: str,
        headers: dict[str, str] | None = None,
        *,
        cookie: bool = False,
        put: bytes | None = None,
    ) -> tuple[int, dict[str, str], bytes]:
        sent = dict(headers or {})
        if cookie:
            sent["Cookie"] = f"pivometer-{self.port}={self.token}"
        connection = HTTPConnection("127.0.0.1", self.port, timeout=20)
        try:
            connection.request("GET" if put is None else "PUT", path, body=put, headers=sent)
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read()
        finally:
            connection.close()


def _answers(port: int) -> bool:
    connection = HTTPConnection("127.0.0.1", port, timeout=5)
    try:
        connection.request("GET", "/")
        return connection.getresponse().status == 403
    except OSError:
        return False
    finally:
        connection.close()


def start(folder: Path) -> RunningApp:
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST")}
    process = subprocess.Popen(  # noqa: S603
        [sys.executable, "-m", "pivometer", "app", str(folder), "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=folder.parent,
        env=environment,
    )
    assert process.stdout is not None
    said = process.stdout.readline()
    found = re.search(r"http://127\.0\.0\.1:(\d+)/\?token=(\S+)", said)
    if found is None:
        process.kill()
        raise AssertionError(said + process.stdout.read())
    running = RunningApp(int(found[1]), found[2], process)
    end = time.monotonic() + STARTS_WITHIN_S
    while not _answers(running.port):
        assert time.monotonic() < end
        time.sleep(0.05)
    return running


@pytest.fixture(scope="module")
def start_app() -> Iterator[Callable[[Path], RunningApp]]:
    running: list[RunningApp] = []

    def started(folder: Path) -> RunningApp:
        running.append(start(folder))
        return running[-1]

    yield started
    for one in running:
        one.process.send_signal(signal.SIGINT)
        try:
            one.process.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            one.process.kill()
            one.process.communicate()
