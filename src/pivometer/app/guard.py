"""Who may talk to the app: the person who has its token, from its own pages, and nobody else.

The address is the loopback's, but every user and every web page of this computer can reach that.
So each request, of HTTP and of the websocket, must bring the token: once in the address that is
opened, which is answered with a cookie, then in that cookie.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_REFUSED = (
    "403: this app belongs to the person who started it. Open the address that `pivometer app` "
    "printed; it holds the token.\n"
)


def new_token() -> str:
    """Return a token that cannot be guessed: 256 random bits."""
    return secrets.token_urlsafe(32)


class Guard:
    """Let through what bears the token and comes from the app's own pages.

    Parameters
    ----------
    app
        The application behind it.
    token
        The token.
    port
        The port of the loopback address.
    """

    def __init__(self, app: ASGIApp, *, token: str, port: int) -> None:
        self._app, self._token = app, token
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self._cookie = f"pivometer-{port}"  # cookies do not know ports

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one connection, or hand it on."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        answer = self._answer(scope, headers)
        if answer is None:
            await self._app(scope, receive, _with_headers(send, headers.get("host", "")))
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        else:
            await answer(scope, receive, send)

    def _answer(self, scope: Scope, headers: Headers) -> Response | None:
        """Return what to answer instead of the app; `None` lets the request through."""
        if headers.get("host", "") not in self._hosts or not _own_page(headers):
            return PlainTextResponse(_REFUSED, status_code=403)
        if scope["type"] == "http" and scope["path"] == "/":
            given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [])
            if given:
                return self._welcome() if self._matches(given[0]) else _refused()
        return None if self._matches(_cookies(headers).get(self._cookie, "")) else _refused()

    def _matches(self, given: str) -> bool:
        """Compare in constant time, so that the token cannot be found letter by letter."""
        return hmac.compare_digest(given.encode("utf-8", "replace"), self._token.encode())

    def _welcome(self) -> Response:
        """Give the cookie, and an address without the token, which is not left in the history."""
        answer = RedirectResponse("/", status_code=303)
        answer.set_cookie(self._cookie, self._token, httponly=True, samesite="lax")
        answer.headers["Referrer-Policy"] = "no-referrer"
        answer.headers["Cache-Control"] = "no-store"
        return answer


def _refused() -> Response:
    return PlainTextResponse(_REFUSED, status_code=403)


def _own_page(headers: Headers) -> bool:
    """Tell whether a request comes from one of our pages, or from nobody's.

    Pages of other programs on this computer are of the same site for a browser, whose cookies they
    bring; so the origin decides.
    """
    origin = headers.get("origin")
    if origin is not None and origin != f"http://{headers.get('host', '')}":
        return False
    foreign = headers.get("sec-fetch-site", "none") not in ("none", "same-origin")
    return not foreign or headers.get("sec-fetch-mode") == "navigate"


def _cookies(headers: Headers) -> Mapping[str, str]:
    try:
        jar: SimpleCookie = SimpleCookie(headers.get("cookie", ""))
    except CookieError:
        return {}
    return {name: morsel.value for name, morsel in jar.items()}


def _with_headers(send: Send, host: str) -> Send:
    """Return a `send` that forbids the browser to ask any other host for anything."""
    policy = (
        "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; "
        "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
        f"connect-src 'self' ws://{host}; frame-ancestors 'self'; base-uri 'self'; "
        "form-action 'self'"
    )

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers.setdefault("Content-Security-Policy", policy)
            headers["Referrer-Policy"] = "no-referrer"
            headers["X-Content-Type-Options"] = "nosniff"
        await send(message)

    return sending
