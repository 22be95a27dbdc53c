"""What a report carries of what it was made from, so that it can be verified later.

The result and the record of the pictures travel as compressed text in two links of the page, which
save them as files; the pictures are those on the page.
"""

import base64
import binascii
import gzip
import hashlib
import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

from pivometer._arrays import Floats, checked, read_only
from pivometer.report.thumbnails import Thumbnail
from pivometer.shaft.across import EdgeProfiles

RESULT, RECORD = "result.json", "record.json"

LARGEST_BYTES = 300_000_000
"""A result of 10 000 poses has 150 MB; a file that claims more is not unpacked."""

Key = tuple[str, str]
"""Pose and camera."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedTruth:
    """What is known of a simulated session.

    Parameters
    ----------
    point_mm
        The true RCM, shape (3,), mm, in the reference camera's frame.
    max_mm, rms_mm
        The simulated robot's true distances from that point, mm.
    """

    point_mm: Floats
    max_mm: float
    rms_mm: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_mm", read_only(checked(self.point_mm, (3,), "point_mm")))


@dataclass(frozen=True, slots=True, eq=False)
class PictureRecord:
    """A picture in a report.

    Parameters
    ----------
    sha256
        Of the encoded picture.
    width, height
        Its size, px.
    scale
        Its pixels per image pixel.
    """

    sha256: str
    width: int
    height: int
    scale: float


@dataclass(frozen=True, slots=True, eq=False)
class ReportRecord:
    """What a report shows beside the result.

    Parameters
    ----------
    pictures, profiles
        The pictures and the grey levels across the edges, by "camera/pose".
    truth
        What is known of a simulated session.
    """

    pictures: Mapping[str, PictureRecord]
    profiles: Mapping[str, EdgeProfiles]
    truth: SimulatedTruth | None = None

    def thumbnails(self, pictures: Mapping[str, bytes]) -> dict[Key, Thumbnail]:
        """Return the recorded pictures that are among `pictures`, which are by their SHA-256."""
        return {
            _key(name): Thumbnail(pictures[one.sha256], one.width, one.height, one.scale)
            for name, one in self.pictures.items()
            if one.sha256 in pictures
        }

    def profiles_by_pose(self) -> dict[Key, EdgeProfiles]:
        """Return the grey levels by pose and camera."""
        return {_key(name): profiles for name, profiles in self.profiles.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """Texts that a report carries.

    Parameters
    ----------
    packed
        Them by name, compressed, as the page writes them.
    seal
        The SHA-256 that the result states of itself.
    """

    packed: Mapping[str, str]
    seal: str


def record_of(
    thumbnails: Mapping[Key, Thumbnail],
    profiles: Mapping[Key, EdgeProfiles],
    truth: SimulatedTruth | None,
) -> ReportRecord:
    """Record what a report is about to show."""
    pictures = {
        _name(key): PictureRecord(_sha256(one.jpeg), one.width, one.height, one.scale)
        for key, one in thumbnails.items()
    }
    return ReportRecord(pictures, {_name(key): one for key, one in profiles.items()}, truth)


def packed(text: str) -> str:
    """Compress a text for a page.

    Examples
    --------
    >>> unpacked(packed("0.391 mm"))
    '0.391 mm'
    """
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode("ascii")


def unpacked(block: str) -> str | None:
    """Return a compressed text; `None` if it is damaged, or larger than any of ours."""
    try:
        return inflated(base64.b64decode(block, validate=True), gzip_head=True)
    except binascii.Error:
        return None


def inflated(content: bytes, *, gzip_head: bool) -> str | None:
    """Return a compressed text; `None` if it is damaged, or larger than any of ours."""
    unpacking = zlib.decompressobj(wbits=31 if gzip_head else 15)
    try:
        text = unpacking.decompress(content, LARGEST_BYTES)
        return text.decode() if unpacking.eof else None
    except (zlib.error, UnicodeDecodeError):
        return None


def blocks_of_page(page: str) -> dict[str, str]:
    """Return the compressed texts in a page by name."""
    found = re.findall(
        r'download="([a-z.]+)\.gz" href="data:application/gzip;base64,([^"]*)"', page
    )
    return dict(found)


def pictures_of_page(page: str) -> dict[str, bytes]:
    """Return the pictures in a page by their SHA-256; those that cannot be decoded are left out."""
    pictures = {}
    for block in re.findall(r'src="data:image/jpeg;base64,([^"]*)"', page):
        try:
            picture = base64.b64decode(block, validate=True)
        except binascii.Error:
            continue
        pictures[_sha256(picture)] = picture
    return pictures


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _name(key: Key) -> str:
    """Name a picture: a camera's name holds no slash."""
    return f"{key[1]}/{key[0]}"


def _key(name: str) -> Key:
    camera, _, pose = name.partition("/")
    return pose, camera
