"""What a PDF of ours carries, taken out of it again; and where two of them differ.

This reads only what `render_pdf` writes: objects one after the other, long attachments compressed,
pictures as they were.
"""

import hashlib
import re

from pivometer.report.embedding import inflated

_ATTACHED = re.compile(
    rb"<</Length (\d+)/Type/EmbeddedFile(/Filter/FlateDecode)?[^\n]*>>\nstream\n"
)
_PICTURE = re.compile(
    rb"<</Length (\d+)/Type/XObject/Subtype/Image/Filter/DCTDecode[^\n]*>>\nstream\n"
)
_OBJECT = re.compile(rb"^(\d+) 0 obj$", re.MULTILINE)
_PAGE = re.compile(rb"<</Type/Page/[^\n]*/Contents (\d+) 0 R")
_CREATOR = re.compile(rb"/Creator\(([^)]*)\)")


def attachments_of_pdf(pdf: bytes) -> list[str]:
    """Return the attached texts, in the order in which they were attached.

    Those that are damaged are left out.
    """
    texts = (
        inflated(_stream(pdf, found), gzip_head=False)
        if found[2]
        else _stream(pdf, found).decode(errors="replace")
        for found in _ATTACHED.finditer(pdf)
    )
    return [text for text in texts if text is not None]


def pictures_of_pdf(pdf: bytes) -> dict[str, bytes]:
    """Return the pictures by their SHA-256."""
    pictures = (_stream(pdf, found) for found in _PICTURE.finditer(pdf))
    return {hashlib.sha256(picture).hexdigest(): picture for picture in pictures}


def creator_of_pdf(pdf: bytes) -> str:
    """Name the typesetter with its version."""
    found = _CREATOR.search(pdf)
    return found[1].decode("latin-1") if found else "an unknown typesetter"


def pdf_difference(pdf: bytes, redrawn: bytes) -> str:
    """Say where a PDF first differs from the one typeset anew; empty where it does not."""
    if pdf == redrawn:
        return ""
    pairs = enumerate(zip(pdf, redrawn, strict=False))
    at = next((i for i, (a, b) in pairs if a != b), min(len(pdf), len(redrawn)))
    objects = [int(found[1]) for found in _OBJECT.finditer(redrawn, 0, at)]
    contents = [int(found[1]) for found in _PAGE.finditer(redrawn)]
    where = f"byte {at}"
    if objects and objects[-1] in contents:
        where += f", on page {contents.index(objects[-1]) + 1}"
    return f"differs from {where} on from the PDF typeset anew from what it carries"


def _stream(pdf: bytes, found: re.Match[bytes]) -> bytes:
    return pdf[found.end() : found.end() + int(found[1])]
