"""A GenICam camera, played by a fake of harvesters; no industrial camera was at hand."""

from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pivometer.errors import ImageError, UsageError
from pivometer.io import genicam
from pivometer.io.genicam import GenicamCamera
from pivometer.io.sources import open_source


class FakeCamera:
    def __init__(self, kind: str, pixels: list[np.ndarray]) -> None:
        self.kind, self.pixels, self.calls = kind, pixels, []

    def start(self) -> None:
        self.calls.append("start")

    def stop(self) -> None:
        self.calls.append("stop")

    def destroy(self) -> None:
        self.calls.append("destroy")

    @contextmanager
    def fetch(self, timeout: float):
        if not self.pixels:
            raise TimeoutError(f"nothing within {timeout} s")
        pixels = self.pixels.pop(0)
        buffer = pixels.ravel().copy()
        part = SimpleNamespace(
            data=buffer, data_format=self.kind, height=pixels.shape[0], width=pixels.shape[1]
        )
        yield SimpleNamespace(payload=SimpleNamespace(components=[part]))
        buffer[:] = 0  # a producer uses its buffer again


class FakeHarvester:
    def __init__(self, *cameras: FakeCamera) -> None:
        self.cameras, self.device_info_list, self.left = cameras, [], False

    def add_file(self, path: str) -> None:
        self.path = path

    def update(self) -> None:
        self.device_info_list = list(self.cameras)

    def create(self, number: int) -> FakeCamera:
        return self.cameras[number]

    def reset(self) -> None:
        self.left = True


@pytest.fixture
def producer(tmp_path: Path) -> Path:
    (tmp_path / "maker.cti").touch()
    return tmp_path / "maker.cti"


def test_pictures_keep_their_depth_and_outlive_the_buffer(producer: Path) -> None:
    deep = np.array([[0, 4095, 7], [1, 2, 3]], dtype=np.uint16)
    fake = FakeCamera("Mono12", [deep, deep + 1])
    harvester = FakeHarvester(FakeCamera("Mono8", []), fake)
    camera = GenicamCamera(producer, 1, harvester)
    frames = [camera.read(), camera.read()]
    assert [frame.number for frame in frames] == [0, 1]
    assert (frames[0].image == deep).all()
    with pytest.raises(ImageError, match=r"camera 1 of maker.cti gives no picture: nothing within"):
        camera.read()
    camera.close()
    assert fake.calls == ["start", "stop", "destroy"]
    assert harvester.left


def test_colour_and_missing_cameras_are_told(producer: Path) -> None:
    colour = FakeCamera("BayerRG8", [np.zeros((2, 2), np.uint8)])
    with pytest.raises(ImageError, match="gives BayerRG8"):
        GenicamCamera(producer, 0, FakeHarvester(colour)).read()
    empty = FakeHarvester()
    with pytest.raises(UsageError, match="there is no camera 0; 0 are connected"):
        GenicamCamera(producer, 0, empty)
    assert empty.left
    with pytest.raises(UsageError, match="no such GenICam producer"):
        GenicamCamera(producer.with_name("other.cti"), 0, FakeHarvester())


def test_without_the_extra_the_message_says_what_to_install(producer: Path, monkeypatch) -> None:
    monkeypatch.setattr(genicam, "find_spec", lambda _: None)
    with pytest.raises(UsageError) as refused:
        open_source(f"genicam {producer} 0")
    assert refused.value.next_step == 'pip install "pivometer[genicam]"'
