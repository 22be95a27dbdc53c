"""What several test files share."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

# Processes that each have threads for their products wait for one another: a sixth of the time.
os.environ.setdefault("OMP_NUM_THREADS", "1")

settings.register_profile("the same every time", derandomize=True)
settings.load_profile("the same every time")

ROOT = Path(__file__).resolve().parents[1]
CHROMIUM = Path("/usr/bin/chromium")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real and independently rendered images, none of which the project may hold."""
    folder = Path(os.environ.get("PIVOMETER_DATA") or ROOT.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip(f"real images are not here ({folder}); set PIVOMETER_DATA to their folder")
    return folder


@pytest.fixture(scope="module")
def browser():
    """A real browser, where there is one."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}")
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(
            executable_path=str(CHROMIUM), args=["--no-sandbox", "--disable-gpu"]
        )
        yield opened
        opened.close()
