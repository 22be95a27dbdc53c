"""A small session folder to spoil."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

BOARD = '[board]\nkind = "checkerboard"\nsquares = [9, 7]\nsquare_mm = 15.0\n'


def png(seed: int = 0, size: tuple[int, int] = (8, 6)) -> bytes:
    image = np.random.default_rng(seed).integers(0, 256, size[::-1], dtype=np.uint8)
    return bytes(cv2.imencode(".png", image)[1].tobytes())


@pytest.fixture
def make_session(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes a session: its description, and images by their paths."""

    def make(toml: str = BOARD, images: tuple[str, ...] | None = None) -> Path:
        root = tmp_path / "session"
        root.mkdir()
        (root / "session.toml").write_text(toml, encoding="utf-8")
        default = tuple(
            f"{group}/{camera}/{view}.png"
            for group in ("board", "shaft")
            for camera in ("left", "right")
            for view in ("000", "001")
        )
        for name in default if images is None else images:
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_bytes(png())
        return root

    return make
