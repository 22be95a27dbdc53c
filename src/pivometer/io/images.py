"""Read one image file: whole or not at all, in grey, at its own bit depth.

What is measured are the pixels as the camera stored them. So an EXIF orientation is ignored (the
optics do not turn with the picture), 16-bit values are kept, and nothing is scaled.
"""

import hashlib
import re
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pivometer.errors import ImageError, UsageError

Image = NDArray[np.uint8] | NDArray[np.uint16]
"""A grey image, indexed ``[row, col]``, in counts as stored."""

EXTENSIONS = frozenset(
    {
        ".avif",
        ".bmp",
        ".dib",
        ".gif",
        ".jp2",
        ".jpe",
        ".jpeg",
        ".jpg",
        ".pam",
        ".pbm",
        ".pgm",
        ".png",
        ".pnm",
        ".ppm",
        ".tif",
        ".tiff",
        ".webp",
    }
)
"""File name endings of the formats OpenCV reads with 8 or 16 bit, in lower case.

Sun raster files are not among them: OpenCV 5.0 returns their grey images black.
"""

_COPY_AGAIN = "copy the file again from the camera, or remove it"


@dataclass(frozen=True, slots=True, eq=False)
class HashedImage:
    """An image and the fingerprint of the file it came from.

    Parameters
    ----------
    image
        Grey image, shape (height, width), uint8 or uint16.
    sha256
        SHA-256 of the file's bytes, hexadecimal.
    """

    image: Image
    sha256: str


def read_image(path: Path | str) -> Image:
    """Read an image file as grey levels, shape (height, width), uint8 or uint16 as stored.

    Colour becomes grey with the weights of Rec. 601 (0.299 R + 0.587 G + 0.114 B); an alpha channel
    is dropped; an EXIF orientation is ignored.

    Parameters
    ----------
    path
        Any format OpenCV reads, 8 or 16 bit.

    Raises
    ------
    ImageError
        If the file is missing, cut off, damaged, not an image, or holds other pixels than 8 or 16
        bit.
    """
    return read_hashed_image(path).image


def read_hashed_image(path: Path | str) -> HashedImage:
    """Read an image as `read_image` does, with the SHA-256 of the very bytes that were decoded.

    Raises
    ------
    ImageError
        As `read_image`.
    """
    data = read_image_bytes(path)
    return HashedImage(decode_image(data, path), hashlib.sha256(data).hexdigest())


def read_image_bytes(path: Path | str) -> bytes:
    """Return the bytes of an image file, which must not be empty.

    Raises
    ------
    ImageError
        If the file cannot be read, or holds nothing.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise ImageError(
            f"cannot be read: {error.strerror}",
            next_step="check that the file is there and may be read",
            path=path,
        ) from error
    if not data:
        raise ImageError("is empty (0 bytes)", next_step=_COPY_AGAIN, path=path)
    return data


def decode_image(data: bytes, path: Path | str) -> Image:
    """Decode the bytes of an image file as `read_image` does; `path` is for the message only.

    Raises
    ------
    ImageError
        If the bytes are not one whole image of 8 or 16 bit.
    """
    damage = _damage(data)
    if damage is not None:
        raise ImageError(damage, next_step=_COPY_AGAIN, path=path)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise ImageError(
            f"cannot be decoded: {error.err}", next_step=_COPY_AGAIN, path=path
        ) from error
    if pixels is None:
        raise ImageError(
            f"is cut off, damaged, or not an image ({len(data)} bytes)",
            next_step=_COPY_AGAIN,
            path=path,
        )
    return _grey(np.asarray(pixels), path)


def write_image(path: Path | str, image: Image) -> Path:
    """Write an image without loss, in the format its ending names; its folder is made.

    Raises
    ------
    UsageError
        If it cannot be written.
    """
    target = Path(path)
    try:
        _, data = cv2.imencode(target.suffix, image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(data.tobytes())
    except (OSError, cv2.error) as error:
        raise UsageError(
            f"cannot be written: {getattr(error, 'strerror', None) or error}",
            next_step="check the disk and the permissions, or name another folder",
            path=target,
        ) from error
    return target


def _grey(pixels: NDArray[np.integer | np.floating], path: Path | str) -> Image:
    """Return decoded pixels as one grey channel of 8 or 16 bit."""
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ImageError(
            f"holds {pixels.dtype} pixels, and grey levels of that type have no known range",
            next_step="save it with 8 or 16 bit per channel, for instance as PNG",
            path=path,
        )
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    if channels in (1, 2):  # grey, or grey with alpha
        grey = pixels if pixels.ndim == 2 else pixels[:, :, 0]
    elif channels in (3, 4):
        grey = np.asarray(cv2.cvtColor(pixels[:, :, :3], cv2.COLOR_BGR2GRAY))
    else:
        raise ImageError(
            f"has {channels} channels", next_step="save it in grey or in colour", path=path
        )
    contiguous: Image = np.ascontiguousarray(grey)
    return contiguous


# --- Is the file whole? OpenCV 5 refuses files that were cut off in any of its formats; older ones
# returned them partly grey. PNG and JPEG, which nearly all sessions use, say themselves where they
# end, so nothing rests on OpenCV there and the message can say what is wrong. ---


def _damage(data: bytes) -> str | None:
    """Say what is wrong with the structure of a PNG or JPEG file, if anything."""
    checks: dict[bytes, Callable[[bytes], str | None]] = {
        b"\x89PNG\r\n\x1a\n": _png_damage,
        b"\xff\xd8\xff": _jpeg_damage,
    }
    for signature, check in checks.items():
        if data.startswith(signature):
            return check(data)
    return None


def _png_damage(data: bytes) -> str | None:
    """Walk the chunks (length, type, data, CRC) to the end chunk; PNG specification, 5.3."""
    position = 8
    while position + 12 <= len(data):
        length = int.from_bytes(data[position : position + 4], "big")
        body = data[position + 4 : position + 8 + length]
        crc = data[position + 8 + length : position + 12 + length]
        if len(crc) < 4:
            break
        if zlib.crc32(body) != int.from_bytes(crc, "big"):
            return f"is damaged: the checksum at byte {position} of {len(data)} is wrong"
        if body[:4] == b"IEND":
            return None
        position += 12 + length
    return f"is cut off after {len(data)} bytes: the end of the PNG image is missing"


_JPEG_MARKER = re.compile(rb"\xff+([^\x00\xff\xd0-\xd7])", re.DOTALL)
_SCAN, _END = 0xDA, 0xD9


def _jpeg_damage(data: bytes) -> str | None:
    """Walk the segments and scans to the end marker; ITU-T T.81, B.1.

    Searching for the last bytes FF D9 would not do: a preview inside the EXIF data has its own, and
    some cameras write more after the image.
    """
    position = 2
    while marker := _JPEG_MARKER.match(data, position):
        kind, position = marker[1][0], marker.end()
        if kind == _END:
            return None
        position += int.from_bytes(data[position : position + 2], "big")
        if kind == _SCAN:
            following = _JPEG_MARKER.search(data, position)
            position = len(data) if following is None else following.start()
    if position >= len(data) - 1:
        return f"is cut off after {len(data)} bytes: the end of the JPEG image is missing"
    return f"is damaged: no JPEG segment at byte {position} of {len(data)}"
