"""Rigs to other programs' formats and back, real files of each, and what must be refused."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scipy.io import loadmat, savemat

from pivometer.cameras import Camera, Rig
from pivometer.errors import UsageError
from pivometer.geometry.rigid import RigidTransform
from pivometer.io.formats import FOLDERS, FORMATS, read_any_rig, write_rig
from pivometer.measurement import ImportedRig

LENSES = {
    "none": [],
    "radial2": [-0.28123456789012345, 0.1],
    "brown5": [-0.33, 0.15, 8e-4, -1.2e-3, -0.04],
    "rational8": [0.4, -0.1, 8e-4, -1.2e-3, 0.02, 0.72, -0.2, 0.05],
}
CARRIES = {
    "opencv": set(LENSES),
    "ros": set(LENSES),
    "kalibr": {"none", "radial2"},
    "matlab": {"none", "radial2", "brown5"},
    "colmap": set(LENSES),
    "mrcal": set(LENSES),
}
SEVERAL = ("kalibr", "colmap", "mrcal")


def rig(model: str = "radial2", count: int = 2) -> Rig:
    """Cameras 84° apart, of different sizes, called so that the reference is last by name."""
    cameras = [
        Camera("z-left", 640, 480, [980.1, 984.0 / 3], [314.123456789, 245.1], LENSES[model]),
        Camera("right", 800, 600, [1012.7, 1009.3], [327.7, 2340 / 7], LENSES[model]),
        Camera("top", 800, 600, [1150.1, 1152.2], [405.5, 296.6], LENSES[model]),
    ]
    poses = [
        RigidTransform.identity(),
        RigidTransform.from_rotation_vector([0.03, -1.466, 0.02], [470.123, 5.4, 430.7]),
        RigidTransform.from_rotation_vector([0.5, -0.75, 0.1], [300.3, 300.1, 60.9]),
    ]
    return Rig(cameras[:count], poses[:count])


def round_trip(truth: Rig, file_format: str, folder: Path) -> Rig:
    path = folder / ("rig" if file_format in FOLDERS else "rig.dat")
    write_rig(truth, file_format, path)
    found = read_any_rig(path)
    assert isinstance(found, ImportedRig)
    assert found.file_format == file_format
    return found.rig


def image_grid(camera: Camera) -> np.ndarray:
    x, y = np.linspace(0, camera.width - 1, 9), np.linspace(0, camera.height - 1, 7)
    return np.stack(np.meshgrid(x, y), axis=-1)


@pytest.mark.parametrize(
    ("file_format", "model"), [(f, m) for f in FORMATS for m in LENSES if m in CARRIES[f]]
)
def test_a_round_trip_is_exact_to_1e_12_px_over_the_image(file_format, model, tmp_path):
    truth = rig(model)
    found = round_trip(truth, file_format, tmp_path)
    assert [(c.name, c.width, c.height) for c in found.cameras] == [
        (c.name, c.width, c.height) for c in truth.cameras
    ]
    for ours, true in zip(found.cameras, truth.cameras, strict=True):
        assert ours.model == true.model
        rays = true.normalized_from_pixels(image_grid(true))
        moved = ours.pixels_from_normalized(rays) - true.pixels_from_normalized(rays)
        # 1e-12 px, and the rounding of pixel numbers near 1000 themselves
        assert np.abs(moved).max() < 1e-12 + 2 * np.spacing(1000.0)
    assert_same_poses(found, truth)


def assert_same_poses(found: Rig, truth: Rig) -> None:
    for ours, true in zip(found.reference_from_camera, truth.reference_from_camera, strict=True):
        np.testing.assert_allclose(ours.rotation, true.rotation, atol=2e-15)
        np.testing.assert_allclose(ours.translation_mm, true.translation_mm, atol=1e-12)


@pytest.mark.parametrize("file_format", SEVERAL)
def test_three_cameras_come_back(file_format, tmp_path):
    truth = rig("radial2", 3)
    found = round_trip(truth, file_format, tmp_path)
    order = [[c.name for c in truth.cameras].index(c.name) for c in found.cameras]
    assert order[0] == 0
    same = Rig([truth.cameras[i] for i in order], [truth.reference_from_camera[i] for i in order])
    assert_same_poses(found, same)


@pytest.mark.parametrize("file_format", [f for f in FORMATS if f not in SEVERAL])
def test_a_third_camera_is_refused_where_a_format_has_two(file_format, tmp_path):
    with pytest.raises(UsageError, match="cannot carry 3 cameras") as refusal:
        write_rig(rig("none", 3), file_format, tmp_path / "rig")
    assert "kalibr, colmap or mrcal" in refusal.value.next_step
    assert not (tmp_path / "rig").exists()


@pytest.mark.parametrize(
    ("file_format", "model", "what"),
    [
        ("kalibr", "brown5", "k3 of camera z-left"),
        ("kalibr", "rational8", "the rational distortion of camera z-left"),
        ("matlab", "rational8", "the rational distortion of camera z-left"),
    ],
)
def test_a_lens_that_a_format_cannot_carry_is_refused(file_format, model, what, tmp_path):
    with pytest.raises(UsageError, match=f"{file_format} cannot carry {what}"):
        write_rig(rig(model), file_format, tmp_path / "rig")


# --- What the other programs themselves make of our files ---


def test_opencv_reads_our_file_and_projects_alike(tmp_path):
    truth = rig("rational8")
    for name in ("rig.yml", "rig.xml", "rig.json"):
        write_rig(truth, "opencv", tmp_path / name)
        storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_READ)
        M2, D2, R, T = (storage.getNode(key).mat() for key in ("M2", "D2", "R", "T"))
        X = np.array([[30.0, -20, 480], [-60, 40, 500]])
        theirs = cv2.projectPoints(X, cv2.Rodrigues(R)[0], T, M2, D2)[0][:, 0]
        ours = truth.cameras[1].project(truth.reference_from_camera[1].inverse() @ X)
        np.testing.assert_allclose(ours, theirs, atol=1e-8)
        assert_same_poses(read_any_rig(tmp_path / name).rig, truth)


def test_ros_files_rectify_as_opencv_does_with_them(tmp_path):
    truth = rig("brown5")
    write_rig(truth, "ros", tmp_path / "ros")
    X = np.array([[30.0, -20, 480], [-60, 40, 500]])
    rows = []
    for camera, pose in zip(truth.cameras, truth.reference_from_camera, strict=True):
        info = yaml.safe_load((tmp_path / "ros" / f"{camera.name}.yaml").read_text())
        K, D, R, P = (
            np.array(info[key]["data"]).reshape(info[key]["rows"], -1)
            for key in (
                "camera_matrix",
                "distortion_coefficients",
                "rectification_matrix",
                "projection_matrix",
            )
        )
        pixels = camera.project(pose.inverse() @ X)[:, None]
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-15)
        found = cv2.undistortPoints(pixels, K, D, R=R, P=P[:, :3], criteria=criteria)[:, 0]
        rows.append(found - [0, P[1, 2]])
        np.testing.assert_allclose(rows[0][:, 1], rows[-1][:, 1], atol=1e-6)  # the same row
    P = np.array(info["projection_matrix"]["data"]).reshape(3, 4)
    left = yaml.safe_load((tmp_path / "ros" / "z-left.yaml").read_text())
    P1 = np.array(left["projection_matrix"]["data"]).reshape(3, 4)
    disparity = (rows[0][:, 0] - P1[0, 2]) - (rows[1][:, 0] - P[0, 2])
    R1 = np.array(left["rectification_matrix"]["data"]).reshape(3, 3)
    np.testing.assert_allclose(-P[0, 3] * 1000 / disparity, X @ R1[2], rtol=1e-8)


def test_matlabs_struct_is_transposed_and_counts_pixels_from_one(tmp_path):
    truth = rig("brown5")
    write_rig(truth, "matlab", tmp_path / "rig.mat")
    struct = loadmat(tmp_path / "rig.mat", simplify_cells=True)["stereoParams"]
    x = np.array([[30.0, -20, 480], [-60, 40, 500]])
    right = x @ struct["RotationOfCamera2"] + struct["TranslationOfCamera2"]
    np.testing.assert_allclose(right, truth.reference_from_camera[1].inverse() @ x, atol=1e-12)
    K = struct["CameraParameters2"]["IntrinsicMatrix"]
    assert K[2, 0] == truth.cameras[1].principal_point_px[0] + 1
    assert struct["CameraParameters2"]["ImageSize"].tolist() == [600, 800]


def test_colmaps_first_pixel_is_at_one_half(tmp_path):
    truth = rig("radial2")
    write_rig(truth, "colmap", tmp_path / "model")
    line = (tmp_path / "model" / "cameras.txt").read_text().splitlines()[1].split()
    assert line[:4] == ["1", "OPENCV", "640", "480"]
    assert float(line[6]) == pytest.approx(truth.cameras[0].principal_point_px[0] + 0.5)


def test_kalibr_and_mrcal_are_in_metres(tmp_path):
    truth = rig("radial2")
    write_rig(truth, "kalibr", tmp_path / "chain.yaml")
    T = np.array(yaml.safe_load((tmp_path / "chain.yaml").read_text())["cam1"]["T_cn_cnm1"])
    expected = truth.reference_from_camera[1].inverse().translation_mm / 1000
    np.testing.assert_allclose(T[:3, 3], expected, atol=1e-15)
    write_rig(truth, "mrcal", tmp_path / "models")
    text = (tmp_path / "models" / "right.cameramodel").read_text()
    assert f"{expected[2]!r} ]".replace("np.float64(", "").replace(")", "") in text


# --- Real files ---


@pytest.fixture
def real(shared_data: Path) -> Path:
    return shared_data / "formats"


def copied(source: Path, names: list[str], folder: Path) -> Path:
    folder.mkdir()
    for name in names:
        (folder / name).write_bytes((source / name).read_bytes())
    return folder


def test_real_opencv_pair(real, tmp_path):
    folder = copied(real, ["opencv_intrinsics.yml", "opencv_extrinsics.yml"], tmp_path / "cv")
    with pytest.raises(UsageError, match="states no image size"):
        read_any_rig(folder, unit_mm=25.0)
    with pytest.raises(UsageError, match="states no unit of length") as refusal:
        read_any_rig(folder, image_size=(640, 480))
    assert "--unit-mm" in refusal.value.next_step
    found = read_any_rig(folder, unit_mm=25.0, image_size=(640, 480)).rig
    assert [c.model for c in found.cameras] == ["rational8", "rational8"]
    assert found.cameras[0].distortion[7] == -0.39963356690988139
    assert found.baselines_mm[0] == pytest.approx(25 * 3.3431, rel=1e-4)
    assert found.reference_from_camera[1].translation_mm[0] > 0  # the right camera is to the right
    with pytest.raises(UsageError, match="holds M1, D1, M2, D2, not two cameras") as refusal:
        read_any_rig(real / "opencv_intrinsics.yml", unit_mm=25.0, image_size=(640, 480))
    assert "folder" in refusal.value.next_step


def test_real_ros_pair(real, tmp_path):
    found = read_any_rig(copied(real, ["ros_left.yaml", "ros_right.yaml"], tmp_path / "ros")).rig
    assert [c.name for c in found.cameras] == ["leftCamera", "rightCamera"]
    assert [c.model for c in found.cameras] == ["brown5", "brown5"]
    assert found.baselines_mm[0] == pytest.approx(1000 * 151.625 / 1716.63, rel=1e-9)
    with pytest.raises(UsageError, match="1 camera_info files"):
        read_any_rig(real / "ros_left.yaml")


def test_real_kalibr_chains(real):
    with pytest.raises(UsageError, match="holds 1 camera, a rig needs two"):
        read_any_rig(real / "kalibr_camchain_mono.yaml")
    with pytest.raises(UsageError, match="camera left: model pinhole-equidistant"):
        read_any_rig(real / "kalibr_camchain_stereo.yaml")


def test_real_kalibr_stereo_poses(real, tmp_path):
    text = (real / "kalibr_camchain_stereo.yaml").read_text()
    chain = yaml.safe_load(text)
    for camera in chain.values():
        camera.update(distortion_model="radtan", distortion_coeffs=[-0.1, 0.01, 0.001, 0.002])
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump(chain))
    found = read_any_rig(tmp_path / "chain.yaml").rig
    assert [c.name for c in found.cameras] == ["left", "right"]
    assert found.baselines_mm[0] == pytest.approx(112.526, abs=0.001)
    assert found.reference_from_camera[1].translation_mm[0] > 112


def test_real_bouguet_file(real):
    """‖T‖ = 99.808 mm, and the toolbox's own right camera stands to the right."""
    found = read_any_rig(real / "bouguet_Calib_Results_stereo.mat").rig
    assert [(c.name, c.width, c.height, c.model) for c in found.cameras] == [
        ("left", 640, 480, "brown5"),
        ("right", 640, 480, "brown5"),
    ]
    assert found.cameras[0].distortion[:2] == pytest.approx([-0.2883834, 0.0971355], abs=1e-7)
    assert found.baselines_mm[0] == pytest.approx(99.808, abs=5e-4)
    assert found.reference_from_camera[1].translation_mm[0] > 99


def test_real_matlab_struct(real):
    path = real / "matlab_stereoParams_opencv-struct.mat"
    with pytest.raises(UsageError, match="states no image size"):
        read_any_rig(path)
    found = read_any_rig(path, image_size=(1920, 1200)).rig
    assert [c.model for c in found.cameras] == ["radial2", "radial2"]
    expected = np.linalg.norm([-42.42988924, -0.39704688, 2.01662956])
    assert found.baselines_mm[0] == pytest.approx(expected, abs=1e-7)


def test_real_colmap_cameras_hold_no_poses(real):
    with pytest.raises(UsageError, match="1 cameras and the poses of 0 images") as refusal:
        read_any_rig(real / "colmap_cameras.txt", unit_mm=1.0)
    assert "images.txt" in refusal.value.next_step


def test_real_mrcal_models(real, tmp_path):
    names = [f"mrcal_cam{i}.opencv8.cameramodel" for i in (0, 1)]
    found = read_any_rig(copied(real, names, tmp_path / "models")).rig
    assert [c.model for c in found.cameras] == ["rational8", "rational8"]
    x = np.array([0.3, -0.2, 4.0])  # a point in mrcal's reference frame, m
    in_camera = []
    for rt in ([2e-2, -3e-1, -1e-2, 1.0, 2, -3.0], [2e-1, 1e-1, -1e-2, 2.0, 2, -2.5]):
        in_camera.append(cv2.Rodrigues(np.array(rt[:3]))[0] @ x + rt[3:])
    left_from_right = found.reference_from_camera[1]
    np.testing.assert_allclose(left_from_right @ (1000 * in_camera[1]), 1000 * in_camera[0])


def test_other_real_files_are_named_as_what_they_are_not(real):
    for name in ("calib.l2r.txt", "caliscope_camera_array.toml", "SOURCES.md"):
        with pytest.raises(UsageError, match="holds no calibration in a format that is known"):
            read_any_rig(real / name)
    with pytest.raises(UsageError, match="not two cameras"):
        read_any_rig(real / "opencv_filestorage_left_intrinsic.xml")


# --- Traps and damage ---


def test_mrcals_later_and_inverse_poses_are_understood(tmp_path):
    truth = rig()
    write_rig(truth, "mrcal", tmp_path / "models")
    path = tmp_path / "models" / "right.cameramodel"
    text = path.read_text()
    path.write_text(text.replace("'extrinsics'", "'rt_cam_ref'"))
    assert_same_poses(read_any_rig(tmp_path / "models").rig, truth)
    path.write_text(text.replace("'extrinsics'", "'rt_ref_cam'"))
    inverse = read_any_rig(tmp_path / "models").rig.reference_from_camera[1]
    expected = truth.reference_from_camera[1].inverse()
    np.testing.assert_allclose(inverse.translation_mm, expected.translation_mm, atol=1e-12)


def test_colmap_states_no_unit_and_moving_cameras_are_no_rig(tmp_path):
    write_rig(rig(), "colmap", tmp_path / "model")
    images = tmp_path / "model" / "images.txt"
    text = images.read_text().replace("# unit: mm\n", "")
    images.write_text(text)
    with pytest.raises(UsageError, match="states no unit of length"):
        read_any_rig(tmp_path / "model")
    found = read_any_rig(tmp_path / "model", unit_mm=10.0)
    assert found.rig.baselines_mm[0] == pytest.approx(10 * rig().baselines_mm[0])
    images.write_text(text.replace("\n\n", "\n512 100 3 4 5 6 7 8 9 10 11 12\n"))  # points seen
    again = read_any_rig(tmp_path / "model", unit_mm=10.0)
    assert [camera.name for camera in again.rig.cameras] == ["z-left", "right"]
    images.write_text(text + "3 1 0 0 0 1 2 3 1 z-left/other.png\n\n")
    with pytest.raises(UsageError, match="moving camera"):
        read_any_rig(tmp_path / "model", unit_mm=10.0)


def test_a_matlab_camera_with_skew_and_a_thin_prism_lens_are_refused(tmp_path):
    write_rig(rig(), "matlab", tmp_path / "rig.mat")
    struct = loadmat(tmp_path / "rig.mat", simplify_cells=True)["stereoParams"]
    struct["CameraParameters1"]["IntrinsicMatrix"][1, 0] = 0.5
    savemat(tmp_path / "skew.mat", {"s": struct})
    with pytest.raises(UsageError, match="not one of rectangular pixels"):
        read_any_rig(tmp_path / "skew.mat")
    write_rig(rig("rational8"), "opencv", tmp_path / "rig.json")
    text = (tmp_path / "rig.json").read_text()
    storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    D = np.append(storage.getNode("D1").mat(), [[1e-3, 0, 0, 0]], axis=1)
    out = cv2.FileStorage(str(tmp_path / "prism.yml"), cv2.FILE_STORAGE_WRITE)
    for key in ("M1", "M2", "D2", "R", "T"):
        out.write(key, storage.getNode(key).mat())
    out.write("D1", D)
    out.release()
    with pytest.raises(UsageError, match="thin prism"):
        read_any_rig(tmp_path / "prism.yml", unit_mm=1, image_size=(640, 480))


# a .mat file whose stated sizes are wrong makes scipy ask for memory without bounds
@pytest.mark.parametrize("file_format", [f for f in FORMATS if f != "matlab"])
def test_damaged_files_are_named_and_never_a_traceback(file_format, tmp_path):
    target = tmp_path / "rig"
    files = write_rig(rig(), file_format, target)
    rng = np.random.default_rng(0)
    for path in files:
        whole = path.read_bytes()
        for _ in range(40):
            data = bytearray(whole[: rng.integers(1, len(whole))] if rng.random() < 0.5 else whole)
            for place in rng.integers(0, len(data), 3):
                data[place] = rng.integers(32, 127)
            path.write_bytes(bytes(data))
            with suppress(UsageError):
                read_any_rig(target)
        path.write_bytes(whole)


def test_a_matlab_file_cut_off_is_named(tmp_path):
    (path,) = write_rig(rig(), "matlab", tmp_path / "rig.mat")
    whole = path.read_bytes()
    for length in (20, 200, len(whole) // 2, len(whole) - 9):
        path.write_bytes(whole[:length])
        with pytest.raises(UsageError, match=r"rig\.mat"):
            read_any_rig(path)


def test_two_calibrations_in_one_folder_are_refused(tmp_path):
    write_rig(rig(), "kalibr", tmp_path / "chain.yaml")
    write_rig(rig(), "opencv", tmp_path / "rig.yml")
    with pytest.raises(UsageError, match="holds kalibr and opencv calibration"):
        read_any_rig(tmp_path)


def test_an_imported_rig_states_its_files(tmp_path):
    write_rig(replace_names(rig()), "mrcal", tmp_path / "models")
    found = read_any_rig(tmp_path / "models")
    assert set(found.inputs) == {"a.cameramodel", "b.cameramodel"}


def replace_names(one: Rig) -> Rig:
    cameras = [replace(c, name=n) for c, n in zip(one.cameras, "ab", strict=True)]
    return Rig(cameras, one.reference_from_camera)
