"""What the app's pages fetch: live pictures, the session's pictures, and the files it wrote."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from fastapi import Request, Response
from nicegui import app

from pivometer import pipeline
from pivometer.app.report_page import FILES
from pivometer.app.work import Work
from pivometer.errors import PivometerError
from pivometer.pipeline.capturing import MOST_PICTURE_BYTES

_WAIT_S = 2.0
_POLL_S = 0.004


def add_addresses(work: Work) -> None:
    """Register the addresses; each looks up a name in a list and never joins it to a path."""

    @app.get("/files/{name}")
    async def files(name: str, shown: str = "") -> Response:
        return await _result_file(work, name, inline=bool(shown))

    @app.put("/pictures/{group}/{camera}/{name}")
    async def add_picture(group: str, camera: str, name: str, request: Request) -> Response:
        return await _added(work, group, camera, name, request)

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


async def _result_file(work: Work, name: str, *, inline: bool) -> Response:
    """Answer with one of the files that the app offers, and no other."""
    path = work.folder / "results" / name
    if name not in FILES or not path.is_file():
        return Response(status_code=404)
    content = await asyncio.to_thread(path.read_bytes)
    how = "inline" if inline else f'attachment; filename="{name}"'
    headers = {**_FRESH, "Content-Disposition": how, "Content-Security-Policy": _ALONE}
    return Response(content, media_type=FILES[name][1], headers=headers)


async def _added(work: Work, group: str, camera: str, name: str, request: Request) -> Response:
    """Take one picture; more than is allowed of it is not even read."""
    data = bytearray()
    async for piece in request.stream():
        data += piece
        if len(data) > MOST_PICTURE_BYTES:
            return Response("the picture is too large", status_code=413)
    await asyncio.to_thread(work.reload)
    if work.session is None:
        return Response("describe the session in step 1 first", status_code=409)
    try:
        await asyncio.to_thread(
            pipeline.add_picture, work.session, group, camera, name, bytes(data)
        )
    except PivometerError as error:
        return Response(f"{error.what}; next: {error.next_step}", status_code=422)
    await asyncio.to_thread(work.reload)
    work.added += 1
    return Response(status_code=204)


async def _next_preview(work: Work, camera: str, after: int) -> Response:
    """Wait for a camera's next frame and answer with it; 204 where none comes or it is lost.

    The browser asks for the next one when it has shown the last, so a slow one skips frames.
    """
    for _ in range(round(_WAIT_S / _POLL_S)):
        feed = work.feeds.get(camera)
        if feed is None or feed.fault is not None:
            return Response(status_code=204, headers={**_FRESH, "X-Lost": "yes"})
        if feed.frames and feed.version != after:
            number, jpeg = await asyncio.to_thread(feed.jpeg)
            fresh: Mapping[str, str] = {**_FRESH, "X-Frame": str(number)}
            return Response(jpeg, media_type="image/jpeg", headers=dict(fresh))
        await asyncio.sleep(_POLL_S)
    return Response(status_code=204, headers=_FRESH)


_ALONE = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:"
)
"""A session may come from anybody: its report is shown, but is no part of the app."""
_FRESH = {"Cache-Control": "no-store"}
