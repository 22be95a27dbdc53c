import base64
import hashlib
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from pivometer.rcm import Finding
from pivometer.report import SimulatedTruth, Thumbnail, make_thumbnail, render_html
from pivometer.shaft.across import EdgeProfiles

VOID = {"meta", "img", "br", "link", "input", "hr"}
HOSTILE = "<script>alert('x')</script><img src=x onerror=alert(1)>\"'&"


class Checker(HTMLParser):
    """Collects what is wrong with the nesting, and every attribute and text."""

    def __init__(self):
        super().__init__()
        self.stack, self.faults, self.tags, self.ids, self.headings = [], [], [], [], []
        self.text = ""

    def handle_starttag(self, tag, attrs):
        names = [name for name, _ in attrs]
        if len(names) != len(set(names)):
            self.faults.append(f"{tag} repeats an attribute")
        self.tags.append((tag, dict(attrs)))
        self.ids += [value for name, value in attrs if name == "id"]
        if tag not in VOID:
            self.stack.append(tag)

    def handle_endtag(self, tag):
        if not self.stack or self.stack.pop() != tag:
            self.faults.append(f"</{tag}> does not close what is open")

    def handle_data(self, data):
        if self.stack[-1:] == ["h2"]:
            self.headings.append(data)
        if self.stack[-1:] not in (["style"], ["script"]):
            self.text += data


def parsed(page):
    checker = Checker()
    checker.feed(page)
    checker.close()
    return checker


@pytest.fixture(scope="module")
def finding():
    return Finding("warning", "the cone is 18.0° only", "add poses tilted by 25° or more")


@pytest.fixture(scope="module")
def page(make_measurement, thumbnails, finding):
    measurement = make_measurement(findings=(finding,))
    return render_html(measurement, thumbnails=thumbnails)


@pytest.fixture(scope="module")
def checker(page):
    return parsed(page)


def test_page_is_well_formed_with_one_of_every_id(checker):
    assert checker.faults == []
    assert checker.stack == []
    assert len(checker.ids) == len(set(checker.ids))


def test_the_checker_notices_bad_nesting():
    assert parsed("<p><b>bold</p></b>").faults != []


def test_page_asks_no_host_for_anything(page, checker):
    loading = {"src", "href", "srcset", "data", "action", "xlink:href", "poster", "background"}
    for _, attributes in checker.tags:
        for name in loading & set(attributes):
            assert attributes[name].startswith(("data:image/jpeg;base64,", "#"))
    assert "://" not in page
    assert "@import" not in page
    assert "url(" not in page
    policy = dict(checker.tags[3][1])
    assert policy["http-equiv"] == "Content-Security-Policy"
    assert policy["content"].startswith("default-src 'none'; img-src data:;")


def test_only_our_script_may_run(checker):
    tags = [attributes for tag, attributes in checker.tags if tag == "script"]
    assert tags == [{}]
    assert not any(name.startswith("on") for _, attributes in checker.tags for name in attributes)


def test_the_policy_names_the_script_by_its_hash(page, checker):
    script = re.search(r"<script>(.*?)</script>", page, re.DOTALL)[1]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in checker.tags[3][1]["content"]


def test_sections_come_in_the_order_a_reader_needs(checker):
    assert checker.headings == [
        "Verdict",
        "Result",
        "Beside the paper’s Table I",
        "Target",
        "Every pose",
        "In space",
        "Pose by pose",
        "Rejected poses",
        "Calibration",
        "Set-up",
        "Provenance",
        "Signatures",
    ]


def test_tables_have_captions_and_scopes_and_pictures_have_descriptions(checker):
    tags = checker.tags
    count = {name: sum(tag == name for tag, _ in tags) for name in ("table", "caption")}
    assert count["table"] == count["caption"] > 70
    assert all(attributes["scope"] in ("row", "col") for tag, attributes in tags if tag == "th")
    assert all(attributes["alt"] for tag, attributes in tags if tag == "img")
    for tag, attributes in tags:
        if tag == "svg":
            assert "aria-hidden" in attributes or attributes["aria-label"]


def test_every_pose_finding_and_reason_is_there(checker, measurement, finding):
    text = checker.text
    for pose in measurement.poses:
        assert f"Pose {pose.pose}" in text
    for pose in measurement.rejected:
        assert text.count(pose.reason) == text.count(pose.next_step) == 2
    assert finding.text in text
    assert finding.next_step in text
    for view in measurement.calibration.rejected:
        assert view.view in text
        assert view.reason in text
    for note in measurement.calibration.notes:
        assert note in text
    for name, digest in measurement.inputs.items():
        assert name in text
        assert digest in text


def test_links_lead_to_poses(checker):
    targets = {a["href"][1:] for tag, a in checker.tags if tag == "a"}
    assert len(targets) == 72
    assert targets <= set(checker.ids)


def test_provenance_is_there(checker, provenance):
    text = checker.text
    assert provenance.command in text
    assert "2026-11-22 09:30 UTC" in text
    for name, version in provenance.versions.items():
        assert name in text
        assert version in text


def test_hostile_names_notes_and_reasons_are_text(make_measurement):
    measurement = make_measurement(
        count=5,
        names=lambda i: f"{HOSTILE}{i}",
        notes=HOSTILE,
        findings=(Finding("refusal", HOSTILE, HOSTILE),),
    )
    pictures = {
        (pose.pose, name): Thumbnail(b"jpeg", 480, 360, 0.75)
        for pose in measurement.poses
        for name in ("left", "right")
    }
    page = render_html(measurement, thumbnails=pictures)
    checker = parsed(page)
    assert checker.faults == []
    assert [attributes for tag, attributes in checker.tags if tag == "script"] == [{}]
    assert {tag for tag, a in checker.tags if "onerror" in a} == set()
    assert f"Pose {HOSTILE}0" in checker.text
    assert checker.text.count(HOSTILE) > 20


def test_seventy_poses_with_the_heaviest_pictures_stay_below_six_megabytes(measurement):
    rng = np.random.default_rng(0)
    noise = make_thumbnail(rng.integers(0, 256, (480, 640), dtype=np.uint8))
    padded = Thumbnail(noise.jpeg.ljust(18_000, b"\0"), noise.width, noise.height, noise.scale)
    keys = [(pose.pose, name) for pose in measurement.poses for name in ("left", "right")]
    across = EdgeProfiles(np.linspace(-8, 8, 22), *rng.uniform(0, 255, (2, 2, 22)))
    measurement = replace(
        measurement, poses=tuple(with_sections(pose, rng) for pose in measurement.poses)
    )
    page = render_html(
        measurement,
        thumbnails=dict.fromkeys(keys, padded),
        profiles=dict.fromkeys(keys, across),
    )
    assert page.count('class="edge-fit"') == page.count('class="edge-line"') > 2 * 140
    size = len(page.encode())
    assert size < 6e6
    assert size - 142 * 24_000 < 1.5e6


def with_sections(pose, rng):
    """The pose with offsets stated all along its edges."""
    sections = {
        "deviation_px": rng.normal(0, 0.05, (2, 16)),
        "deviation_sigma_px": np.full((2, 16), 0.02),
    }
    return replace(pose, edges=tuple(replace(one, **sections) for one in pose.edges))


def test_a_pose_without_pictures_keeps_its_numbers(measurement):
    page = render_html(measurement, thumbnails={})
    checker = parsed(page)
    assert checker.faults == []
    assert "Pose 031" in checker.text
    assert not any(tag == "img" for tag, _ in checker.tags)


def test_without_rejected_poses_the_section_is_left_out(measurement):
    from dataclasses import replace

    clean = replace(measurement, poses=measurement.used)
    page = render_html(clean, thumbnails={})
    assert "Rejected poses" not in parsed(page).headings
    assert "None of the 70 poses was rejected." in page


def test_three_cameras(make_measurement):
    measurement = make_measurement(count=6, cameras=("left", "right", "middle"))
    page = render_html(measurement, thumbnails={})
    checker = parsed(page)
    assert checker.faults == []
    assert "diameter middle, mm" in checker.text


def test_simulated_truth_is_set_beside_the_answer(measurement):
    truth = SimulatedTruth([6.436, 65.741, 478.266], 0.2, 0.1)
    page = render_html(measurement, thumbnails={}, simulated_truth=truth)
    row = re.search(r'<th scope="row">y, mm</th>(.*?)</tr>', page)
    cells = [float(value) for value in re.findall(r"<td>(.*?)</td>", row[1])]
    assert cells[0] == pytest.approx(measurement.rcm.least_squares.point_mm[1], abs=5e-4)
    assert cells[1] == 65.741
    assert cells[2] == pytest.approx(cells[0] - cells[1], abs=1e-3)


def test_same_input_gives_the_same_page(measurement):
    first, second = (render_html(measurement, thumbnails={}) for _ in range(2))
    assert first == second
