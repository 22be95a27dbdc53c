"""Time and size of a report of 70 poses, as page and as PDF, each in a process of its own.

Targets: page 2 s and 6 MB, PDF 1 s once measured; `measure` draws the PDF after the page. Processor
time, so that a busy machine counts less; imports do not count. Without a report to draw again, a
session is simulated and measured first (two minutes).

Run: OMP_NUM_THREADS=1 python -m benchmarks.report [REPORT.html]
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from pivometer import pipeline
from pivometer.pipeline.reporting import Report, page_of, pdf_of, report_in
from pivometer.report.embedding import RECORD, RESULT, blocks_of_page, pictures_of_page, unpacked

RUNS = 3


def main() -> None:
    """Print the least of a few runs, with the sizes."""
    if len(sys.argv) == 3:
        _timed(*sys.argv[1:])
        return
    with tempfile.TemporaryDirectory() as folder:
        file = Path(sys.argv[1]) if len(sys.argv) > 1 else _measured(Path(folder) / "session")
        print(f"{'':8}{'CPU s':>8}{'wall s':>8}{'MB':>7}")
        for kind in ("page", "pdf", "after"):
            command = [sys.executable, "-m", "benchmarks.report", str(file), kind]
            runs = [
                subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603
                for _ in range(RUNS)
            ]
            cpu, wall, size = min(tuple(map(float, run.stdout.split())) for run in runs)
            print(f"{kind:8}{cpu:8.2f}{wall:8.2f}{size / 1e6:7.2f}")


def _measured(folder: Path) -> Path:
    session = pipeline.load(pipeline.simulate("davinci", folder, poses=70))
    written = pipeline.write_measurement(pipeline.measure(session), session, folder / "results")
    return written["report.html"]


def _timed(file: str, kind: str) -> None:
    """Draw a report once, with nothing kept from before."""
    report = _read(Path(file))
    __import__("jinja2" if kind == "page" else "typst")
    if kind == "after":
        page_of(report)
    cpu, wall = time.process_time(), time.perf_counter()
    drawn = page_of(report).encode() if kind == "page" else pdf_of(report)
    print(time.process_time() - cpu, time.perf_counter() - wall, len(drawn))


def _read(file: Path) -> Report:
    page = file.read_text(encoding="utf-8")
    texts = {name: unpacked(block) or "" for name, block in blocks_of_page(page).items()}
    return report_in(texts[RESULT], texts[RECORD], pictures_of_page(page))


if __name__ == "__main__":
    main()
