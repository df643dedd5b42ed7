"""What the camera, odometry and tracker measure: against the nominal camera, and each effect's own signature."""

import numpy as np
import pytest
from effects_cases import hiab

from machine.camera import project_stereo
from machine.effects.entries import make_entry, pack_effects
from machine.effects.layout import ParameterSets, neutral_sets, slots_of
from machine.effects.registry import effect_named, effects_of
from machine.effects.seen import (
    camera_mount,
    points_on_links,
    seen_corners,
    tool_place,
    true_times,
)
from machine.errors import MachineError
from machine.markers import marker_corners
from machine.poses import pose
from machine.rotations import rotation_about, rotation_from_rotvec

MACHINE = hiab()
MARKERS = MACHINE.markers_on("ooi")
NONE = neutral_sets(6)
RNG = np.random.default_rng(5)


def object_pose(distance_m: float, turn: float = 0.1) -> np.ndarray:
    """The OOI in front of the left eye, facing it."""
    return pose(
        rotation_about("x", np.pi) @ rotation_from_rotvec(np.array([turn, 0.05, 0.02])),
        np.array([0.05, 0.02, distance_m]),
    )


POSES = np.array([object_pose(d, t) for d, t in zip(np.linspace(0.6, 1.6, 9), np.linspace(-0.2, 0.2, 9), strict=True)])
LATER = np.array([pose(np.eye(3), np.array([2e-4, 3e-4, 0.0])) @ T for T in POSES])


def test_what_the_lens_model_folds_back_into_the_picture_is_not_seen() -> None:
    far_off = pose(POSES[0][:3, :3], np.array([-3.0, -0.5, 1.29]))  # 67 deg off the axis
    assert 0.0 < project_stereo(MACHINE.camera, far_off[None, :3, 3])[0][0, 0] < MACHINE.camera.width_px
    seen = seen_corners(NONE, MACHINE.camera, MARKERS, np.array([far_off, POSES[0]]))
    assert np.isnan(seen.left_px[0]).all()
    assert np.isfinite(seen.left_px[1]).all()


def packed(name: str, **parameters: object) -> ParameterSets:
    effect = effect_named(name)
    assert effect is not None
    return pack_effects([make_entry(effect, None, parameters)], 6)


def corners(sets: ParameterSets) -> np.ndarray:
    seen = seen_corners(sets, MACHINE.camera, MARKERS, POSES, LATER, 1e-3)
    return np.stack([seen.left_px, seen.right_px])


def test_without_effects_it_is_the_nominal_camera() -> None:
    for k, T in enumerate(POSES):
        for m, marker in enumerate(MARKERS):
            at = marker_corners(marker.side_m) @ marker.T_on_marker[:3, :3].T + marker.T_on_marker[:3, 3]
            left, right = project_stereo(MACHINE.camera, at @ T[:3, :3].T + T[:3, 3])
            assert corners(NONE)[0, k, m] == pytest.approx(left, abs=1e-9)
            assert corners(NONE)[1, k, m] == pytest.approx(right, abs=1e-9)


IMAGE = [one for one in effects_of("camera") if one.name not in ("camera_latency", "odometry_scale")]


@pytest.mark.parametrize("effect", IMAGE, ids=lambda one: one.name)
def test_every_image_parameter_is_felt_finite_and_neutral_is_exact(effect) -> None:
    def measured(sets: ParameterSets) -> np.ndarray:
        mounted, tool = camera_mount(sets, MACHINE.T_tcp_cam_left), tool_place(sets, MACHINE.T_tcp_tool)
        return np.concatenate([corners(sets).ravel(), mounted.ravel(), tool.ravel()])

    sizes = [slot for slot in slots_of(effect.name, None) if slot.parameter == effect.size.name]
    for slot in sizes:
        for value, same in (
            (slot.neutral_value, True),
            (slot.start_value, False),
            (slot.lower_bound, None),
            (slot.typical_max, None),
        ):
            changed = neutral_sets(6)
            changed.put(slot, value)
            assert np.isfinite(measured(changed)).all()
            assert same is None or np.array_equal(measured(changed), measured(NONE)) == same, (slot, value)


def centred(pixels: np.ndarray) -> np.ndarray:
    return pixels - np.array([MACHINE.camera.cx_px, MACHINE.camera.cy_px])


def test_lens_effects_have_their_shapes() -> None:
    nominal = corners(NONE)
    assert centred(corners(packed("focal_length_error", scale_frac=0.02))) == pytest.approx(
        1.02 * centred(nominal), abs=1e-9
    )
    shifted = corners(packed("principal_point_error", shift_px=3.0, direction=[0.0, 1.0]))
    assert shifted - nominal == pytest.approx(np.broadcast_to([0.0, 3.0], nominal.shape), abs=1e-9)
    growth = np.linalg.norm(centred(corners(packed("lens_distortion", k1=0.01))) - centred(nominal), axis=-1)
    radius = np.linalg.norm(centred(nominal), axis=-1)
    assert growth == pytest.approx(
        528.0 * 0.01 * (radius / 528.0) ** 3, rel=0.15, abs=0.01
    )  # nominal lens bends the radius


def test_a_larger_print_is_a_nearer_marker() -> None:
    marker = MARKERS[0]
    flat = np.array(
        [
            pose(rotation_about("x", np.pi), np.array([0.0, 0.0, d])) @ np.linalg.inv(marker.T_on_marker)
            for d in (1.0, 1.1)
        ]
    )
    wide = seen_corners(packed("marker_size_error", scale_frac=0.1), MACHINE.camera, (marker,), flat).left_px[1, 0]
    near = seen_corners(NONE, MACHINE.camera, (marker,), flat).left_px[0, 0]
    assert wide == pytest.approx(near, abs=1e-6)


def test_a_vergence_error_shifts_disparity_and_a_pitch_error_rows() -> None:
    nominal = corners(NONE)
    yaw = corners(packed("stereo_misalignment", angle_rad=0.002, axis=[0.0, 1.0, 0.0])) - nominal
    pitch = corners(packed("stereo_misalignment", angle_rad=0.002, axis=[1.0, 0.0, 0.0])) - nominal
    assert np.array_equal(yaw[0], np.zeros_like(yaw[0]))
    assert np.abs(yaw[1, ..., 0]).min() > 0.9
    assert np.abs(yaw[1, ..., 1]).max() < 0.4
    assert np.abs(pitch[1, ..., 1]).min() > 0.9


def test_the_shutter_shears_by_speed_and_row() -> None:
    nominal = corners(NONE)
    sheared = corners(packed("rolling_shutter", readout_s=0.01)) - nominal
    later = seen_corners(NONE, MACHINE.camera, MARKERS, LATER)
    rate = (np.stack([later.left_px, later.right_px]) - nominal) / 1e-3
    row = nominal[..., 1:] / (MACHINE.camera.height_px - 1.0) - 0.5
    assert sheared == pytest.approx(rate * row * 0.01, abs=1e-9)
    of_first_row = corners(packed("rolling_shutter", readout_s=0.01, stamp_row=1)) - nominal
    assert of_first_row == pytest.approx(rate * (row + 0.5) * 0.01, abs=1e-9)
    still = seen_corners(packed("rolling_shutter", readout_s=0.01), MACHINE.camera, MARKERS, POSES)
    assert np.array_equal(still.left_px, nominal[0])


def test_the_mount_turns_in_its_own_axes_and_moves_in_the_tcps() -> None:
    T = MACHINE.T_tcp_cam_left
    turned = camera_mount(packed("hand_eye_rotation", angle_rad=0.05, axis=[0.0, 0.0, 1.0]), T)
    assert T[:3, :3].T @ turned[:3, :3] == pytest.approx(rotation_about("z", 0.05), abs=1e-12)
    moved = camera_mount(packed("hand_eye_translation", distance_m=0.01, direction=[0.0, 3.0, 0.0]), T)
    assert moved[:3, 3] - T[:3, 3] == pytest.approx([0.0, 0.01, 0.0], abs=1e-12)
    assert np.array_equal(camera_mount(NONE, T), T)


def test_clocks_map_stamps_to_true_times() -> None:
    t = np.linspace(100.0, 160.0, 7)
    assert np.array_equal(true_times(NONE, t, 100.0), t)
    for name, parameters, wanted in (
        ("clock_offset", {"offset_s": 0.1}, t - 0.1),
        ("camera_latency", {"latency_s": 0.05}, t - 0.05),
        ("clock_drift", {"rate_ppm": 400.0}, 100.0 + (t - 100.0) / (1.0 + 4e-4)),
        ("clock_drift", {"rate_ppm": 400.0, "zero_s": -20.0}, 80.0 + (t - 80.0) / (1.0 + 4e-4)),
    ):
        assert true_times(packed(name, **parameters), t, 100.0) == pytest.approx(wanted, abs=1e-10)


def test_points_follow_their_links() -> None:
    links = np.tile(np.eye(4), (2, 3, 1, 1))
    links[1, 2, :3, 3] = [1.0, 2.0, 3.0]
    points = points_on_links(links, np.array([0, 2]), RNG.normal(size=(2, 3)) * 0.0 + 0.1)
    assert points[1, 1] == pytest.approx([1.1, 2.1, 3.1])
    assert points[1, 0] == pytest.approx([0.1, 0.1, 0.1])


def test_bad_poses_are_refused() -> None:
    with pytest.raises(MachineError, match="give"):
        seen_corners(NONE, MACHINE.camera, MARKERS, np.eye(4))
    with pytest.raises(MachineError, match="above 0 s"):
        seen_corners(packed("rolling_shutter", readout_s=0.01), MACHINE.camera, MARKERS, POSES, LATER, 0.0)
