"""`longreach hand-eye`: both set-ups against the truth, the public arms, and poses that cannot tell."""

import json
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from longreach.cli import app
from server.camera.target_pictures import charuco_board
from server.commissioning.hand_eye_poses import poses_of_pictures, read_lens
from server.errors import ServerError

SHARED = next(
    (p / "shared" / "data" / "hand_eye" for p in Path(__file__).resolve().parents if (p / "shared").is_dir()), None
)
N = 40


def pose(rotvec: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rotvec).as_matrix()
    T[:3, 3] = xyz
    return T


def write(path: Path, Ts: list[np.ndarray]) -> Path:
    rows = ["name,x,y,z,qx,qy,qz,qw"]
    for k, T in enumerate(Ts):
        numbers = [*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_quat()]
        rows.append(",".join([f"image{k}", *(repr(float(value)) for value in numbers)]))
    path.write_text("\n".join(rows), encoding="utf-8")
    return path


def made(seed: int, eye_to_hand: bool, spread: float = 0.6) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Hand in base, target in camera with noise, and the true camera in its parent."""
    rng = np.random.default_rng(seed)
    X, Y = pose(rng.normal(size=3) * 0.5, rng.normal(size=3) * 0.1), pose(rng.normal(size=3), [1.0, 0.2, 0.1])
    hands = [pose(spread * rng.normal(size=3), [0.5, 0.0, 0.4] + 0.15 * rng.normal(size=3)) for _ in range(N)]
    noise = [pose(2e-3 * rng.normal(size=3), 5e-4 * rng.normal(size=3)) for _ in range(N)]
    if eye_to_hand:  # X: hand from target, Y: base from camera
        return hands, [np.linalg.inv(Y) @ hand @ X @ one for hand, one in zip(hands, noise, strict=True)], Y
    return hands, [np.linalg.inv(hand @ X) @ Y @ one for hand, one in zip(hands, noise, strict=True)], X


@pytest.mark.parametrize("eye_to_hand", [False, True])
def test_the_mount_is_found_within_its_covariance_and_written_for_others(tmp_path: Path, eye_to_hand: bool) -> None:
    chi2 = []
    for seed in range(12):
        hands, seen, truth = made(seed, eye_to_hand)
        out = tmp_path / f"out{seed}"
        call = ["hand-eye", "--hand", str(write(tmp_path / "hand.csv", hands))]
        call += ["--camera", str(write(tmp_path / "camera.csv", seen)), "--out", str(out)]
        done = CliRunner().invoke(
            app, [*call, "--json", str(out) + ".json", *(["--eye-to-hand"] if eye_to_hand else [])]
        )
        assert done.exit_code == 0, done.output
        answer = json.loads(Path(str(out) + ".json").read_text(encoding="utf-8"))
        T, C = np.array(answer["T_parent_cam"]), np.array(answer["covariance"])
        turn = Rotation.from_matrix(T[:3, :3] @ truth[:3, :3].T).as_rotvec()
        error = np.r_[turn, T[:3, 3] - truth[:3, 3]]
        chi2.append(float(error @ np.linalg.solve(C, error)))
    assert np.mean(chi2) < 12.0  # 6 expected
    assert (tmp_path / "out0" / "machine.toml").exists() is not eye_to_hand
    kept = yaml.safe_load((out / "easy_handeye2.calib").read_text(encoding="utf-8"))
    assert kept["parameters"]["calibration_type"] == ("eye_on_base" if eye_to_hand else "eye_in_hand")
    quat = [kept["transform"]["rotation"][axis] for axis in "xyzw"]
    assert np.abs(Rotation.from_quat(quat).as_matrix() - T[:3, :3]).max() < 1e-9
    joint = ElementTree.fromstring(f"<robot>{(out / 'joint.urdf').read_text(encoding='utf-8')}</robot>").find("joint")
    origin = joint.find("origin") if joint is not None else None
    assert origin is not None
    assert (
        np.abs(Rotation.from_euler("xyz", np.fromstring(origin.get("rpy", ""), sep=" ")).as_matrix() - T[:3, :3]).max()
        < 1e-9
    )
    stamped = yaml.safe_load((out / "tf.yaml").read_text(encoding="utf-8"))["transforms"][0]
    assert stamped["header"]["frame_id"] == ("base_link" if eye_to_hand else "tool0")


def test_poses_that_cannot_tell_are_refused_with_a_reason(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    hands, seen, _ = made(1, False)
    X = pose(np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.1, 0.05]))
    one_axis = [pose(np.array([0.0, 0.0, angle]), rng.normal(size=3) * 0.1) for angle in rng.uniform(-1, 1, N)]
    seen_so = [np.linalg.inv(hand @ X) for hand in one_axis]
    cases = (
        (one_axis, seen_so, "about one axis"),
        (hands[:5], seen[:5], "at least 12"),
        (hands, seen[::-1], "do not fit"),
    )
    for hand_poses, target_poses, why in cases:
        call = ["hand-eye", "--hand", str(write(tmp_path / "hand.csv", hand_poses))]
        done = CliRunner().invoke(app, [*call, "--camera", str(write(tmp_path / "camera.csv", target_poses))])
        assert done.exit_code == 1, done.output
        assert why in " ".join(done.output.split())


def test_an_outlier_and_poses_that_add_nothing_are_named(tmp_path: Path) -> None:
    hands, seen, _ = made(2, False)
    seen[7] = seen[7] @ pose(np.array([0.0, 0.1, 0.0]), np.array([0.0, 0.05, 0.0]))
    hands[9], seen[9] = hands[8], seen[8]
    call = ["hand-eye", "--hand", str(write(tmp_path / "hand.csv", hands)), "--json", str(tmp_path / "a.json")]
    done = CliRunner().invoke(app, [*call, "--camera", str(write(tmp_path / "camera.csv", seen))])
    assert done.exit_code == 0, done.output
    answer = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert "image7" in answer["outliers"]
    assert len(answer["outliers"]) <= 3
    assert answer["alike"] == [["image8", "image9"]]


@pytest.mark.skipif(SHARED is None or not SHARED.is_dir(), reason="the public arms are not beside the checkout")
@pytest.mark.parametrize(("name", "degrees", "mm"), [("real", 0.6, 3.5), ("sim", 0.2, 1.5)])
def test_public_arms(tmp_path: Path, name: str, degrees: float, mm: float) -> None:
    assert SHARED is not None
    with zipfile.ZipFile(SHARED / f"robot_arm_w_color_camera_{name}.zip") as pack:
        pack.extractall(tmp_path)
    files = {path.name: path for path in tmp_path.rglob("*.csv")}
    hand = next(path for file, path in files.items() if "hand" in file or "hinge" in file)
    camera = next(path for path in files.values() if path != hand)
    call = ["hand-eye", "--hand", str(hand), "--camera", str(camera), "--camera-in-target"]
    done = CliRunner().invoke(app, [*call, "--json", str(tmp_path / "a.json")])
    assert done.exit_code == 0, done.output
    answer = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert answer["residual_rotation_deg"]["median"] < degrees
    assert answer["residual_mm"]["median"] < mm


def test_pictures_of_a_board_and_poses_of_the_hand_are_enough(tmp_path: Path) -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    drawn = cv2.aruco.CharucoBoard((11, 8), 0.03, 0.022, dictionary).generateImage((1320, 960), marginSize=0)
    K = np.array([[700.0, 0.0, 640.0], [0.0, 700.0, 360.0], [0.0, 0.0, 1.0]])
    X, Y = pose(np.array([0.1, -0.2, 1.0]), np.array([0.03, -0.02, 0.08])), pose(np.zeros(3), np.array([0.5, 0.0, 0.0]))
    rng, hands = np.random.default_rng(4), []
    (tmp_path / "pictures").mkdir()
    for k in range(16):
        T_cam_board = pose(0.5 * rng.uniform(-1.0, 1.0, 3), rng.uniform([-0.25, -0.18, 0.4], [0.0, -0.05, 0.6]))
        hands.append(Y @ np.linalg.inv(X @ T_cam_board))
        scale = np.diag([0.03 / 120, 0.03 / 120, 1.0]) @ np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
        H = K @ np.column_stack([T_cam_board[:3, :2], T_cam_board[:3, 3]]) @ scale
        picture = cv2.warpPerspective(drawn, H, (1280, 720), flags=cv2.INTER_AREA, borderValue=160)
        cv2.imwrite(str(tmp_path / "pictures" / f"image{k}.png"), cv2.GaussianBlur(picture, (3, 3), 0.7))
    lens = tmp_path / "lens.yaml"
    zeros = {"rows": 1, "cols": 5, "data": [0.0] * 5}
    matrix = {"rows": 3, "cols": 3, "data": K.ravel().tolist()}
    lens.write_text(yaml.safe_dump({"camera_matrix": matrix, "distortion_coefficients": zeros}), encoding="utf-8")
    call = ["hand-eye", "--hand", str(write(tmp_path / "hand.csv", hands)), "--images", str(tmp_path / "pictures")]
    call += ["--lens", str(lens), "--squares", "11x8", "--square-mm", "30", "--marker-mm", "22"]
    done = CliRunner().invoke(app, [*call, "--json", str(tmp_path / "a.json")])
    assert done.exit_code == 0, done.output
    T = np.array(json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))["T_parent_cam"])
    assert np.linalg.norm(T[:3, 3] - X[:3, 3]) < 1e-3
    assert np.linalg.norm(Rotation.from_matrix(T[:3, :3] @ X[:3, :3].T).as_rotvec()) < 2e-3


LENS = {
    "camera_matrix": {"rows": 3, "cols": 3, "data": [500.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0]},
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [-0.01, 0.02, 0.0, 0.0, 0.0]},
    "image_width": 640,
    "image_height": 480,
}
FOUR = {"distortion_coefficients": {"rows": 1, "cols": 4, "data": [-0.01, 0.02, -0.01, 0.003]}}


@pytest.mark.parametrize(
    ("more", "why"),
    [
        (FOUR | {"distortion_model": "equidistant"}, "fisheye model"),
        (FOUR | {"fisheye_model": 1}, "fisheye model"),
        (FOUR, "does not state which"),
        ({"xi": 1.2}, "omnidirectional"),
        ({"xi": 1.2, "distortion_model": "plumb_bob"}, "omnidirectional"),
        ({"distortion_model": "division"}, "known are"),
        ({"binning_x": 2}, "binning"),
        ({"binning_y": 2, "distortion_model": "plumb_bob"}, "binning"),
        ({"roi": {"x_offset": 0, "y_offset": 120, "width": 640, "height": 240}}, "region of interest"),
        ({"image_width": 1280, "image_height": 960}, "give the calibration of this picture size"),
        ({"camera_matrix": [500, 0, 660, 0, 500, 240, 0, 0, 1], "image_width": 640}, "outside the image"),
    ],
)
def test_a_lens_that_is_not_of_these_pictures_is_refused(tmp_path: Path, more: dict[str, object], why: str) -> None:
    file, board = tmp_path / "lens.yaml", charuco_board("11x8", 30.0, 22.0, "DICT_5X5_100", False)
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((480, 640), np.uint8))
    file.write_text(yaml.safe_dump(LENS | more), encoding="utf-8")
    with pytest.raises(ServerError, match=why):
        poses_of_pictures(tmp_path, board, read_lens(file))


def test_a_plain_lens_of_these_pictures_is_read(tmp_path: Path) -> None:
    file = tmp_path / "lens.yaml"
    file.write_text(yaml.safe_dump(LENS | FOUR | {"distortion_model": "plumb_bob", "binning_x": 1}), encoding="utf-8")
    lens = read_lens(file)
    assert (lens.size_px, lens.eye_calibration.distortion) == ((640, 480), (-0.01, 0.02, -0.01, 0.003))
