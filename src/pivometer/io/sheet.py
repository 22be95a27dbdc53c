"""A page of black rectangles and small print, as SVG and as PDF, true to scale.

Both are written from the same numbers in mm, without compression, dates or random names: the same
sheet gives the same bytes, everywhere. All rectangles are one path, so that neighbours leave no
hairline between them. Why there is no library behind this: ``docs/adr/0004-target.md``.
"""

from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

from pivometer.errors import UsageError

_POINTS_PER_MM = 72 / 25.4


@dataclass(frozen=True, slots=True, eq=False)
class Rectangle:
    """A black rectangle: its corner nearest the page's top left, and its size, mm."""

    x_mm: float
    y_mm: float
    width_mm: float
    height_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Text:
    """A line of text: where its baseline starts and the size of its type, mm."""

    x_mm: float
    y_mm: float
    size_mm: float
    content: str


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """One page; x goes right and y down from its top left corner.

    Parameters
    ----------
    title
        What viewers show as the document's name.
    width_mm, height_mm
        Size of the paper, mm.
    rectangles
        What is black; they do not overlap.
    texts
        What is written; letters of Windows-1252 only, which is what PDF's own fonts have.
    """

    title: str
    width_mm: float
    height_mm: float
    rectangles: tuple[Rectangle, ...]
    texts: tuple[Text, ...]


def sheet_content(sheet: Sheet, file: Path | str) -> str | bytes:
    """Return what to write into `file`: SVG text or PDF bytes, as its ending says.

    Raises
    ------
    UsageError
        If the ending is neither ``.pdf`` nor ``.svg``.
    """
    path = Path(file)
    match path.suffix.lower():
        case ".pdf":
            return pdf_bytes(sheet)
        case ".svg":
            return svg_text(sheet)
    raise UsageError(
        "ends neither in .pdf nor in .svg",
        next_step=f"name it {path.stem or 'target'}.pdf",
        path=path,
    )


def svg_text(sheet: Sheet) -> str:
    """Write a sheet as SVG, one user unit per mm.

    Examples
    --------
    >>> text = svg_text(Sheet("A dot", 20, 10, (Rectangle(1, 2, 0.5, 0.25),), ()))
    >>> text.splitlines()[-2]
    '<path d="M1 2h0.5v0.25h-0.5z"/>'
    """
    width, height = _number(sheet.width_mm), _number(sheet.height_mm)
    black = "".join(
        f"M{_number(r.x_mm)} {_number(r.y_mm)}h{_number(r.width_mm)}"
        f"v{_number(r.height_mm)}h-{_number(r.width_mm)}z"
        for r in sheet.rectangles
    )
    texts = (
        f'<text x="{_number(t.x_mm)}" y="{_number(t.y_mm)}" font-size="{_number(t.size_mm)}">'
        f"{escape(t.content)}</text>"
        for t in sheet.texts
    )
    lines = (
        '<svg xmlns="http://www.w3.org/2000/svg" font-family="Helvetica, Arial, sans-serif"',
        f' width="{width}mm" height="{height}mm" viewBox="0 0 {width} {height}">',
        f"<title>{escape(sheet.title)}</title>",
        f'<rect width="{width}" height="{height}" fill="#fff"/>',
        *texts,
        f'<path d="{black}"/>',
        "</svg>",
    )
    return "\n".join(lines) + "\n"


def pdf_bytes(sheet: Sheet) -> bytes:
    """Write a sheet as PDF, which asks the viewer not to scale it when it is printed.

    References
    ----------
    ISO 32000-1:2008, 7.5 (file structure), 8.5 (paths), 9.4 (text), 12.2 (``PrintScaling``).

    Examples
    --------
    >>> pdf_bytes(Sheet("Nothing", 20, 10, (), ())).splitlines()[0]
    b'%PDF-1.6'
    """
    size = f"{_number(sheet.width_mm * _POINTS_PER_MM)} {_number(sheet.height_mm * _POINTS_PER_MM)}"
    content = _pdf_drawing(sheet)
    bodies = (
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {size}] /Contents 5 0 R "
        "/Resources << /Font << /F 4 0 R >> >> >>".encode("ascii"),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
        b"<< /Length %d >>\nstream\n%b\nendstream" % (len(content), content),
        b"<< /Title %b >>" % _pdf_string(sheet.title),
    )
    return _pdf_file(bodies)


def _pdf_drawing(sheet: Sheet) -> bytes:
    """Draw in mm with y down, as the sheet has it; letters are turned upright again."""
    scale = f"{_POINTS_PER_MM:.10f}"
    height = _number(sheet.height_mm * _POINTS_PER_MM)
    lines = [f"{scale} 0 0 -{scale} 0 {height} cm".encode("ascii")]
    for r in sheet.rectangles:
        numbers = (r.x_mm, r.y_mm, r.width_mm, r.height_mm)
        lines.append(f"{' '.join(map(_number, numbers))} re".encode("ascii"))
    lines.append(b"f" if sheet.rectangles else b"n")
    for t in sheet.texts:
        place = f"BT /F {_number(t.size_mm)} Tf 1 0 0 -1 {_number(t.x_mm)} {_number(t.y_mm)} Tm "
        lines.append(place.encode("ascii") + _pdf_string(t.content) + b" Tj ET")
    return b"\n".join(lines)


def _pdf_file(bodies: tuple[bytes, ...]) -> bytes:
    """Join the objects, the catalog first and the title last, and list where they begin."""
    data = b"%PDF-1.6\n%\xb5\xb5\xb5\xb5\n"  # the second line says that this is no plain text
    places = []
    for number, body in enumerate(bodies, start=1):
        places.append(len(data))
        data += b"%d 0 obj\n%b\nendobj\n" % (number, body)
    count = len(bodies) + 1
    table = b"".join(b"%010d 00000 n \n" % place for place in places)
    return data + (
        b"xref\n0 %d\n0000000000 65535 f \n%btrailer\n<< /Size %d /Root 1 0 R /Info %d 0 R >>\n"
        b"startxref\n%d\n%%%%EOF\n" % (count, table, count, count - 1, len(data))
    )


def _pdf_string(text: str) -> bytes:
    escaped = text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
    return b"(%b)" % escaped.encode("cp1252")


def _number(value: float) -> str:
    """Print a length with at most five decimals: ten nanometres.

    Examples
    --------
    >>> _number(15.0), _number(11 / 6)
    ('15', '1.83333')
    """
    return f"{value:.5f}".rstrip("0").rstrip(".")
