"""What is truly off on a drawn machine, as far as the catalogue has a word for it; the rest as plain numbers."""

from typing import Any

import numpy as np

from machine.poses import inverse_pose
from machine.rotations import rotvec_from_rotation
from sim_plc.world import World

SPRING_OF = {2: 0, 3: 2}  # joints (1-based) with a spring about their own axis
#: What the fine plant has in terms of its own: no number of the catalogue can be held against it.
UNSIZED = (
    *(("joint_friction", joint) for joint in range(1, 7)),
    *(("stiction", joint) for joint in range(1, 7)),
    *(("oil_compliance", joint) for joint in range(1, 7)),
    *(("link_flexibility", joint) for joint in range(1, 4)),
    *((name, joint) for name in ("valve_asymmetry", "load_droop", "flow_gain_error") for joint in (2, 3)),  # cylinders
)


def true_effects(world: World) -> list[dict[str, Any]]:
    """One line an effect: name, joint, sizes in the catalogue's units; `value`: of the size, None where the plant has
    it in other terms. What each costs at the tool is not worked out.
    """
    nominal, plant, camera = world.nominal, world.plant, world.camera
    arm, out = plant.kinematics, []
    for number, joint in enumerate(nominal.joints, start=1):
        k = number - 1
        zero = float(joint.theta_offset_rad - arm.theta_zero_rad[k])  # the encoder reads that much too much
        out.append(_line("encoder_bias", number, bias_rad=zero))
        for of, value, true in (("a", joint.a_m, arm.a_m[k]), ("d", joint.d_m, arm.d_m[k])):
            if true != value:
                out.append(_line("link_length_error", number, error_m=float(true - value), of=of))
        if number in SPRING_OF:
            stiffness = float(plant.flex.stiffness_nm_rad[SPRING_OF[number]])
            out.append(_line("gravity_sag", number, compliance_rad_nm=1.0 / stiffness))
        if arm.backlash_rad[k] > 0.0:
            out.append(_line("backlash", number, width_rad=float(arm.backlash_rad[k])))
        out.append(_line("valve_deadband", number, half_width_frac=float(plant.valve.dead_band_frac[k])))
        out.append(_line("valve_hysteresis", number, half_width_frac=float(plant.valve.hysteresis_frac[k])))
    turn = rotvec_from_rotation(nominal.T_tcp_cam_left[:3, :3].T @ camera.T_tcp_cam_left[:3, :3])
    shift = camera.T_tcp_cam_left[:3, 3] - nominal.T_tcp_cam_left[:3, 3]
    out.append(_line("hand_eye_rotation", None, angle_rad=float(np.linalg.norm(turn)), vector=turn.tolist()))
    out.append(_line("hand_eye_translation", None, distance_m=float(np.linalg.norm(shift)), vector=shift.tolist()))
    T_tool = inverse_pose(nominal.T_tcp_tool) @ world.scene.T_tcp_tool
    turn, shift = rotvec_from_rotation(T_tool[:3, :3]), T_tool[:3, 3]
    out.append(_line("tool_marker_rotation", None, angle_rad=float(np.linalg.norm(turn)), vector=turn.tolist()))
    if shift.any():
        out.append(
            _line("tool_marker_translation", None, distance_m=float(np.linalg.norm(shift)), vector=shift.tolist())
        )
    left, own = camera.left, nominal.camera
    out.append(_line("focal_length_error", None, scale_frac=left.fx_px / own.fx_px - 1.0))
    centre = [left.cx_px - own.cx_px, left.cy_px - own.cy_px]
    out.append(_line("principal_point_error", None, shift_px=float(np.linalg.norm(centre)), vector=centre))
    out.append(_line("lens_distortion", None, k1=left.distortion[0] - own.distortion[0]))
    turned = abs(camera.right.cx_px - left.cx_px) / left.fx_px  # a shifted image is nearly a turned eye
    out.append(_line("stereo_misalignment", None, angle_rad=turned))
    out.append(_line("camera_latency", None, latency_s=camera.latency_s))
    out.append(_line("rolling_shutter", None, readout_s=camera.readout_s))
    return [*out, *(_line(name, joint) for name, joint in UNSIZED)]


def _line(name: str, joint: int | None, **values: Any) -> dict[str, Any]:
    value = next((number for number in values.values() if isinstance(number, float)), None)
    known = {"catalogue": True, "tip_mm": None, "seen_mm": None}
    return {"name": name, "joint": joint, "parameters": values, "value": value, **known}
