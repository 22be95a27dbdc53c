"""Serve the app: pages, live pictures and files, all behind the guard."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
from collections.abc import Mapping
from pathlib import Path

from fastapi import Response
from nicegui import app, ui

from pivometer import pipeline
from pivometer.app import HOST
from pivometer.app.calibrate_page import calibrate_page
from pivometer.app.guard import Guard, new_token
from pivometer.app.opening import open_browser
from pivometer.app.poses_page import poses_page
from pivometer.app.setup_page import setup_page
from pivometer.app.watcher import Watcher
from pivometer.app.work import Work
from pivometer.errors import PivometerError

_WAIT_S = 2.0
_POLL_S = 0.004


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
    app.add_middleware(Guard, token=token, port=port)
    app.on_startup(started)
    app.on_shutdown(stopped)
    os.environ.setdefault("MATPLOTLIB", "false")  # NiceGUI would import it for nothing
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
    def setup() -> None:
        setup_page(work, watcher)

    @ui.page("/calibrate")
    def calibrate() -> None:
        calibrate_page(work, watcher)

    @ui.page("/poses")
    async def poses() -> None:
        await poses_page(work, watcher)

    @app.get("/pictures/{camera}/{view:path}")
    async def pictures(camera: str, view: str) -> Response:
        if work.session is None:
            return Response(status_code=404)
        try:
            jpeg = await asyncio.to_thread(pipeline.picture, work.session, view, camera)
        except PivometerError as error:
            return Response(str(error.what), status_code=404)
        return Response(jpeg, media_type="image/jpeg", headers=_FRESH)

    @app.get("/live/{camera}.jpg")
    async def live(camera: str, after: int = -1) -> Response:
        return await _next_preview(work, camera, after)


async def _next_preview(work: Work, camera: str, after: int) -> Response:
    """Wait for a camera's next frame and answer with it; 204 where none comes or it is lost.

    The browser asks for the next one when it has shown the last, so a slow one skips frames.
    """
    for _ in range(round(_WAIT_S / _POLL_S)):
        feed = work.feeds.get(camera)
        if feed is None or feed.fault is not None:
            return Response(status_code=204, headers={**_FRESH, "X-Lost": "yes"})
        frames = feed.frames
        if frames and frames[-1].number != after:
            number, jpeg = await asyncio.to_thread(feed.jpeg)
            fresh: Mapping[str, str] = {**_FRESH, "X-Frame": str(number)}
            return Response(jpeg, media_type="image/jpeg", headers=dict(fresh))
        await asyncio.sleep(_POLL_S)
    return Response(status_code=204, headers=_FRESH)


_FRESH = {"Cache-Control": "no-store"}
