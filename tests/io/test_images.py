import hashlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pivometer.errors import ImageError, UsageError
from pivometer.io.images import EXTENSIONS, read_hashed_image, read_image, write_image

RNG = np.random.default_rng(7)
GREY = cv2.GaussianBlur(RNG.integers(0, 256, (60, 80), dtype=np.uint8), (0, 0), 1.0)
COLOUR = RNG.integers(0, 256, (60, 80, 3), dtype=np.uint8)
LOSSLESS = (".png", ".bmp", ".tif", ".pgm", ".pam", ".dib")
CUT_OFF = (".png", ".jpg", ".bmp", ".tif", ".pgm", ".ppm", ".webp", ".jp2")


def encoded(ending: str, image: NDArray[np.generic], *options: int) -> bytes:
    return bytes(cv2.imencode(ending, image, list(options))[1].tobytes())


def written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("ending", LOSSLESS)
def test_grey_levels_arrive_unchanged(tmp_path: Path, ending: str) -> None:
    image = read_image(written(tmp_path / f"a{ending}", encoded(ending, GREY)))
    np.testing.assert_array_equal(image, GREY)
    assert image.dtype == np.uint8


@pytest.mark.parametrize("ending", [".png", ".tif", ".pgm"])
def test_16_bit_stays_16_bit(tmp_path: Path, ending: str) -> None:
    deep = RNG.integers(0, 65536, (5, 7), dtype=np.uint16)
    image = read_image(written(tmp_path / f"a{ending}", encoded(ending, deep)))
    np.testing.assert_array_equal(image, deep)
    assert image.dtype == np.uint16


def test_colour_becomes_grey_with_the_documented_weights(tmp_path: Path) -> None:
    blue, green, red = np.moveaxis(COLOUR.astype(float), -1, 0)
    wanted = 0.299 * red + 0.587 * green + 0.114 * blue
    image = read_image(written(tmp_path / "a.png", encoded(".png", COLOUR)))
    assert np.abs(image - wanted).max() <= 0.51  # half a grey level, and the weights' own rounding


def test_alpha_is_dropped(tmp_path: Path) -> None:
    alpha = np.dstack([GREY, GREY, GREY, np.zeros_like(GREY)])
    image = read_image(written(tmp_path / "a.png", encoded(".png", alpha)))
    np.testing.assert_array_equal(image, GREY)


def test_an_exif_orientation_turns_nothing(tmp_path: Path) -> None:
    jpeg = encoded(".jpg", GREY)
    tiff = b"II*\0\x08\0\0\0" + b"\x01\0" + b"\x12\x01\x03\0\x01\0\0\0\x06\0\0\0" + b"\0\0\0\0"
    exif = b"Exif\0\0" + tiff
    turned = jpeg[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + jpeg[2:]
    shown = cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert shown is not None
    assert shown.shape == (80, 60)  # the tag is there, and OpenCV would follow it
    image = read_image(written(tmp_path / "a.jpg", turned))
    np.testing.assert_array_equal(image, read_image(written(tmp_path / "b.jpg", jpeg)))


def test_the_hash_is_that_of_the_file(tmp_path: Path) -> None:
    data = encoded(".png", GREY)
    hashed = read_hashed_image(written(tmp_path / "a.png", data))
    assert hashed.sha256 == hashlib.sha256(data).hexdigest()
    np.testing.assert_array_equal(hashed.image, GREY)


def test_paths_of_any_alphabet(tmp_path: Path) -> None:
    path = tmp_path / "Bilder – ÄÖ 画像" / "é 1.png"
    np.testing.assert_array_equal(read_image(write_image(path, GREY)), GREY)


def test_the_listed_endings_are_ones_opencv_reads(tmp_path: Path) -> None:
    unknown = {ending for ending in EXTENSIONS if not cv2.haveImageWriter(f"a{ending}")}
    assert unknown <= {".avif"}  # OpenCV's wheels have it only since 4.12


@pytest.mark.parametrize("ending", CUT_OFF)
@pytest.mark.parametrize("kept", [0.3, 0.9, -1], ids=["0.3", "0.9", "all but one byte"])
def test_a_file_that_was_cut_off_is_refused(tmp_path: Path, ending: str, kept: float) -> None:
    data = encoded(ending, COLOUR if ending == ".ppm" else GREY)
    end = len(data) - 1 if kept < 0 else int(kept * len(data))
    path = written(tmp_path / f"a{ending}", data[:end])
    if (ending, kept) == (".tif", -1):  # its last bytes say that there is no further page
        np.testing.assert_array_equal(read_image(path), GREY)
        return
    with pytest.raises(ImageError, match=r"cut off") as caught:
        read_image(path)
    assert caught.value.path == path
    assert caught.value.next_step == "copy the file again from the camera, or remove it"


@pytest.mark.parametrize("ending", [".png", ".jpg"])
def test_a_file_whose_end_is_zeros_is_refused(tmp_path: Path, ending: str) -> None:
    """What a copy looks like that was interrupted after the space was reserved."""
    data = encoded(ending, GREY)
    path = written(tmp_path / f"a{ending}", data[: len(data) // 2].ljust(len(data), b"\0"))
    with pytest.raises(ImageError, match=r"cut off|damaged"):
        read_image(path)


def test_a_preview_inside_does_not_hide_that_a_jpeg_was_cut_off(tmp_path: Path) -> None:
    jpeg, preview = encoded(".jpg", GREY), encoded(".jpg", GREY[:8, :8])
    block = b"\xff\xe2" + (len(preview) + 2).to_bytes(2, "big") + preview
    whole = jpeg[:2] + block + jpeg[2:]
    assert read_image(written(tmp_path / "a.jpg", whole)).shape == GREY.shape
    with pytest.raises(ImageError, match=r"cut off"):
        read_image(written(tmp_path / "b.jpg", whole[: len(whole) * 3 // 4]))


@pytest.mark.parametrize(
    "options",
    [(cv2.IMWRITE_JPEG_PROGRESSIVE, 1), (cv2.IMWRITE_JPEG_RST_INTERVAL, 2)],
    ids=["progressive", "restart markers"],
)
def test_jpegs_of_several_scans_and_with_bytes_after_the_end(
    tmp_path: Path, options: tuple[int, int]
) -> None:
    data = encoded(".jpg", COLOUR, *options)
    assert read_image(written(tmp_path / "a.jpg", data + b"maker's notes")).shape == (60, 80)
    with pytest.raises(ImageError, match=r"cut off"):
        read_image(written(tmp_path / "b.jpg", data[: len(data) // 2]))


@pytest.mark.parametrize("at", [20, 60, -30])
def test_a_png_with_a_wrong_byte_is_refused(tmp_path: Path, at: int) -> None:
    data = bytearray(encoded(".png", GREY))
    data[at] ^= 0x10
    with pytest.raises(ImageError):
        read_image(written(tmp_path / "a.png", bytes(data)))


FAULTS = {
    "empty": (b"", "is empty (0 bytes)"),
    "text": (b"hello", "is cut off, damaged, or not an image (5 bytes)"),
    "float": (
        encoded(".tif", GREY.astype(np.float32)),
        "holds float32 pixels, and grey levels of that type have no known range",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_no_image_of_8_or_16_bit(tmp_path: Path, fault: str) -> None:
    data, message = FAULTS[fault]
    path = written(tmp_path / "a.tif", data)
    with pytest.raises(ImageError) as caught:
        read_image(path)
    assert (caught.value.what, caught.value.path) == (message, path)


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match="cannot be read: No such file or directory"):
        read_image(tmp_path / "none.png")
    with pytest.raises(ImageError, match="cannot be read"):
        read_image(tmp_path)


def test_writing_says_why_it_failed(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(UsageError, match="cannot be written"):
        write_image(tmp_path / "file" / "a.png", GREY)
    with pytest.raises(UsageError, match="cannot be written"):
        write_image(tmp_path / "a.nonsense", GREY)
