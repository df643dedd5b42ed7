"""The camera check on rendered pairs: a good rig is not named, every fault is found and named with its remedy."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.simulator.demo_scene import demo_tcp_pose, demo_world
from machine.camera import distort_rays, undistort_to_rays
from machine.description import Machine
from machine.rotations import Array, rotation_from_rotvec
from server.camera.check import CheckSample, CheckSampler, check_camera, progress_steps
from server.camera.check_findings import CheckFinding, Level, exit_code, worst_level
from server.camera.check_picture import check_exposure, check_sharpness, edge_blur_px
from server.camera.check_rig import check_rig, match_eyes
from server.camera.check_scale import Tape, check_focal
from server.camera.check_stream import StreamTimes, check_stream
from server.camera.contracts import StereoFrame
from server.camera.rectification import rectification_of
from server.camera.rectification_reading import read_calibration
from server.settings import read_machine
from server.vision.aruco_source import ArucoPoseSource
from server.vision.contracts import Image
from sim_plc.camera.renderer import RenderSetup, StereoRenderer

MACHINE = read_machine("hiab033")
SHARED = Path(__file__).parents[4] / "shared" / "data"
PERIOD_NS = 66_666_667
RIG_NAMES = ("eyes", "rows", "pitch", "roll", "focal_ratio", "lens", "scale")
Pair = tuple[Image, Image]


@cache
def rendered() -> Pair:
    camera, scene = demo_world(MACHINE, noise_grey=2.0, wall_relief_m=0.05)
    left, right = StereoRenderer(RenderSetup(camera, scene)).render_static(demo_tcp_pose(MACHINE, 0.6))
    return np.array(left), np.array(right)


def times(n: int = 60, late_ns: Array | None = None) -> StreamTimes:
    t_ns = np.arange(n, dtype=np.int64) * PERIOD_NS
    late = np.full(n, 40_000_000) if late_ns is None else late_ns
    return StreamTimes(t_ns - 3_000_000_000_000, t_ns + late.astype(np.int64), np.arange(n), np.ones(n, np.int64))


def _machine_with(baseline_m: float) -> Machine:
    return replace(MACHINE, camera=replace(MACHINE.camera, baseline_m=baseline_m))


def judged(pair: Pair, baseline_m: float = MACHINE.camera.baseline_m) -> dict[str, CheckFinding]:
    machine = _machine_with(baseline_m)
    gathered = CheckSample(times(), ((*pair, 0),))
    done: list[int] = []
    findings = check_camera(
        gathered, machine, ArucoPoseSource(machine).observe, np.random.default_rng(1), lambda: done.append(1)
    )
    assert len(done) == progress_steps(gathered)
    return {finding.name: finding for finding in findings}


def turned(image: Image, rotvec_deg: tuple[float, float, float]) -> Image:
    """What the eye sees once its points are turned: exact, through the lens model."""
    camera, R = MACHINE.camera, rotation_from_rotvec(np.deg2rad(np.array(rotvec_deg)))
    v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    rays = undistort_to_rays(camera, np.column_stack([u.ravel(), v.ravel()]).astype(float))
    points = np.column_stack([rays, np.ones(len(rays))]) @ R
    at = distort_rays(camera, points[:, :2] / points[:, 2:]) * np.array([camera.fx_px, camera.fy_px])
    at = (at + np.array([camera.cx_px, camera.cy_px])).astype(np.float32).reshape(*u.shape, 2)
    return np.asarray(cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_CUBIC), np.uint8)


def test_a_good_camera_passes_in_every_line() -> None:
    found = judged(rendered())
    assert {name: one.text for name, one in found.items() if one.level is not Level.OK} == {}
    assert "focal" in found
    assert set(RIG_NAMES) <= set(found)
    assert all(one.remedy == "" for one in found.values())
    assert exit_code(list(found.values())) == 0
    assert found["pitch"].figures["pitch_deg"] == pytest.approx(0.0, abs=0.02)
    assert found["roll"].figures["roll_deg"] == pytest.approx(0.0, abs=0.02)
    assert found["scale"].figures["scale_off_frac"] == pytest.approx(0.0, abs=0.005)


@pytest.mark.parametrize(("name", "rotvec_deg"), [("pitch", (0.3, 0.0, 0.0)), ("roll", (0.0, 0.0, -0.3))])
def test_a_bumped_rig_is_found_and_named(name: str, rotvec_deg: tuple[float, float, float]) -> None:
    left, right = rendered()
    found = judged((left, turned(right, rotvec_deg)))
    one = found[name]
    wrong = {key for key in RIG_NAMES if key in found and found[key].level is not Level.OK}
    assert one.level is Level.FAIL
    assert wrong == {name}
    value, sigma = one.figures[f"{name}_deg"], one.figures[f"{name}_deg_sigma"]
    assert value == pytest.approx(sum(rotvec_deg), abs=3.0 * sigma)
    assert sigma < 0.02
    assert f"bumped ({name})" in one.remedy
    assert exit_code(list(found.values())) == 1


def test_a_yaw_moves_the_disparity_and_is_found_by_the_scale() -> None:
    left, right = rendered()
    found = judged((left, turned(right, (0.0, 0.3, 0.0))))
    assert found["scale"].level is Level.FAIL
    assert "yaw" in found["scale"].remedy
    assert {key for key in RIG_NAMES if found[key].level is not Level.OK} == {"scale"}


def test_a_focal_length_that_differs_is_named() -> None:
    left, right = rendered()
    s = 1.01
    zoom = np.array([[s, 0.0, (1 - s) * MACHINE.camera.cx_px], [0.0, s, (1 - s) * MACHINE.camera.cy_px]])
    found = judged((left, np.asarray(cv2.warpAffine(right, zoom, (1280, 720), flags=cv2.INTER_CUBIC), np.uint8)))
    assert found["focal_ratio"].level is Level.FAIL
    assert found["focal_ratio"].figures["focal_ratio_pct"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("share", "level"), [(1.0, Level.OK), (1.5, Level.FAIL), (0.67, Level.FAIL)])
def test_a_focal_length_off_alike_in_both_eyes_is_found_by_the_markers(share: float, level: Level) -> None:
    """Nothing between the eyes shows it: rows, pitch and the ratio of their focal lengths stay as they are."""
    machine = with_focal(share)
    seen = ArucoPoseSource(machine).observe(*rendered(), 0)
    found = check_focal(machine, [seen])
    assert found.level is level, found
    assert abs(found.figures["focal_off_frac"] - (1.0 / share - 1.0)) < 0.2
    assert ("calibrate the camera" in found.remedy) == (level is Level.FAIL)


def test_one_taped_distance_measures_the_focal_length() -> None:
    machine = with_focal(1.04)
    true = ArucoPoseSource(MACHINE).observe(*rendered(), 0)
    tape = Tape(float(np.linalg.norm(true.tool.T_cam_object[:3, 3] - true.ooi.T_cam_object[:3, 3])))
    seen = ArucoPoseSource(machine).observe(*rendered(), 0)
    alone, taped = check_focal(machine, [seen]), check_focal(machine, [seen], tape)
    assert taped.figures["focal_sigma_frac"] < 0.5 * alone.figures["focal_sigma_frac"]
    assert taped.figures["focal_off_frac"] == pytest.approx(1.0 / 1.04 - 1.0, abs=0.012)
    assert taped.level is not Level.OK
    right = check_focal(MACHINE, [true], tape)
    assert right.level is Level.OK, right


@pytest.mark.parametrize("share", [0.96, 0.99, 1.01, 1.04])
def test_a_focal_length_off_by_a_percent_is_found_by_a_tape_and_else_called_unchecked(share: float) -> None:
    machine = with_focal(share)
    true = ArucoPoseSource(MACHINE).observe(*rendered(), 0)
    tape = Tape(float(np.linalg.norm(true.tool.T_cam_object[:3, 3] - true.ooi.T_cam_object[:3, 3])))
    seen = ArucoPoseSource(machine).observe(*rendered(), 0)
    alone, taped = check_focal(machine, [seen]), check_focal(machine, [seen], tape)
    assert alone.level is not Level.OK or "unchecked to 1 %" in alone.text, alone
    assert taped.level is (Level.WARN if abs(share - 1.0) < 0.02 else Level.FAIL), taped
    assert "unchecked" not in taped.text


def with_focal(share: float) -> Machine:
    camera = MACHINE.camera
    return replace(MACHINE, camera=replace(camera, fx_px=share * camera.fx_px, fy_px=share * camera.fy_px))


@pytest.mark.parametrize("share", [0.95, 1.05])
def test_a_wrong_baseline_is_found_by_the_printed_sides(share: float) -> None:
    found = judged(rendered(), share * MACHINE.camera.baseline_m)
    assert found["scale"].level is Level.FAIL
    assert found["scale"].figures["scale_off_frac"] == pytest.approx(share - 1.0, abs=0.006)
    assert "baseline" in found["scale"].remedy
    assert all(found[name].level is Level.OK for name in RIG_NAMES if name != "scale")
    assert found["tool"].level is Level.OK or "fix the findings" in found["tool"].remedy


def test_swapped_eyes_are_named_and_nothing_else_of_the_rig_is_claimed() -> None:
    left, right = rendered()
    found = judged((right, left))
    assert found["eyes"].level is Level.FAIL
    assert "swapped" in found["eyes"].text
    assert not set(found) & {"pitch", "roll", "yaw", "rows"}
    assert found["tool"].level is found["ooi"].level is Level.FAIL
    assert "fix the findings" in found["tool"].remedy


def test_a_blurred_eye_is_named() -> None:
    left, right = rendered()
    finding = check_sharpness([(left, np.asarray(cv2.GaussianBlur(right, (0, 0), 3.0), np.uint8))])
    assert finding.level is Level.FAIL
    assert "right lens" in finding.remedy


@pytest.mark.parametrize("sigma_px", [0.6, 1.0, 1.8, 2.5])
def test_blur_is_measured_in_pixels(sigma_px: float) -> None:
    sharp = np.kron(np.indices((9, 16)).sum(axis=0) % 2, np.ones((80, 80))) * 160.0 + 40.0
    noise = np.random.default_rng(1).normal(0.0, 2.0, sharp.shape)
    image = np.clip(cv2.GaussianBlur(sharp, (0, 0), sigma_px) + noise, 0, 255).astype(np.uint8)
    assert edge_blur_px(image) == pytest.approx(sigma_px, abs=max(0.2, 0.15 * sigma_px))


def test_no_edges_no_verdict_on_sharpness() -> None:
    flat = np.full((720, 1280), 90, np.uint8)
    finding = check_sharpness([(flat, flat)])
    assert finding.level is Level.WARN
    assert "inconclusive" in finding.text


@pytest.mark.parametrize(
    ("gain", "level", "remedy"),
    [(1.0, Level.OK, ""), (0.05, Level.FAIL, "more light"), (3.0, Level.FAIL, "shorter exposure")],
)
def test_exposure(gain: float, level: Level, remedy: str) -> None:
    pair = tuple(np.clip(image * gain, 0, 255).astype(np.uint8) for image in rendered())
    finding = check_exposure([(pair[0], pair[1])])
    assert finding.level is level
    assert remedy in finding.remedy


def test_one_eye_darker_than_the_other_is_named() -> None:
    left, right = rendered()
    finding = check_exposure([(left, (right * 0.6).astype(np.uint8))])
    assert finding.level is Level.WARN
    assert "one exposure" in finding.remedy


def corners_of(pair: Pair, marker_id: int) -> tuple[Array | None, Array | None]:
    view = next(seen for seen in ArucoPoseSource(MACHINE).observe(*pair, 0).marker_views if seen.marker_id == marker_id)
    return view.corners_left_px, view.corners_right_px


def test_a_half_covered_tool_marker_is_named() -> None:
    pair = rendered()
    tool_id = MACHINE.markers_on("tool")[0].marker_id
    covered = []
    for image, corners in zip(pair, corners_of(pair, tool_id), strict=True):
        assert corners is not None
        middle = corners.mean(axis=0)
        half = np.array([corners[0], 0.5 * (corners[0] + corners[1]), 0.5 * (corners[2] + corners[3]), corners[3]])
        grown = (middle + 1.3 * (half - middle)).astype(np.int32)
        covered.append(cv2.fillPoly(image.copy(), [grown], 60))
    found = judged((covered[0], covered[1]))
    assert found["tool"].level is Level.FAIL
    assert "cover" in found["tool"].text + found["tool"].remedy or "in both pictures" in found["tool"].remedy
    assert found["ooi"].level is not Level.FAIL
    assert all(found[name].level is Level.OK for name in RIG_NAMES)


def test_weak_light_from_one_side_says_where_to_light() -> None:
    pair = rendered()
    tool_id = MACHINE.markers_on("tool")[0].marker_id
    dim = []
    for image, corners in zip(pair, corners_of(pair, tool_id), strict=True):
        assert corners is not None
        low, high = corners[:, 0].min(), corners[:, 0].max()
        ramp = np.interp(np.arange(1280), [low, high], [0.28, 0.12])  # brighter at the left
        dim.append((image * ramp + 20.0).astype(np.uint8))
    view = judged((dim[0], dim[1]))["tool_view"]
    assert view.level is Level.WARN
    assert "light from the right" in view.remedy
    assert "of 255" in view.remedy


def test_small_markers_say_how_far_to_move() -> None:
    """Everything at a quarter of its size, as from four times as far."""
    small = []
    for image in rendered():
        canvas = np.full((720, 1280), 127, np.uint8)
        canvas[270:450, 480:800] = cv2.resize(image, (320, 180), interpolation=cv2.INTER_AREA)
        small.append(canvas)
    found = judged((small[0], small[1]))
    assert found["tool_view"].level is Level.WARN
    assert "closer" in found["tool_view"].remedy


def test_a_marker_beyond_the_border_of_one_eye_says_where_to_turn() -> None:
    """Both pictures shifted to the left, until the right eye has lost the tool's marker."""
    left, right = rendered()
    tool_id = MACHINE.markers_on("tool")[0].marker_id
    corners = corners_of((left, right), tool_id)[1]
    assert corners is not None
    shift = int(corners[:, 0].min()) + 30
    moved = [np.hstack([image[:, shift:], np.full((720, shift), 127, np.uint8)]) for image in (left, right)]
    found = judged((moved[0], moved[1]))
    text = found["tool_view"].remedy + found["tool"].remedy
    assert "to the left" in text
    assert "deg" in text


def test_too_little_texture_is_no_verdict_on_the_rig() -> None:
    flat = np.full((720, 1280), 90, np.uint8)
    found = judged((flat, flat))
    assert found["eyes"].level is Level.WARN
    assert "inconclusive" in found["eyes"].text
    assert not set(found) & {"pitch", "roll", "yaw"}


def test_pictures_of_another_size_end_the_check() -> None:
    small = np.zeros((376, 672), np.uint8)
    found = judged_size(small)
    assert found[-1].name == "size"
    assert "672 x 376" in found[-1].text
    assert worst_level(found) is Level.FAIL


def judged_size(image: Image) -> list[CheckFinding]:
    gathered = CheckSample(times(), ((image, image, 0),))
    return check_camera(gathered, MACHINE, ArucoPoseSource(MACHINE).observe, np.random.default_rng(0))


def named(findings: list[CheckFinding]) -> dict[str, CheckFinding]:
    return {one.name: one for one in findings}


def test_stream_rate_and_jitter() -> None:
    late = 40e6 + np.random.default_rng(2).uniform(0, 10e6, 60)
    found = named(check_stream(times(late_ns=late)))
    assert all(one.level is Level.OK for one in found.values())
    assert found["rate"].figures["rate_hz"] == pytest.approx(15.0, abs=0.1)
    assert found["latency"].figures["jitter_p95_ms"] == pytest.approx(1e-6 * (np.percentile(late, 95) - late.min()))
    assert "clock of its own" in found["latency"].text
    wild = 40e6 + np.random.default_rng(2).uniform(0, 400e6, 60)
    assert named(check_stream(times(late_ns=wild)))["latency"].level is Level.FAIL


def test_stream_latency_where_the_clock_is_ours() -> None:
    t_ns = np.arange(60, dtype=np.int64) * PERIOD_NS
    one = StreamTimes(t_ns, t_ns + 30_000_000, np.arange(60), np.ones(60, np.int64), own_clock=True, wanted_hz=20.0)
    found = named(check_stream(one))
    assert found["latency"].figures["latency_p50_ms"] == pytest.approx(30.0)
    assert found["rate"].level is Level.WARN  # 15 of 20
    stamped_here = StreamTimes(t_ns, t_ns, np.arange(60), np.ones(60, np.int64))
    assert "cannot be measured" in named(check_stream(stamped_here))["latency"].text


def test_stream_loss_by_sequence_and_by_stamp() -> None:
    whole = times(100)
    kept = np.delete(np.arange(100), [10, 20, 21, 50])
    for sequence, skipped, lost in (
        (whole.sequence_numbers[kept], 0, 4),
        (np.arange(96), 0, 4),
        (whole.sequence_numbers[kept], 4, 0),
    ):
        part = StreamTimes(
            whole.t_exposure_ns[kept], whole.t_receive_ns[kept], sequence, whole.connection_numbers[kept], skipped
        )
        finding = named(check_stream(part))["loss"]
        assert finding.figures["lost"] == lost
        assert finding.level is (Level.WARN if lost else Level.OK)


def test_stream_stamps_that_stand_or_run_back() -> None:
    for change in (0, -5_000_000_000):
        one = times()
        stamps = one.t_exposure_ns.copy()
        stamps[30] = stamps[29] + change
        found = named(check_stream(replace(one, t_exposure_ns=stamps)))
        assert found["stamps"].level is Level.FAIL


def test_stream_clock_drift_is_told() -> None:
    n = 300
    late = 40e6 + 1e-3 * np.arange(n) * PERIOD_NS
    found = named(check_stream(times(n, late)))
    assert found["latency"].figures["drift_ppm"] == pytest.approx(1000.0, rel=0.01)
    assert found["latency"].level is Level.WARN


def test_stored_pairs_are_not_judged_by_their_arrival() -> None:
    found = named(check_stream(replace(times(late_ns=np.linspace(0.0, 2e9, 60)), is_recorded=True)))
    assert set(found) == {"loss", "stamps"}
    assert all(one.level is Level.OK for one in found.values())


def test_a_real_rig_is_not_named() -> None:
    """KITTI's rectified pairs: nobody has bumped them."""
    folder = SHARED / "stereo" / "kitti_clip"
    if not folder.is_dir():
        pytest.skip("no KITTI clip beside the checkout")
    camera = rectification_of(read_calibration([str(folder)], (1226, 370)), 10.0).camera
    spots = []
    for name in sorted(path.name for path in (folder / "image_l").iterdir())[::17]:
        pair = [cv2.imread(str(folder / eye / name), cv2.IMREAD_GRAYSCALE) for eye in ("image_l", "image_r")]
        spots.append(match_eyes(np.asarray(pair[0], np.uint8), np.asarray(pair[1], np.uint8)))
    found = check_rig(camera, spots, np.random.default_rng(1))
    assert {one.name: one.text for one in found if one.level is not Level.OK} == {}
    assert {one.name for one in found} >= {"rows", "pitch", "roll", "focal_ratio", "lens"}
    swapped = check_rig(camera, [spot[:, [2, 3, 0, 1]] for spot in spots], np.random.default_rng(1))
    assert "swapped" in swapped[0].text


def test_no_stream_at_all() -> None:
    (finding,) = check_stream(times(2))
    assert finding.level is Level.FAIL
    assert "2 pairs came" in finding.text


def test_gathering_keeps_some_pairs_and_all_times() -> None:
    gathering = CheckSampler(pairs_max=3, duration_s=3.0)
    image = np.zeros((4, 4), np.uint8)
    for number in range(30):
        sequence = number + (5 if number > 20 else 0)
        gathering.add(StereoFrame(image, image, number, number * 100_000_000, sequence, 1))
    gathered = gathering.sample(2, own_clock=False, wanted_hz=None)
    assert len(gathered.image_pairs) == 3
    assert [stamp for _, _, stamp in gathered.image_pairs] == [0, 10, 20]
    assert gathering.rate_hz == pytest.approx(10.0)
    assert gathering.missing_count == 5
    assert gathered.stream_times.n_skipped == 2
    assert gathered.image_pairs[0][0] is not image  # a copy: sources may reuse their buffers
