"""Boards to print: the page as it is in the files, against OpenCV's boards and our own detector."""

import re
import tomllib
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from xml.etree import ElementTree as ET

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pivometer import pipeline
from pivometer._arrays import Floats
from pivometer.calibration import Board, find_corners
from pivometer.errors import UsageError
from pivometer.io.settings import read_settings
from pivometer.io.sheet import Rectangle, Sheet, Text, pdf_bytes, sheet_content, svg_text
from pivometer.io.target import PAPERS_MM, Paper, session_lines, target_sheet

CHECKER = Board("checkerboard", (10, 7), 15.0)
CHARUCO = Board("charuco", (9, 7), 15.0, None, "DICT_4X4_50", 11.0)
BOARDS = [
    CHECKER,
    Board("checkerboard", (9, 7), 12.3),
    Board("checkerboard", (6, 11), 16.0),
    CHARUCO,
    Board("charuco", (6, 8), 18.0, None, "DICT_5X5_100", 14.0),
]
NUMBER = r"-?\d+(?:\.\d+)?"


# --- What is in the files, read without the code that wrote them ---


def svg_rectangles(svg: str) -> Floats:
    """Rows x, y, width, height of the rectangles drawn in an SVG, mm."""
    path = ET.fromstring(svg).find("{*}path")  # noqa: S314 - our own text
    assert path is not None
    drawn = path.attrib["d"]
    one = re.compile(rf"M({NUMBER}) ({NUMBER})h({NUMBER})v({NUMBER})h-({NUMBER})z")
    assert one.sub("", drawn) == ""
    assert all(found[2] == found[4] for found in one.findall(drawn))
    return np.array([[float(v) for v in found[:4]] for found in one.findall(drawn)])


def svg_texts(svg: str) -> Iterator[tuple[float, float, float, str]]:
    for text in ET.fromstring(svg).iterfind("{*}text"):  # noqa: S314 - our own text
        x, y, size = (float(text.attrib[name]) for name in ("x", "y", "font-size"))
        yield x, y, size, str(text.text)


def pdf_page(pdf: bytes) -> tuple[Floats, list[tuple[float, float, float, str]], Floats]:
    """Rectangles and texts on the page, in mm and y down, and the page's size, mm."""
    box = re.search(rb"/MediaBox \[0 0 (\S+) (\S+)\]", pdf)
    stream = re.search(rb"stream\n(.*)\nendstream", pdf, re.DOTALL)
    assert box is not None
    assert stream is not None
    page = np.array([float(box[1]), float(box[2])]) * 25.4 / 72
    first, *rest = stream[1].decode("cp1252").splitlines()
    a, b, c, d, e, f = (float(word) * 25.4 / 72 for word in first.removesuffix(" cm").split())
    assert (b, c, e) == (0, 0, 0)  # then a drawing unit is a mm, and y goes down from the top:
    np.testing.assert_allclose([a, d, f], [1, -1, page[1]], atol=1e-6)
    one = rf"BT /F ({NUMBER}) Tf 1 0 0 -1 ({NUMBER}) ({NUMBER}) Tm \((.*)\) Tj ET"
    found = [re.fullmatch(one, line) or line for line in rest]
    rectangles = [line.split() for line in found if isinstance(line, str)]
    assert [words[-1] for words in rectangles] == ["re"] * (len(rectangles) - 1) + ["f"]
    texts = [
        (float(text[2]), float(text[3]), float(text[1]), re.sub(r"\\(.)", r"\1", text[4]))
        for text in found
        if not isinstance(text, str)
    ]
    drawn = np.array([[float(word) for word in words[:4]] for words in rectangles[:-1]])
    return drawn, texts, page


def raster(rectangles: Floats, page_mm: tuple[float, float], px_per_mm: float) -> Floats:
    """Share of every pixel that is white; exact, as the rectangles do not overlap."""
    black = np.zeros([round(side * px_per_mm) for side in page_mm[::-1]])
    for x, y, width, height in rectangles * px_per_mm:
        columns = covered(x, x + width, black.shape[1])
        rows = covered(y, y + height, black.shape[0])
        black[rows[0], columns[0]] += np.outer(rows[1], columns[1])
    assert black.max() < 1 + 1e-3  # no overlap
    return 1 - black.clip(max=1)


def covered(low: float, high: float, count: int) -> tuple[slice, Floats]:
    """Return which pixels an interval touches, and how much of each it covers."""
    first, last = int(low), min(int(high) + 1, count)
    edges = np.arange(first, last)
    return slice(first, last), np.minimum(edges + 1, high) - np.maximum(edges, low)


def camera_image(sheet: Sheet, px_per_mm: float) -> NDArray[np.uint8]:
    """Picture the page as a camera does: blurred by the lens, then averaged over pixels."""
    fine = 3  # blurred only after the sampling, corners would be 0.02 px off
    white = raster(svg_rectangles(svg_text(sheet)), size(sheet), fine * px_per_mm)
    white = cv2.GaussianBlur(white, (0, 0), 0.8 * fine)
    rows, columns = (count // fine for count in white.shape)
    blocks = white[: rows * fine, : columns * fine].reshape(rows, fine, columns, fine)
    return np.rint(30 + 190 * blocks.mean(axis=(1, 3))).astype(np.uint8)


def size(sheet: Sheet) -> tuple[float, float]:
    return sheet.width_mm, sheet.height_mm


# --- The board ---


@pytest.mark.parametrize("board", BOARDS, ids=str)
def test_our_detector_finds_the_corners_where_they_are(board: Board) -> None:
    sheet = target_sheet(board)
    scale = 4.07  # px/mm, so that edges fall anywhere in pixels
    view = find_corners(camera_image(sheet, scale), board, camera="left", view="board/000")
    inner = (np.array(board.squares) - 2) * board.square_mm
    corners = (np.array(size(sheet)) - inner) / 2 + board.corners_mm[:, :2]
    expected = corners * scale - 0.5
    assert len(view.ids) == board.corner_count
    errors = [np.abs(view.pixels - expected[turn]).max() for turn in board.symmetries]
    assert min(errors) < 0.02


@pytest.mark.parametrize(
    ("squares", "name", "modules"),
    [((9, 7), "DICT_4X4_50", 6), ((5, 8), "DICT_4X4_50", 6), ((6, 4), "DICT_ARUCO_MIP_36h12", 8)],
)
def test_charuco_boards_are_those_of_opencv(
    squares: tuple[int, int], name: str, modules: int
) -> None:
    """Drawn with whole pixels a module, both pictures are the same in every pixel."""
    module, scale = 1.5, 2  # mm, px/mm
    side, marker = (modules + 2) * module, modules * module
    sheet = target_sheet(Board("charuco", squares, side, None, name, marker), paper="A3")
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    pixels = tuple(round(count * side * scale) for count in squares)
    theirs = cv2.aruco.CharucoBoard(squares, side, marker, dictionary).generateImage(pixels)
    drawn = svg_rectangles(svg_text(sheet))[:-3]  # without the check line
    origin = (np.array([sheet.width_mm, sheet.height_mm]) - np.array(pixels) / scale) / 2
    ours = raster(drawn - [*origin, 0, 0], (pixels[0] / scale, pixels[1] / scale), scale)
    np.testing.assert_allclose(ours * 255, theirs, atol=0.1)


# --- The page ---


@pytest.mark.parametrize("board", BOARDS, ids=str)
@pytest.mark.parametrize("paper", PAPERS_MM)
def test_pdf_and_svg_are_the_same_page(board: Board, paper: Paper) -> None:
    sheet = target_sheet(board, paper=paper)
    svg = svg_text(sheet)
    rectangles, texts, page = pdf_page(pdf_bytes(sheet))
    np.testing.assert_array_equal(rectangles, svg_rectangles(svg))
    assert texts == list(svg_texts(svg))
    stated = re.search(r'width="(.*?)mm" height="(.*?)mm" viewBox="0 0 (.*?) (.*?)"', svg)
    assert stated is not None
    np.testing.assert_array_equal(np.array(stated.groups(), dtype=float), [*size(sheet)] * 2)
    np.testing.assert_allclose(page, size(sheet), atol=1e-5)
    assert sorted(size(sheet)) == sorted(PAPERS_MM[paper])


@pytest.mark.parametrize("board", BOARDS, ids=str)
def test_print_keeps_a_square_away_from_the_board(board: Board) -> None:
    """Checked for the largest squares that fit, where it is tightest."""
    for paper in PAPERS_MM:
        largest = largest_square(board, paper)
        sheet = target_sheet(resized(board, largest), paper=paper)
        half = np.array(board.squares) * largest / 2
        low, high = np.array(size(sheet)) / 2 - half, np.array(size(sheet)) / 2 + half
        quiet = (low - largest + 1e-9, high + largest - 1e-9)
        assert (quiet[0] >= 0).all()
        assert (quiet[1] <= size(sheet)).all()
        ys = [(t.y_mm - t.size_mm, t.y_mm + 0.25 * t.size_mm) for t in sheet.texts]
        ys += [(r.y_mm, r.y_mm + r.height_mm) for r in sheet.rectangles[-3:]]
        for top, bottom in ys:
            assert bottom <= quiet[0][1] or top >= quiet[1][1]
            assert top >= 6.5
            assert bottom <= sheet.height_mm - 6.5
        for t in sheet.texts:  # 0.6 em is more than Helvetica takes for such text
            assert t.x_mm + 0.6 * t.size_mm * len(t.content) < sheet.width_mm - 6.5


def largest_square(board: Board, paper: Paper) -> float:
    """Return the largest square, as a refusal tells it."""
    with pytest.raises(UsageError) as refused:
        target_sheet(resized(board, 60.0), paper=paper)
    told = re.search(r"squares of at most (\S+) mm", refused.value.next_step)
    assert told is not None
    return float(told[1])


def resized(board: Board, square_mm: float) -> Board:
    marker = None if board.marker_mm is None else 0.7 * square_mm
    return Board(board.kind, board.squares, square_mm, None, board.dictionary, marker)


@pytest.mark.parametrize("paper", PAPERS_MM)
def test_a_board_that_is_too_large_gets_the_largest_that_fits(paper: Paper) -> None:
    for board in BOARDS:
        largest = largest_square(board, paper)
        target_sheet(resized(board, largest), paper=paper)
        with pytest.raises(UsageError, match=f"does not fit on {paper} paper"):
            target_sheet(resized(board, largest + 0.101), paper=paper)


def test_a_board_of_too_many_squares_gets_no_useless_size() -> None:
    with pytest.raises(UsageError) as refused:
        target_sheet(Board("checkerboard", (400, 300), 5.0))
    assert refused.value.next_step == "take fewer squares or larger paper"


def test_the_sheet_lies_as_the_board_unless_it_fits_only_otherwise() -> None:
    lying = target_sheet(Board("checkerboard", (9, 7), 15.0))
    standing = target_sheet(Board("checkerboard", (7, 9), 15.0))
    turned = target_sheet(Board("checkerboard", (10, 9), 17.2))
    assert [sheet.width_mm for sheet in (lying, standing, turned)] == [297, 210, 210]


@pytest.mark.parametrize("paper", PAPERS_MM)
def test_the_check_line_is_100_mm(paper: Paper) -> None:
    sheet = target_sheet(CHECKER, paper=paper)
    line, left, right = sheet.rectangles[-3:]
    assert right.x_mm - left.x_mm == pytest.approx(100, abs=1e-9)  # equal ticks: middle to middle
    assert left.width_mm == right.width_mm
    assert line.x_mm == pytest.approx(left.x_mm + left.width_mm)
    assert line.x_mm + line.width_mm == pytest.approx(right.x_mm)
    assert any("Measure this line: 100 mm" in text.content for text in sheet.texts)


@pytest.mark.parametrize("board", BOARDS, ids=str)
def test_the_lines_for_session_toml_describe_the_board(board: Board, tmp_path: Path) -> None:
    printed = [text.content for text in target_sheet(board).texts]
    lines = session_lines(board)
    start = printed.index("[board]")
    assert printed[start : start + len(lines)] == list(lines)
    path = tmp_path / "session.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    assert tomllib.loads(path.read_text(encoding="utf-8"))["board"]["square_mm"] == board.square_mm
    read = read_settings(path).board
    assert [getattr(read, name) for name in Board.__slots__] == [
        getattr(board, name) for name in Board.__slots__
    ]


def test_the_page_says_how_to_print_and_measure() -> None:
    said = " ".join(text.content for text in target_sheet(CHECKER).texts)
    for words in (
        "10 × 7 squares (across × down), nominal square 15 mm",
        "Print at 100 %",
        "Measure one square over the whole board",
        "150 mm across / 10, 105 mm down / 7",
        "Write it into session.toml",
    ):
        assert words in said


# --- The files ---


def test_the_same_board_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.pdf", "a.svg"):
        first = pipeline.write_target(CHARUCO, tmp_path / name).read_bytes()
        again = pipeline.write_target(CHARUCO, tmp_path / "again" / name, paper="A4").read_bytes()
        assert first == again
        assert first != pipeline.write_target(CHECKER, tmp_path / name).read_bytes()


def test_the_pdf_lists_where_its_objects_begin() -> None:
    data = pdf_bytes(target_sheet(CHARUCO))
    start = int(data.rsplit(b"startxref\n", 1)[1].split()[0])
    head, count, *_ = data[start:].split(b"\n", 2)
    assert (head, count) == (b"xref", b"0 7")
    entries = re.findall(rb"(\d{10}) (\d{5}) ([fn]) \n", data[start:])
    assert len(entries) == 7
    for number, (place, _, _) in enumerate(entries[1:], start=1):
        assert data[int(place) :].startswith(b"%d 0 obj\n" % number)
    length = re.search(rb"/Length (\d+) >>\nstream\n", data)
    assert length is not None
    assert data[length.end() + int(length[1]) :].startswith(b"\nendstream")
    assert b"/PrintScaling /None" in data


def test_letters_with_a_meaning_in_the_formats_stay_letters() -> None:
    text = Text(1.0, 2.0, 3.0, r"a (b\c) <d> & é ×")
    sheet = Sheet("T (<&>", 20.0, 10.0, (Rectangle(1, 1, 1, 1),), (text,))
    assert [*svg_texts(svg_text(sheet))] == pdf_page(pdf_bytes(sheet))[1]
    assert next(svg_texts(svg_text(sheet)))[3] == text.content


@pytest.mark.parametrize(("name", "better"), [("a.ps", "a.pdf"), ("board", "board.pdf")])
def test_another_ending_is_refused(name: str, better: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError) as refused:
        pipeline.write_target(CHECKER, tmp_path / name)
    assert better in refused.value.next_step
    assert not list(tmp_path.iterdir())
    with pytest.raises(UsageError, match=r"target\.pdf"):
        sheet_content(target_sheet(CHECKER), "")


def test_endings_in_capitals_are_known(tmp_path: Path) -> None:
    assert pipeline.write_target(CHECKER, tmp_path / "A.PDF").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("squares", "dictionary", "message"),
    [
        ((9, 7), "DICT_4x4_50", "name one like DICT_4X4_50"),
        ((9, 7), "printMarkers", "knows no ArUco dictionary"),
        ((12, 10), "DICT_4X4_50", "60 white squares, but DICT_4X4_50 only 50 markers"),
    ],
)
def test_markers_that_do_not_exist_are_refused(
    squares: tuple[int, int], dictionary: str, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        target_sheet(Board("charuco", squares, 10.0, None, dictionary, 7.0))


def test_the_board_is_in_the_middle_and_in_the_title() -> None:
    for board, paper in product(BOARDS, PAPERS_MM):
        sheet = target_sheet(board, paper=paper)
        assert str(board) in sheet.title
        squares = [r for r in sheet.rectangles if r.width_mm == r.height_mm == board.square_mm]
        assert squares[0].x_mm == pytest.approx(
            (sheet.width_mm - board.squares[0] * board.square_mm) / 2
        )
        low = min(r.y_mm for r in squares)
        high = max(r.y_mm + board.square_mm for r in squares)
        assert low + high == pytest.approx(sheet.height_mm)
