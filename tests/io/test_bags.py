"""Cameras in ROS bags of all three kinds, which these tests write themselves."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from pivometer.errors import ImageError, UsageError
from pivometer.io import bags
from pivometer.io.bags import PlayedBag
from pivometer.io.sources import open_source

pytest.importorskip("rosbags", reason="the extra ros is not installed")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

RAMP = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
STEP_NS = 20_000_000
KINDS = ("run.bag", "run-db3", "run-mcap")


def write_bag(folder: Path, kind: str, messages: list[dict[str, object]]) -> Path:
    """Write pictures under /left/image, and as many of another type under /noise."""
    store = get_typestore(Stores.ROS1_NOETIC if kind.endswith(".bag") else Stores.ROS2_HUMBLE)
    path = folder / kind
    if kind.endswith(".bag"):
        writer = Writer1(path)
    else:
        plugin = StoragePlugin.MCAP if kind.endswith("mcap") else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
    stamp = store.types["builtin_interfaces/msg/Time"](sec=1, nanosec=0)
    extra = {"seq": 0} if kind.endswith(".bag") else {}
    header = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="", **extra)
    first = "sensor_msgs/msg/CompressedImage" if "format" in messages[0] else _IMAGE
    with writer:
        pictures = writer.add_connection("/left/image", first, typestore=store)
        noise = writer.add_connection("/noise", "std_msgs/msg/String", typestore=store)
        text = store.types["std_msgs/msg/String"]("no picture")
        for number, fields in enumerate(messages):
            message = store.types[first](header=header, **fields)
            for connection, one in ((pictures, message), (noise, text)):
                serialize = store.serialize_ros1 if extra else store.serialize_cdr
                at = 1_000_000_000 + STEP_NS * number
                writer.write(connection, at, bytes(serialize(one, connection.msgtype)))
    return path


_IMAGE = "sensor_msgs/msg/Image"


def picture(
    pixels: np.ndarray, encoding: str, *, pad: int = 0, big: bool = False
) -> dict[str, object]:
    rows = pixels.astype(pixels.dtype.newbyteorder(">" if big else "<"))
    rows = np.ascontiguousarray(rows).view(np.uint8).reshape(len(pixels), -1)
    data = np.pad(rows, ((0, 0), (0, pad)))
    return {
        "height": pixels.shape[0],
        "width": pixels.shape[1],
        "encoding": encoding,
        "is_bigendian": int(big),
        "step": data.shape[1],
        "data": data.ravel(),
    }


@pytest.mark.parametrize("kind", KINDS)
def test_a_topic_plays_a_camera_over_and_over_at_its_own_times(tmp_path: Path, kind: str) -> None:
    path = write_bag(tmp_path, kind, [picture(RAMP + i, "mono8", pad=3) for i in range(3)])
    start = time.monotonic()
    source = open_source(f"{path}#/left/image", start_s=start)
    frames = [source.read() for _ in range(5)]
    source.close()
    assert [frame.number for frame in frames] == list(range(5))
    for frame in frames:
        assert (frame.image == RAMP + frame.number % 3).all()
    assert [frame.time_s - start for frame in frames[:3]] == pytest.approx([0, 0.02, 0.04])
    assert time.monotonic() >= frames[-1].time_s  # nothing comes before its time


@pytest.mark.parametrize(
    ("message", "grey"),
    [
        (picture(RAMP.astype(np.uint16) * 200, "mono16"), RAMP.astype(np.uint16) * 200),
        (picture(RAMP.astype(np.uint16) * 200, "16UC1", big=True), RAMP.astype(np.uint16) * 200),
        (picture(RAMP, "8UC1"), RAMP),
        (picture(np.dstack([RAMP] * 3), "bgr8", pad=1), RAMP),
        (picture(np.dstack([RAMP * 0, RAMP * 0, RAMP]), "rgb8"), np.round(RAMP * 0.114)),
        (picture(np.dstack([RAMP] * 3 + [RAMP * 0]), "rgba8"), RAMP),
        (picture(np.full((4, 4), 90, np.uint8), "bayer_rggb8"), np.full((4, 4), 90)),
        (
            {"format": "png", "data": cv2.imencode(".png", RAMP)[1].ravel()},
            RAMP,
        ),
    ],
)
def test_every_usual_encoding_becomes_grey_at_its_own_depth(tmp_path, message, grey) -> None:
    source = PlayedBag(write_bag(tmp_path, "run-db3", [message]), "/left/image", 0.0)
    image = source.read().image
    source.close()
    assert image.shape == grey.shape
    assert image.dtype == (np.uint16 if grey.dtype == np.uint16 else np.uint8)
    assert np.abs(image.astype(float) - grey).max() <= (0 if image.dtype == np.uint16 else 1)


def test_what_cannot_be_shown_is_told(tmp_path: Path) -> None:
    cut = picture(RAMP, "mono8") | {"data": RAMP.ravel()[:5]}
    for name, message, says in (
        ("a", picture(RAMP, "yuv422"), "encoded as yuv422"),
        ("b", cut, "cut off"),
    ):
        (tmp_path / name).mkdir()
        path = write_bag(tmp_path / name, "run.bag", [message])
        with pytest.raises(ImageError, match=says):
            PlayedBag(path, "/left/image", 0.0).read()
    for topic in ("", "/noise", "/right/image"):
        with pytest.raises(UsageError) as refused:
            open_source(f"{path}#{topic}")
        assert "run.bag#/left/image" in refused.value.next_step
    for broken in ("c.bag", "c.mcap", "c.db3"):
        (tmp_path / broken).write_bytes(b"no bag")
        with pytest.raises(UsageError, match="no bag that can be read"):
            open_source(f"{tmp_path / broken}#/left/image")


def test_without_the_extra_the_message_says_what_to_install(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(bags, "find_spec", lambda _: None)
    (tmp_path / "run.bag").touch()
    with pytest.raises(UsageError) as refused:
        open_source(str(tmp_path / "run.bag"))
    assert refused.value.next_step == 'pip install "pivometer[ros]"'
