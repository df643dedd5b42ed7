"""Every calibration format gives the rig that was written down; anything else gives one clear error."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig_samples import (
    EUROC_LEFT,
    EUROC_RIGHT,
    KALIBR,
    KITTI,
    LEFT,
    OPENCV,
    PLACE_MM,
    RIGHT,
    ROS_LEFT,
    ROS_RIGHT,
    SIZE_PX,
    TURN,
    ZED,
    brown_rig,
    fisheye_rig,
    turned_rig,
)

from machine.rotations import rotation_from_rotvec
from server.camera.rectification_reading import CalibrationText, parse_calibration, read_calibration
from server.camera.rectification_rig import CalibrationFileError, EyeCalibration, RigCalibration

SHARED = Path(__file__).parents[4] / "shared" / "data"


def parsed(*texts: str, size_px: tuple[int, int] = SIZE_PX) -> RigCalibration:
    return parse_calibration([CalibrationText(f"file{k}", text) for k, text in enumerate(texts)], size_px)


def assert_same(rig: RigCalibration, other: RigCalibration) -> None:
    assert (rig.width_px, rig.height_px) == (other.width_px, other.height_px)
    for eye, wanted in ((rig.left, other.left), (rig.right, other.right)):
        assert eye.lens_model == wanted.lens_model
        np.testing.assert_allclose(eye.matrix, wanted.matrix, rtol=1e-12)
        np.testing.assert_allclose(eye.distortion, wanted.distortion, atol=1e-15)
    np.testing.assert_allclose(rig.R_right_left, other.R_right_left, atol=1e-12)
    np.testing.assert_allclose(rig.t_right_left_m, other.t_right_left_m, atol=1e-12)


def test_zed_file() -> None:
    rig = parsed(ZED)
    assert (rig.left.fx_px, rig.right.cy_px) == (LEFT.fx_px, RIGHT.cy_px)
    assert rig.left.distortion == LEFT.distortion  # k1 k2 p1 p2 k3, whatever the order in the file
    np.testing.assert_allclose(rig.R_right_left, rotation_from_rotvec(TURN), atol=1e-12)
    np.testing.assert_allclose(rig.t_right_left_m, -1e-3 * PLACE_MM)
    assert parsed(ZED, size_px=(2208, 1242)).left.fx_px == 1403.76


def test_zed_file_spelt_otherwise() -> None:
    older = ZED.replace("TY=", "TY_HD=").replace("TZ=", "TZ_HD=").replace("Baseline", "BaseLine")
    assert_same(parsed(older), parsed(ZED))
    assert_same(parsed("\r\n".join(ZED.splitlines())), parsed(ZED))


def test_zed_and_opencv_files_of_one_rig_agree() -> None:
    assert_same(parsed(OPENCV), parsed(ZED))
    assert_same(parsed(OPENCV), brown_rig())


def test_opencv_in_metres_millimetres_and_two_files() -> None:
    metres = OPENCV.replace("[ -1.19978e+02, -2.6e-02, -1.59e-02 ]", "[ -0.119978, -2.6e-05, -1.59e-05 ]")
    assert_same(parsed(metres), parsed(OPENCV))
    at = OPENCV.index("R: !!")
    other_names = OPENCV[:at].replace("K1", "M1").replace("K2", "M2")
    assert_same(parsed(other_names, "%YAML:1.0\n---\n" + OPENCV[at:]), parsed(OPENCV))


@pytest.mark.parametrize("rig", [brown_rig(), turned_rig(), fisheye_rig()], ids=["brown", "rational", "fisheye"])
def test_round_trip_through_opencv_itself(rig: RigCalibration, tmp_path: Path) -> None:
    path = tmp_path / "stereo.yml"
    store = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    if rig.left.lens_model == "fisheye":
        store.write("model", "fisheye")
    for name, value in (
        ("cameraMatrix1", rig.left.matrix),
        ("distCoeffs1", np.array(rig.left.distortion)),
        ("cameraMatrix2", rig.right.matrix),
        ("distCoeffs2", np.array(rig.right.distortion)),
        ("R", rig.R_right_left),
        ("T", rig.t_right_left_m),
    ):
        store.write(name, value)
    store.release()
    assert_same(read_calibration([str(path)], SIZE_PX), rig)


def test_opencv_rectification_matrices_stand_for_r_and_t() -> None:
    rig = turned_rig()
    R1, R2, P1, P2 = cv2.stereoRectify(
        rig.left.matrix,
        rig.left.coefficients,
        rig.right.matrix,
        rig.right.coefficients,
        SIZE_PX,
        rig.R_right_left,
        rig.t_right_left_m.reshape(3, 1),
    )[:4]
    text = "".join(
        f"{name}: {np.asarray(value).ravel().tolist()}\n"
        for name, value in (
            ("K1", rig.left.matrix),
            ("K2", rig.right.matrix),
            ("D1", rig.left.coefficients),
            ("D2", rig.right.coefficients),
            ("R1", R1),
            ("R2", R2),
            ("P1", P1),
            ("P2", P2),
        )
    )
    found = parsed(text)
    np.testing.assert_allclose(found.R_right_left, rig.R_right_left, atol=1e-9)
    np.testing.assert_allclose(found.t_right_left_m, rig.t_right_left_m, atol=1e-9)


def test_ros_pair() -> None:
    rig = parsed(ROS_LEFT, ROS_RIGHT)
    assert (rig.width_px, rig.height_px) == (640, 480)
    assert (rig.left.fx_px, rig.right.fx_px) == (430.0, 432.0)
    assert rig.left.distortion == (-0.35, 0.15, 5e-4, -2e-4, 0.0)
    np.testing.assert_allclose(rig.t_right_left_m, [-0.1, 0.0, 0.0])  # P[0, 3] = -f b


def test_ros_other_lens_models() -> None:
    wide = [
        text.replace("plumb_bob", "equidistant").replace("[-0.35, 0.15, 5e-4, -2e-4, 0]", "[-0.01, 0.002, 0, 0]")
        for text in (ROS_LEFT, ROS_RIGHT)
    ]
    assert parsed(*[text.replace("cols: 5", "cols: 4") for text in wide]).left.lens_model == "fisheye"
    rational = [
        text.replace("plumb_bob", "rational_polynomial")
        .replace("cols: 5", "cols: 8")
        .replace("-2e-4, 0]", "-2e-4, 0, 0.1, 0, 0]")
        for text in (ROS_LEFT, ROS_RIGHT)
    ]
    assert parsed(*rational).right.distortion[5] == 0.1


def test_ros_pair_the_wrong_way_round() -> None:
    with pytest.raises(CalibrationFileError, match="left eye's file first"):
        parsed(ROS_RIGHT, ROS_LEFT)


def test_euroc_pair() -> None:
    rig = parsed(EUROC_LEFT, EUROC_RIGHT)
    assert (rig.width_px, rig.height_px) == (752, 480)
    np.testing.assert_allclose(rig.R_right_left, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rig.t_right_left_m, [-0.11, -0.001, 0.0], atol=1e-12)  # both poses in the body's axes
    assert rig.left.distortion == (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05)


def test_kalibr_camchain() -> None:
    rig = parsed(KALIBR)
    assert rig.left.lens_model == rig.right.lens_model == "fisheye"
    np.testing.assert_allclose(rig.t_right_left_m, [-0.11, 0.001, 0.002])


def test_kitti_text_labelled_and_bare() -> None:
    bare = "\n".join(line.partition(":")[2] for line in KITTI.splitlines()[:2])
    for text in (KITTI, bare):
        rig = parsed(text, size_px=(1226, 370))
        assert rig.baseline_m == pytest.approx(0.537151, abs=1e-6)
        assert rig.left.distortion == ()
        assert (rig.width_px, rig.height_px) == (1226, 370)


def test_kitti_clip_as_it_is() -> None:
    folder = SHARED / "stereo" / "kitti_clip"
    if not folder.is_dir():
        pytest.skip("no KITTI clip beside the checkout")
    assert read_calibration([str(folder)], (1226, 370)).baseline_m == pytest.approx(0.5372, abs=1e-4)


def test_folder_with_euroc_files(tmp_path: Path) -> None:
    for eye, text in (("cam0", EUROC_LEFT), ("cam1", EUROC_RIGHT)):
        (tmp_path / "mav0" / eye).mkdir(parents=True)
        (tmp_path / "mav0" / eye / "sensor.yaml").write_text(text)
    assert read_calibration([str(tmp_path)], SIZE_PX).width_px == 752
    with pytest.raises(CalibrationFileError, match="none of"):
        read_calibration([str(tmp_path / "mav0" / "cam0")], SIZE_PX)


@pytest.mark.parametrize(
    ("texts", "told"),
    [
        ((ZED.replace("fx=701.88", "fx=abc"),), r"file0: \[LEFT_CAM_HD\] fx = 'abc' is not a number"),
        ((ZED.replace("RX_HD=-0.0009\n", ""),), r"\[STEREO\] RX_HD is missing"),
        ((ZED.replace("fx=701.88", "fx=7.0188"),), "left eye: fx = 7.0188 px .* another resolution"),
        ((ZED.replace("_HD", "_VGA"),), "no calibration for images of 1280 x 720 .* 672 x 376"),
        ((ZED.replace("Baseline=119.978", "Baseline=-119.978"),), "exchange the eyes"),
        ((ZED.replace("Baseline=119.978", "Baseline=0.119978"),), "apart .* check the unit"),
        ((ZED.replace("CV_HD=0.0062", "CV_HD=2.0"),), "turned by 11.* deg"),
        ((OPENCV.replace("T: !!", "Q: !!"),), "R and T .* are missing"),
        ((OPENCV.replace("-1.19978e+02", "-4.6"),), "neither metres .* nor millimetres"),
        ((OPENCV.replace("-1.19978e+02", ".nan"),), "T: '.nan' is not a finite number"),
        ((OPENCV.replace("701.88, 0., 641", "701.88, 3., 641"),), "K1 has skew"),
        (
            (OPENCV.replace("rows: 3\n   cols: 3", "rows: 3\n   cols: 4", 1),),
            "K1 has 9 numbers, its rows x cols say 12",
        ),
        ((OPENCV.replace("-1.753e-01", "-1.753"),), "left eye: the lens model folds back"),
        ((EUROC_LEFT,), "one eye only"),
        ((EUROC_LEFT, EUROC_RIGHT.replace("752", "640")), "resolution .* differs"),
        ((EUROC_LEFT.replace("radial-tangential", "omni"), EUROC_RIGHT), "distortion_model 'omni'; known are"),
        ((ROS_LEFT, ROS_RIGHT.replace("plumb_bob", "plumb")), "distortion_model 'plumb' with 5 coefficients"),
        ((KITTI.replace("P1", "P3"),), r"has \[0, 3\] of the projections"),
        (("<?xml version='1.0'?><opencv_storage/>",), "save the calibration as YAML"),
        (("just text",), "no fields at its top level"),
        (("",), "no fields"),
        (("a: [1, 2",), "not a calibration file in YAML"),
        (("a: 1\n",), "no calibration of a stereo rig"),
    ],
)
def test_faults_are_named_with_file_and_remedy(texts: tuple[str, ...], told: str) -> None:
    with pytest.raises(CalibrationFileError, match=told) as caught:
        parsed(*texts)
    assert "file" in str(caught.value)


SAMPLES = [(ZED,), (OPENCV,), (EUROC_LEFT, EUROC_RIGHT), (ROS_LEFT, ROS_RIGHT), (KITTI,), (KALIBR,)]


@settings(max_examples=250, deadline=None, derandomize=True)
@given(st.data())
def test_damaged_files_give_a_sound_rig_or_one_error(data: st.DataObject) -> None:
    texts = list(data.draw(st.sampled_from(SAMPLES)))
    which = data.draw(st.integers(0, len(texts) - 1))
    text = texts[which]
    at = data.draw(st.integers(0, len(text)))
    length = data.draw(st.integers(0, 30))
    texts[which] = text[:at] + data.draw(st.text(max_size=12)) + text[at + length :]
    try:
        rig = parsed(*texts)
    except CalibrationFileError:
        return
    values = [*rig.left.matrix.ravel(), *rig.right.distortion, *rig.t_right_left_m]
    assert np.isfinite(values).all()
    np.testing.assert_allclose(rig.R_right_left @ rig.R_right_left.T, np.eye(3), atol=1e-9)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.lists(st.text(max_size=200), min_size=0, max_size=3))
def test_any_text_gives_one_error(texts: list[str]) -> None:
    with pytest.raises(CalibrationFileError):
        parsed(*texts)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(CalibrationFileError, match="give a calibration file that can be read"):
        read_calibration([str(tmp_path / "none.conf")], SIZE_PX)
    (tmp_path / "binary.conf").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(CalibrationFileError, match="not text"):
        read_calibration([str(tmp_path / "binary.conf")], SIZE_PX)


def test_eye_defaults_to_no_lens() -> None:
    assert EyeCalibration(500.0, 500.0, 320.0, 240.0).coefficients.tolist() == [0.0] * 4


def opencv_with(D="[-0.05, 0.01, 0.0, 0.0, 0.0]", more="", cx=320.0):
    K = f"{{rows: 3, cols: 3, data: [500, 0, {cx}, 0, 500, 239, 0, 0, 1]}}"
    n = D.count(",") + 1
    lens = f"{{rows: {n}, cols: 1, data: {D}}}"
    places = "R: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}\nT: [-0.12, 0, 0]\nimageSize: [640, 480]\n"
    return f"K1: {K}\nD1: {lens}\nK2: {K}\nD2: {lens}\n{places}{more}"


@pytest.mark.parametrize("field", ["xi1", "xi_1", "xi", "xi_left"])
def test_an_omnidirectional_calibration_is_not_read_as_a_plain_lens(field):
    with pytest.raises(CalibrationFileError, match=rf"{field} belongs to OpenCV's omnidirectional model.*calibrate"):
        parsed(opencv_with(more=f"{field}: 1.2\n"), size_px=(640, 480))


def test_four_coefficients_without_a_model_are_refused_and_with_one_are_read_as_it_says():
    D = "[-0.01, 0.02, -0.01, 0.003]"
    with pytest.raises(CalibrationFileError, match=r"does not state which; add the line `model: pinhole` or"):
        parsed(opencv_with(D), size_px=(640, 480))
    assert parsed(opencv_with(D, "model: fisheye\n"), size_px=(640, 480)).left.lens_model == "fisheye"
    assert parsed(opencv_with(D, "model: pinhole\n"), size_px=(640, 480)).left.lens_model == "brown"
    with pytest.raises(CalibrationFileError, match="'omni' is not read; known are"):
        parsed(opencv_with(D, "model: omni\n"), size_px=(640, 480))


def test_a_byte_order_mark_changes_nothing():
    assert parsed("\ufeff" + ZED, size_px=(1280, 720)).left.fx_px == parsed(ZED, size_px=(1280, 720)).left.fx_px


@pytest.mark.parametrize("cx", [968.0 / 2.0, 607.0, 200.0])
def test_a_principal_point_far_from_the_middle_must_be_confirmed(cx):
    text = CalibrationText("rig.yaml", opencv_with(cx=cx))
    with pytest.raises(CalibrationFileError, match=r"principal point .* from the middle .*off_centre = true"):
        parse_calibration([text], (640, 480))
    assert parse_calibration([text], (640, 480), off_centre=True).left.cx_px == cx


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ("binning_x: 2\nbinning_y: 2\n", r"binning_x = 2, but the matrices are of the picture without binning"),
        ("roi: {x_offset: 0, y_offset: 120, height: 240, width: 640}\n", r"roi y_offset = 120.*write zeros"),
    ],
)
def test_a_ros_calibration_of_a_part_of_the_picture_is_refused(more, told):
    with pytest.raises(CalibrationFileError, match=told):
        parsed(ROS_LEFT + more, ROS_RIGHT + more)
    whole = "binning_x: 0\nbinning_y: 1\nroi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}\n"
    assert_same(parsed(ROS_LEFT + whole, ROS_RIGHT + whole), parsed(ROS_LEFT, ROS_RIGHT))
