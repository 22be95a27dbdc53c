"""Run what a page shows, in the order of the page, in a folder of its own."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from http import HTTPStatus
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import yaml
from tests.documented.pages import Step, UnreadableBlockError
from tests.documented.printed import difference

from pivometer.cli import main
from pivometer.io import exclusions, joints
from pivometer.io.session import load
from pivometer.io.settings import read_settings

NOT_RUN = {
    "pip install ": "it would change the environment that the tests run in",
    "make ": "each target sets up an environment of its own, and `make test` runs this test",
    "python -m benchmarks.": "a benchmark takes minutes",
}
"""Commands that only stand there, by how they begin, and why."""

BOARD = '[board]\nkind = "checkerboard"\nsquares = [9, 7]\nsquare_mm = 15.0\n'
"""What an excerpt of a session.toml leaves out."""

ANSWERS_WITHIN_S = 60.0
"""Of a loaded test machine; the app itself starts and stops in one or two seconds."""


class StepFailedError(AssertionError):
    """What a page shows does not do what the page says."""


def reason_not_to_run(command: str) -> str | None:
    """Return why a command only stands there; `None` where it is to be run."""
    return next((why for start, why in NOT_RUN.items() if command.startswith(start)), None)


@dataclass
class PageRun:
    """A page that is being followed, as far as was asked for.

    Parameters
    ----------
    steps
        Its steps in order.
    folder
        The folder that its reader works in.
    provide
        Puts what the page takes for granted into the folder, before a step that needs it.
    """

    steps: list[Step]
    folder: Path
    provide: Callable[[Step, Path], None]
    names: dict[str, Any] = field(default_factory=dict)
    outcomes: list[str | Exception] = field(default_factory=list)

    def follow(self, step: Step) -> None:
        """Follow the page up to a step, and hold what the page shows against what it prints.

        Raises
        ------
        Exception
            If the step fails, whether its exit code or its output is another.
        """
        printed = self.printed_by(step)
        wrong = None if step.shown is None else difference(step.shown, printed)
        if wrong is not None:
            raise StepFailedError(f"{step}: {wrong}\n{printed}")

    def printed_by(self, step: Step) -> str:
        """Follow the page up to a step; return what it prints, or raise what it raised."""
        number = self.steps.index(step)
        while len(self.outcomes) <= number:
            self.outcomes.append(self._outcome(self.steps[len(self.outcomes)]))
        outcome = self.outcomes[number]
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def _outcome(self, step: Step) -> str | Exception:
        self.folder.mkdir(parents=True, exist_ok=True)
        try:
            self.provide(step, self.folder)
            with contextlib.chdir(self.folder):
                return self._run(step)
        except Exception as error:  # noqa: BLE001 - the step's own test tells it
            return error

    def _run(self, step: Step) -> str:
        if step.kind == "sh":
            return run_command(step)
        if step.kind == "python":
            return self._run_python(step)
        {"toml": read_toml, "yaml": self._run_workflow, "": read_tree}[step.kind](step)
        return ""

    def _run_python(self, step: Step) -> str:
        """Run a block as a notebook would: names stay, and a last expression is no fault."""
        code = compile("\n" * step.line + step.text, step.page, "exec")
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(code, self.names)  # noqa: S102 - our own pages
        return printed.getvalue()

    def _run_workflow(self, step: Step) -> None:
        """Run the command lines of a workflow's steps; what others wrote only stands there."""
        jobs = yaml.safe_load(step.text)
        if not all(isinstance(job, dict) and ("run" in job or "uses" in job) for job in jobs):
            raise StepFailedError(f"{step}: has steps that neither run nor use anything")
        for line in (line for job in jobs for line in job.get("run", "").splitlines()):
            run_command(Step(step.page, step.line, "sh", line))


def run_command(step: Step) -> str:
    """Run one command line, and return what it prints."""
    if reason_not_to_run(step.text) is not None:
        return ""
    words = shlex.split(step.text, comments=True)
    if words[:1] != ["pivometer"] or {"|", ">", "&&", ";"} & set(words):
        raise UnreadableBlockError(f"{step}: nobody knows how to run this, or why not")
    if words[1] == "app":
        return served(step, words)
    errors = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()) as printed, contextlib.redirect_stderr(errors):
        code = main(words[1:])
    if code != step.code:
        raise StepFailedError(
            f"{step}: exit code {code}, the page says {step.code}\n"
            f"{printed.getvalue()}{errors.getvalue()}"
        )
    return printed.getvalue()


def served(step: Step, words: list[str]) -> str:
    """Start the app, open the address that it prints, and stop it as a user does."""
    nothing = f"{shlex.quote(sys.executable)} -c pass %s"
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST")}
    with subprocess.Popen(  # noqa: S603 - our own pages
        [sys.executable, "-m", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment | {"BROWSER": nothing},
    ) as process:
        stop = threading.Timer(ANSWERS_WITHIN_S, process.kill)
        stop.start()
        try:
            assert process.stdout is not None
            said = process.stdout.readline()
            found = re.search(r"http://127\.0\.0\.1:(\d+)(/\?token=\S+)", said)
            status, body = 0, b""
            if found:
                status, body = _opened(int(found[1]), found[2])
                process.send_signal(signal.SIGINT)
            rest = process.stdout.read()
            process.wait()
        finally:
            stop.cancel()
            process.kill()
    if status != HTTPStatus.OK or b"Pivometer" not in body or process.returncode != step.code:
        raise StepFailedError(f"{step}: {status}, exit code {process.returncode}\n{said}{rest}")
    return said + rest


def _opened(port: int, path: str) -> tuple[int, bytes]:
    """Open the app's address as a browser does: until it listens, and where it sends on to."""
    end = time.monotonic() + ANSWERS_WITHIN_S
    while True:
        try:
            status, headers, body = _get(port, path, {})
        except ConnectionRefusedError:
            if time.monotonic() > end:
                raise
            time.sleep(0.05)
            continue
        if status != HTTPStatus.SEE_OTHER:
            return status, body
        cookie = headers["set-cookie"].partition(";")[0]
        status, _, body = _get(port, headers["location"], {"Cookie": cookie})
        return status, body


def _get(port: int, path: str, sent: dict[str, str]) -> tuple[int, dict[str, str], bytes]:
    connection = HTTPConnection("127.0.0.1", port, timeout=ANSWERS_WITHIN_S)
    with contextlib.closing(connection):
        connection.request("GET", path, headers=sent)
        answer = connection.getresponse()
        headers = {name.lower(): value for name, value in answer.getheaders()}
        return answer.status, headers, answer.read()


def read_toml(step: Step) -> None:
    """Read a session.toml, or a part of one, as a session's is read."""
    file = Path("shown.toml")
    file.write_text(step.text if "[board]" in step.text else BOARD + step.text, encoding="utf-8")
    read_settings(file)


def read_tree(step: Step) -> None:
    """Make the folder that is drawn, and read it as a session: nothing in it may be ignored."""
    first, *lines = step.text.splitlines()
    root = Path("drawn") / first
    for name in re.findall(
        r"^ +(?:\(or )?(\S+)|(?<=\s)(\S+/\S+?)(?=[\s)])", "\n".join(lines), re.MULTILINE
    ):
        _make(root / (name[0] or name[1]).rstrip(")"))
    read = load(root)
    if read.ignored:
        raise StepFailedError(f"{step}: draws what a session ignores: {', '.join(read.ignored)}")


def _make(path: Path) -> None:
    """Make a file that is drawn, but for tables, and videos that stand in place of images."""
    if path.suffix == ".mp4" or path.name in (exclusions.FILE_NAME, joints.FILE_NAME):
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(BOARD if path.name == "session.toml" else "", encoding="utf-8")
