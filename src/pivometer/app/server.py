"""Serve the app: pages, live pictures and files, all behind the guard."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from pathlib import Path

from nicegui import app, ui

from pivometer.app import HOST
from pivometer.app.addresses import add_addresses
from pivometer.app.calibrate_page import calibrate_page
from pivometer.app.guard import Guard, new_token
from pivometer.app.opening import open_browser
from pivometer.app.poses_page import poses_page
from pivometer.app.report_page import report_page
from pivometer.app.result_page import result_page
from pivometer.app.setup_page import setup_page
from pivometer.app.watcher import Watcher
from pivometer.app.work import Work


def serve(folder: Path, *, port: int, browser: bool) -> None:
    """Serve one session folder until interrupted.

    Parameters
    ----------
    folder
        The session folder.
    port
        A free port of the loopback address.
    browser
        Whether to open the browser.
    """
    token = new_token()
    url = f"http://{HOST}:{port}/?token={token}"
    work = Work(folder)
    watcher = Watcher(work)
    opened: list[Path] = []

    def started() -> None:
        work.open_saved_cameras()
        watcher.start()
        sys.stdout.write(f"Pivometer: {url}\nStop with Ctrl+C.\n")
        sys.stdout.flush()
        if browser:
            opened.append(open_browser(url))

    def stopped() -> None:
        watcher.stop()
        work.close_cameras()
        for page in opened:
            with contextlib.suppress(OSError):
                page.unlink()

    _add_pages(work, watcher)
    add_addresses(work)
    app.add_middleware(Guard, token=token, port=port)
    # Quasar's bar over the page has no name for screen readers, and would never rest here.
    app.config.quasar_config["loadingBar"]["skipHijack"] = True
    app.on_startup(started)
    app.on_shutdown(stopped)
    with contextlib.suppress(KeyboardInterrupt):  # stopped as it says, after all is closed
        ui.run(
            host=HOST,
            port=port,
            title="Pivometer",
            dark=None,
            language="en-US",
            reload=False,
            show=False,
            show_welcome_message=False,
            gzip_middleware_factory=None,
            favicon=Path(__file__).parent / "icon.svg",
        )


def _add_pages(work: Work, watcher: Watcher) -> None:
    """Register all pages and addresses."""

    @ui.page("/")
    async def setup() -> None:
        await asyncio.to_thread(work.look_around)
        setup_page(work, watcher)

    @ui.page("/calibrate")
    async def calibrate() -> None:
        await asyncio.to_thread(work.look_around)
        calibrate_page(work, watcher)

    @ui.page("/poses")
    async def poses() -> None:
        await asyncio.to_thread(work.look_around)
        await poses_page(work, watcher)

    @ui.page("/result")
    async def result() -> None:
        await asyncio.to_thread(work.look_around)
        await result_page(work, watcher)

    @ui.page("/report")
    async def report() -> None:
        await asyncio.to_thread(work.look_around)
        await report_page(work, watcher)
