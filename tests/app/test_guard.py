"""Nobody without the token reads the app, and no page of another program does."""

import socket
import stat
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from pivometer import pipeline
from pivometer.app import free_port, run_app
from pivometer.app.guard import new_token
from pivometer.calibration import Board
from pivometer.errors import UsageError
from pivometer.io.settings import Settings
from pivometer.pipeline.capturing import MOST_PICTURE_BYTES

HANDSHAKE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}
SOCKET = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
POLLING = "/_nicegui_ws/socket.io/?EIO=4&transport=polling"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("guard") / "new"


@pytest.fixture(scope="module")
def app(start_app, folder: Path):
    return start_app(folder)


def test_only_the_bearer_of_the_token_is_let_in(app) -> None:
    for path in (
        "/",
        "/calibrate",
        "/live/left.jpg",
        "/files/report.html",
        POLLING,
        "/favicon.ico",
    ):
        assert app.get(path)[0] == 403, path
    assert app.get(SOCKET, HANDSHAKE)[0] == 403
    for wrong in (app.token[:-1], app.token + "x", "", "%FF%00", "é"):
        assert app.get(f"/?token={wrong.encode().hex() if wrong == 'é' else wrong}")[0] == 403
        assert app.get("/", {"Cookie": f"pivometer-{app.port}={wrong}".encode("latin-1")})[0] == 403

    status, headers, _ = app.get(f"/?token={app.token}")
    assert status == 303
    assert headers["location"] == "/"  # the token does not stay in the history
    assert "HttpOnly" in headers["set-cookie"]
    assert "samesite=lax" in headers["set-cookie"].lower()

    status, headers, page = app.get("/", cookie=True)
    assert status == 200
    assert b"Set up" in page
    assert app.token.encode() not in page
    assert "default-src 'self'" in headers["content-security-policy"]
    assert app.get(SOCKET, HANDSHAKE, cookie=True)[0] == 101
    assert app.get(POLLING, cookie=True)[0] == 200

    # A page of another program on this computer brings the cookie, but not our origin.
    elsewhere = {"Origin": "http://127.0.0.1:9"}
    assert app.get(SOCKET, HANDSHAKE | elsewhere, cookie=True)[0] == 403
    assert app.get("/", elsewhere, cookie=True)[0] == 403
    embedded = {"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "no-cors"}
    assert app.get("/live/left.jpg", embedded, cookie=True)[0] == 403
    # A name that somebody's server lets point here (DNS rebinding) is not ours.
    assert app.get("/", {"Host": f"evil.example:{app.port}"}, cookie=True)[0] == 403
    # Nothing outside of what the app serves can be named.
    for path in ("/files/../session.toml", "/files/%2e%2e/session.toml", "/live/..%2f..%2fx.jpg"):
        assert app.get(path, cookie=True)[0] in (404, 410), path


def test_the_app_listens_on_the_loopback_address_only(app, folder: Path) -> None:
    own = {entry[4][0] for entry in socket.getaddrinfo(socket.gethostname(), None)}
    for address in own - {"127.0.0.1", "::1"}:
        if address.startswith("127."):
            continue
        with pytest.raises(OSError, match=r"."):
            socket.create_connection((address, app.port), timeout=2).close()
    assert not list(folder.parent.iterdir())  # looking writes nothing


def test_tokens_are_long_and_never_the_same() -> None:
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) >= 43  # 256 bits in base 64


def test_the_file_that_opens_the_browser_is_the_owners_only(monkeypatch) -> None:
    from pivometer.app import opening

    named: list[str] = []
    monkeypatch.setattr(opening.webbrowser, "open", lambda url: named.append(url) or True)
    page = opening.open_browser("http://127.0.0.1:1/?token=secret")
    try:
        assert stat.S_IMODE(page.stat().st_mode) == 0o600
        assert "secret" in page.read_text(encoding="utf-8")
        assert named == [page.as_uri()]
        assert "secret" not in named[0]
    finally:
        page.unlink()


def test_a_port_that_is_taken_is_told() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(UsageError, match=r"port \d+ of this computer cannot be used"):
            free_port(taken.getsockname()[1])


def test_without_the_extra_the_message_says_what_to_install(monkeypatch, tmp_path: Path) -> None:
    import pivometer.app

    monkeypatch.setattr(pivometer.app.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(UsageError) as refused:
        run_app(tmp_path / "new")
    assert refused.value.next_step == 'pip install "pivometer[app]"'


def test_a_file_is_no_session_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x", encoding="utf-8")
    with pytest.raises(UsageError, match="is a file"):
        run_app(tmp_path / "file")


def unpacking_to(side: int) -> bytes:
    """The head of a PNG that claims to be a large square, with nothing in it."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        crc = zlib.crc32(kind + data).to_bytes(4, "big")
        return len(data).to_bytes(4, "big") + kind + data + crc

    head = 2 * side.to_bytes(4, "big") + bytes([8, 0, 0, 0, 0])
    parts = (chunk(b"IHDR", head), chunk(b"IDAT", zlib.compress(b"")), chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def test_a_picture_that_is_sent_lands_in_its_folder_or_nowhere(app, folder: Path) -> None:
    picture = cv2.imencode(".png", np.full((5, 7), 9, np.uint8))[1].tobytes()

    def send(path: str, data: bytes = picture, **headers: str) -> int:
        return app.get(path, headers, cookie=True, put=data)[0]

    assert send("/pictures/board/left/0.png") == 409  # nothing is described yet
    board = Board("checkerboard", (9, 7), 15.0)
    pipeline.describe(folder, Settings(board, None, ("left", "right"), "left", {}, {}, ""))

    assert app.get("/pictures/board/left/0.png", put=picture)[0] == 403
    assert send("/pictures/board/left/0.png", Origin="http://evil.example") == 403
    for path in (
        "/pictures/board/left/..%2F..%2F..%2Fout.png",
        "/pictures/board/left/..%5C..%5Cout.png",
        "/pictures/board/..%2F../out.png",
        "/pictures/../left/out.png",
        "/pictures/board/%2e%2e/out.png",
        "/pictures/results/left/out.png",
        "/pictures/board/left/.out.png",
        "/pictures/board/left/out.html",
        "/pictures/board/middle/out.png",
    ):
        assert send(path) in (404, 405, 422), path
    assert send("/pictures/board/left/0.png", b"no picture") == 422
    assert send("/pictures/board/left/0.png", picture[:-9]) == 422
    assert send("/pictures/board/left/0.png", bytes(MOST_PICTURE_BYTES + 1)) == 413
    status, _, said = app.get("/pictures/board/left/0.png", cookie=True, put=unpacking_to(16_000))
    assert status == 422
    assert b"pixels" in said.lower()  # refused by its size, before anything is unpacked
    written = {"session.toml", "board", "shaft", "left", "right"}
    assert {path.name for path in folder.parent.rglob("*")} == {"new", *written}

    assert send("/pictures/board/left/0.png") == 204
    assert (folder / "board" / "left" / "0.png").read_bytes() == picture
    assert app.get("/pictures/left/board/0", cookie=True)[0] == 200
    for path in ("/pictures/right/board/0", "/pictures/left/../session.toml", "/pictures/left/x/y"):
        assert app.get(path, cookie=True)[0] == 404, path


def test_a_report_of_anybody_is_shown_without_the_rights_of_the_app(app, folder: Path) -> None:
    foreign = b"<script>fetch('/pictures/board/left/9.png', {method: 'PUT', body: 'x'})</script>"
    (folder / "results").mkdir(parents=True)
    (folder / "results" / "report.html").write_bytes(foreign)
    (folder / "results" / "secret.html").write_bytes(foreign)
    status, headers, content = app.get("/files/report.html?shown=1", cookie=True)
    assert (status, content) == (200, foreign)
    policy = headers["content-security-policy"]
    assert "sandbox allow-scripts" in policy
    assert "allow-same-origin" not in policy
    assert "default-src 'none'" in policy
    assert app.get("/files/secret.html", cookie=True)[0] == 404
    status, headers, _ = app.get("/files/report.html", cookie=True)
    assert headers["content-disposition"] == 'attachment; filename="report.html"'
