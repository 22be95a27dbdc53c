"""The report in a real browser: it works, asks no host, and can be read by everyone."""

import pytest

from pivometer.report import render_html


@pytest.fixture
def page(browser, make_measurement, thumbnails, tmp_path):
    path = tmp_path / "report.html"
    path.write_text(render_html(make_measurement(count=8), thumbnails=thumbnails), "utf-8")
    context = browser.new_context(viewport={"width": 1100, "height": 900})
    page = context.new_page()
    page.faults, page.asked = [], []
    page.on("console", lambda message: page.faults.append(message.text))
    page.on("pageerror", lambda error: page.faults.append(str(error)))
    page.on("request", lambda request: page.asked.append(request.url))
    page.goto(path.as_uri())
    yield page
    context.close()


def test_poses_can_be_picked_by_list_key_and_click(page):
    page.select_option("#scene-pose", "2")
    assert page.inner_text("#scene-picked").startswith("Pose 2 · 001: minimax")
    assert page.locator("#scene .picked").count() == 3
    page.select_option("#scene-pose", "")
    assert page.inner_text("#scene-picked") == ""
    page.click("text=all misses")
    dot = page.locator("#scene .dot[data-pose='5'] circle")
    dot.scroll_into_view_if_needed()
    box = dot.bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    picked = page.locator("#scene .dot.picked").get_attribute("data-pose")
    assert page.input_value("#scene-pose") == picked != ""
    page.click("#scene-picked a")
    assert page.url.endswith(f"#pose-{picked}")
    assert page.faults == []
    assert all(url.startswith(("file:", "data:")) for url in page.asked)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_can_be_read_by_everyone(page, scheme):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not there")
    page.emulate_media(color_scheme=scheme)
    found = axe.Axe().run(page)
    assert found.violations_count == 0, found.generate_report()
