import re

import numpy as np
import pytest

from pivometer.report.chart import pose_chart
from pivometer.report.coverage import coverage_pictures
from pivometer.report.overlays import pose_pictures
from pivometer.report.scene import HEIGHT, scene, scene_picture
from pivometer.report.target import (
    Labels,
    deciding_poses,
    mean_shaft_view,
    nearest_points_mm,
    shaft_view,
    target_offsets_mm,
    target_plot,
)


def coordinates(text):
    return np.array([[float(value) for value in pair.split(",")] for pair in text.split()])


def numbers_of(measurement):
    used = set(measurement.used)
    return [n for n, pose in enumerate(measurement.poses, start=1) if pose in used]


@pytest.mark.parametrize("seed", range(5))
def test_view_is_a_right_handed_turn_along_the_mean(seed):
    rng = np.random.default_rng(seed)
    mean = rng.normal(size=3)
    mean /= np.linalg.norm(mean)
    lines = (mean + 0.1 * rng.normal(size=(200, 3))) * rng.choice([-1, 1], size=(200, 1))
    view = shaft_view(lines / np.linalg.norm(lines, axis=1)[:, None])
    axes = np.array([view.right, view.down, view.into])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    # 200 directions with 0.1 of scatter: their mean is good to 0.1/√200 per axis; 5 σ.
    assert abs(view.into @ mean) > np.cos(5 * 0.1 / np.sqrt(200) * np.sqrt(2))


def test_target_dots_lie_at_their_true_distance(measurement):
    offsets = target_offsets_mm(measurement, mean_shaft_view(measurement))
    distances = [pose.distance_mm.minimax for pose in measurement.used]
    np.testing.assert_allclose(np.linalg.norm(offsets, axis=1), distances, rtol=1e-12)


def test_target_dots_lie_on_the_side_where_the_line_passes(measurement):
    view = mean_shaft_view(measurement)
    centre = measurement.rcm.minimax.point_mm
    misses = nearest_points_mm(measurement) - centre
    for offset, miss in zip(target_offsets_mm(measurement, view), misses, strict=True):
        seen = np.array([view.right @ miss, view.down @ miss])
        assert abs(np.cross(np.append(offset, 0), np.append(seen, 0))[2]) < 1e-12
        assert offset @ seen > 0


def test_target_shows_every_pose_and_marks_the_deciding_ones(measurement):
    drawn = target_plot(measurement, numbers_of(measurement))
    assert drawn.count('class="dot"') == 70 - len(deciding_poses(measurement))
    assert drawn.count('class="dot worst"') == len(deciding_poses(measurement))
    assert f"max {measurement.rcm.minimax.max_mm:.3f}" in drawn
    assert f"rms {measurement.rcm.minimax.rms_mm:.3f}" in drawn


def test_exact_lines_can_be_drawn(make_measurement):
    measurement = make_measurement(count=4, miss_mm=0.0)
    assert "nan" not in target_plot(measurement, [1, 2, 3, 4])
    assert "nan" not in pose_chart(measurement)


def test_labels_cover_neither_dots_nor_each_other():
    labels = Labels(np.zeros((3, 2)))
    corners = [labels.place(0.0, 0.0, "12", gap=5.0) for _ in range(6)]
    placed = [corner for corner in corners if corner is not None]
    assert len(placed) == len(set(placed)) == 4


def test_chart_bars_are_as_high_as_the_misses(measurement):
    drawn = pose_chart(measurement)
    heights = [float(h) for h in re.findall(r'height="([\d.]+)" class="bar', drawn)]
    distances = np.array([pose.distance_mm.minimax for pose in measurement.used])
    np.testing.assert_allclose(heights, distances * max(heights) / distances.max(), atol=0.011)
    assert drawn.count('class="rejected"') == 2
    assert drawn.count('class="least-squares"') == 70


def test_chart_of_many_poses_names_only_some(make_measurement):
    drawn = pose_chart(make_measurement(count=200))
    assert 60 < drawn.count("rotate(-90") <= 90


def test_edges_are_drawn_where_they_were_found(measurement, thumbnails):
    pose = measurement.used[3]
    for picture, edges in zip(
        pose_pictures(pose, measurement, thumbnails), pose.edges, strict=True
    ):
        drawn = re.findall(r'points="([^"]*)" class="edge"', picture.overlay)
        for text, edge in zip(drawn, edges.points_px, strict=True):
            points = coordinates(text)
            np.testing.assert_allclose(points[[0, -1]], edge[[0, -1]], atol=0.0051)
        assert 'viewBox="-0.5 -0.5 640 480"' in picture.overlay


def test_centerline_is_drawn_between_its_edges_and_ends_with_them(measurement, thumbnails):
    for pose in measurement.used[:10]:
        for picture, edges in zip(
            pose_pictures(pose, measurement, thumbnails), pose.edges, strict=True
        ):
            line = coordinates(
                re.search(r'points="([^"]*)" class="centerline"', picture.overlay)[1]
            )
            ends = edges.points_px[:, [0, -1]].mean(axis=0)
            half_width = np.linalg.norm(edges.points_px[0, 0] - edges.points_px[1, 0]) / 2
            assert np.linalg.norm(line[[0, -1]] - ends, axis=1).max() < 0.2 * half_width


def test_rcm_cross_is_its_projection(measurement, thumbnails):
    pose = measurement.used[0]
    rig = measurement.calibration.rig
    for index, picture in enumerate(pose_pictures(pose, measurement, thumbnails)):
        inside = rig.reference_from_camera[index].inverse() @ measurement.rcm.minimax.point_mm
        x, y = rig.cameras[index].project(inside)
        shown = re.search(r'd="M([\d.]+),([\d.]+)h([\d.]+)M', picture.overlay)
        left, at, width = (float(value) for value in shown.groups())
        assert (left + width / 2, at) == pytest.approx((x, y), abs=0.02)


def test_rejected_pose_shows_the_edges_it_has(measurement, thumbnails):
    left, right = pose_pictures(measurement.rejected[0], measurement, thumbnails)
    assert left.overlay.count('class="edge"') == 2
    assert "polyline" not in right.overlay
    assert right.description.endswith("no edges were found")


def test_scene_at_the_rcm_shows_misses_to_scale(measurement):
    shown = scene(measurement, numbers_of(measurement))
    drawn = scene_picture(shown, shown.near_zoom, "near")
    scale = shown.scale * shown.near_zoom
    radii = re.findall(r'<circle r="([\d.]+)" data-mm="([^"]+)"', drawn)
    for radius, mm in radii:
        assert float(radius) == pytest.approx(float(mm) * scale, abs=0.006)
    largest = measurement.rcm.minimax.max_mm * scale
    assert 0.36 * HEIGHT / 2.51 < largest <= 0.36 * HEIGHT
    lengths = []
    for text in re.findall(r'points="([^"]*)" class="miss', drawn):
        start, end = coordinates(text)
        assert np.abs(start).max() < 0.011
        lengths.append(np.linalg.norm(end))
    distances = np.array([pose.distance_mm.minimax for pose in measurement.used]) * scale
    assert len(lengths) == 70
    assert (np.array(lengths) <= distances + 0.02).all()


def test_scene_holds_all_that_the_script_needs(measurement):
    drawn = scene_picture(scene(measurement, numbers_of(measurement)), 1, "scene")
    assert drawn.count('class="centerline') == 70
    assert drawn.count('class="camera"') == 2
    assert drawn.count('class="baseline"') == 1
    rotation = [float(v) for v in re.search(r'data-rotation="([^"]*)"', drawn)[1].split()]
    matrix = np.array(rotation).reshape(3, 3)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-8)
    scale = float(re.search(r'data-scale="([^"]*)"', drawn)[1])
    centre = np.array(re.search(r'data-centre="([^"]*)"', drawn)[1].split(), dtype=float)
    line = re.search(r'points="([^"]*)" class="baseline" data-p="([^"]*)"', drawn)
    ends = np.array(line[2].split(), dtype=float).reshape(-1, 3)
    np.testing.assert_allclose(
        coordinates(line[1]), (ends - centre) @ matrix[:2].T * scale, atol=0.006
    )


@pytest.mark.parametrize("zoom", [1, 100, 500])
def test_scale_bar_has_the_length_it_says(measurement, zoom):
    shown = scene(measurement, numbers_of(measurement))
    drawn = scene_picture(shown, zoom, "scene")
    bar = re.search(r'd="M0,-5V0H([\d.]+)V-5"></path><text x="0" y="16">([\d.]+) mm', drawn)
    assert float(bar[1]) == pytest.approx(float(bar[2]) * shown.scale * zoom, abs=0.06)
    assert 55 < float(bar[1]) <= 151


def test_coverage_pictures_show_the_corners_of_every_camera(measurement):
    drawn = coverage_pictures(measurement.calibration)
    assert len(drawn) == len(measurement.calibration.rig.cameras)
    for (svg, caption), camera in zip(drawn, measurement.calibration.rig.cameras, strict=True):
        assert svg.startswith("<svg")
        assert "board corners in the image" in svg
        assert f"Camera {camera.name}: all " in caption


def test_the_name_of_a_circle_covers_no_dot():
    radius, turn = 100.0, np.radians(-135)
    dot = (radius + 12) * np.array([[np.cos(turn), np.sin(turn)]])
    free = Labels(np.empty((0, 2))).place_outside(radius, -135, "rms 1.771")
    moved = Labels(dot).place_outside(radius, -135, "rms 1.771")
    assert free != moved
    for x, y in (free, moved):
        right = x + 7.6 * len("rms 1.771")
        assert np.hypot(right, y) == pytest.approx(radius)
    assert not (x - 4 < dot[0, 0] < right + 4 and y - 14 < dot[0, 1] < y + 5)
