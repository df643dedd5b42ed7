"""A drawn machine with the effects of its machine file, such as those of a diagnosis."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from machine.description import Machine
from machine.effects.entries import EffectEntry
from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from sim_plc.presets import PresetError
from sim_plc.world import World

SPRING_INDEX_BY_JOINT = {2: 0, 3: 2}  # joints (1-based) with a spring about their own axis, and its number
Change = Callable[[World, EffectEntry], World]


def not_simulated(machine: Machine) -> tuple[str, ...]:
    """Effects of a machine file that this plant cannot have, once each."""
    beyond = (effect.name for effect in machine.effects if effect.name not in CHANGES or _bends_elsewhere(effect))
    return tuple(dict.fromkeys(beyond))


def _bends_elsewhere(entry: EffectEntry) -> bool:
    return entry.name == "gravity_sag" and entry.joint not in SPRING_INDEX_BY_JOINT


def with_effects(world: World) -> World:
    """The world with every `[[effect]]` of its machine file.

    Raises: PresetError: an effect that this plant cannot have; names those that it can.
    """
    for entry in world.nominal.effects:
        change = CHANGES.get(entry.name)
        if change is None:
            raise PresetError(
                f"effect {entry.name} cannot be simulated by the plant; it knows {', '.join(sorted(CHANGES))}"
            )
        world = change(world, entry)
    return world


def _change_joint_parameter(
    world: World, part: str, name: str, entry: EffectEntry, change: Callable[[float], float]
) -> World:
    """One number of one joint changed: `part` and `name` of the plant's truth."""
    group = getattr(world.plant, part)
    values = np.array(getattr(group, name), dtype=float)
    values[(entry.joint or 1) - 1] = change(float(values[(entry.joint or 1) - 1]))
    return replace(world, plant=replace(world.plant, **{part: replace(group, **{name: values})}))


def _oil_only(world: World, entry: EffectEntry) -> None:
    if world.plant.rigid:
        raise PresetError(f"effect {entry.name} needs a plant with oil and springs; preset '{world.preset}' has none")


def _apply_deadband(world: World, entry: EffectEntry) -> World:
    _oil_only(world, entry)
    half = entry.value("half_width_frac")
    if entry.option == "lost":  # this plant's valves pass their full flow nonetheless
        left = 1.0 - float(world.plant.valve.dead_band_frac[(entry.joint or 1) - 1])
        world = _flow_times(world, entry, 1.0 - half / left)
    return _change_joint_parameter(world, "valve", "dead_band_frac", entry, lambda x: x + half)


def _apply_hysteresis(world: World, entry: EffectEntry) -> World:
    _oil_only(world, entry)
    return _change_joint_parameter(
        world, "valve", "hysteresis_frac", entry, lambda x: x + entry.value("half_width_frac")
    )


def _flow_gain(world: World, entry: EffectEntry) -> World:
    return _flow_times(world, entry, 1.0 + entry.value("gain_frac"))


def _flow_times(world: World, entry: EffectEntry, factor: float) -> World:
    gains = np.array(world.plant.velocity_gain_rad_s, dtype=float)
    gains[(entry.joint or 1) - 1] *= factor
    world = replace(world, plant=replace(world.plant, velocity_gain_rad_s=gains))
    return _change_joint_parameter(world, "valve", "flow_gain_m3_s_sqrt_pa", entry, lambda x: x * factor)


def _apply_backlash(world: World, entry: EffectEntry) -> World:
    return _change_joint_parameter(world, "kinematics", "backlash_rad", entry, lambda x: x + entry.value("width_rad"))


def _apply_joint_zero_bias(world: World, entry: EffectEntry) -> World:
    return _change_joint_parameter(world, "kinematics", "theta_zero_rad", entry, lambda x: x - entry.value("bias_rad"))


def _apply_length_error(world: World, entry: EffectEntry) -> World:
    return _change_joint_parameter(
        world, "kinematics", f"{entry.option}_m", entry, lambda x: x + entry.value("error_m")
    )


def _apply_gravity_sag(world: World, entry: EffectEntry) -> World:
    _oil_only(world, entry)
    if entry.joint not in SPRING_INDEX_BY_JOINT:
        raise PresetError(f"effect gravity_sag, joint {entry.joint}: the plant bends at joints 2 and 3 only")
    stiffness = np.array(world.plant.flex.stiffness_nm_rad, dtype=float)
    k = SPRING_INDEX_BY_JOINT[entry.joint]
    stiffness[k] = 1.0 / (1.0 / stiffness[k] + entry.value("compliance_rad_nm"))
    return replace(world, plant=replace(world.plant, flex=replace(world.plant.flex, stiffness_nm_rad=stiffness)))


def _apply_lens_error(world: World, entry: EffectEntry) -> World:
    eyes = {}
    for name in ("left", "right"):
        eye = getattr(world.camera, name)
        if entry.name == "focal_length_error":
            scale = 1.0 + entry.value("scale_frac")
            eyes[name] = replace(eye, fx_px=eye.fx_px * scale, fy_px=eye.fy_px * scale)
        elif entry.name == "principal_point_error":
            x, y = entry.value("shift_px") * np.array(entry.direction)
            eyes[name] = replace(eye, cx_px=eye.cx_px + float(x), cy_px=eye.cy_px + float(y))
        else:
            eyes[name] = replace(eye, distortion=(eye.distortion[0] + entry.value("k1"), *eye.distortion[1:]))
    return replace(world, camera=replace(world.camera, **eyes))


def _apply_hand_eye_error(world: World, entry: EffectEntry) -> World:
    T, along = world.camera.T_tcp_cam_left, np.array(entry.direction)
    if entry.name == "hand_eye_rotation":
        turned = pose(T[:3, :3] @ rotation_from_rotvec(entry.value("angle_rad") * along), T[:3, 3])
    else:
        turned = pose(T[:3, :3], T[:3, 3] + entry.value("distance_m") * along)
    return replace(world, camera=replace(world.camera, T_tcp_cam_left=turned))


def _apply_marker_size_error(world: World, entry: EffectEntry) -> World:
    scale = 1.0 + entry.value("scale_frac")
    scene = world.scene
    bigger = {
        name: tuple(replace(marker, side_m=marker.side_m * scale) for marker in getattr(scene, name))
        for name in ("ooi_markers", "tool_markers")
    }
    return replace(world, scene=replace(scene, **bigger))


def _tool_marker(world: World, entry: EffectEntry) -> World:
    along = np.array(entry.direction)
    if entry.name == "tool_marker_rotation":
        moved = pose(rotation_from_rotvec(entry.value("angle_rad") * along), np.zeros(3))
    else:
        moved = pose(np.eye(3), entry.value("distance_m") * along)
    markers = tuple(replace(marker, T_on_marker=moved @ marker.T_on_marker) for marker in world.scene.tool_markers)
    return replace(world, scene=replace(world.scene, tool_markers=markers))


def _apply_camera_time_error(world: World, entry: EffectEntry) -> World:
    camera = world.camera
    if entry.name == "clock_offset":
        return replace(world, camera=replace(camera, clock_offset_s=camera.clock_offset_s + entry.value("offset_s")))
    if entry.name == "camera_latency":
        return replace(world, camera=replace(camera, latency_s=camera.latency_s + entry.value("latency_s")))
    readout_s = entry.value("readout_s")
    stamp_s = camera.clock_offset_s - 0.5 * entry.value("stamp_row") * readout_s  # this camera stamps the middle row
    return replace(world, camera=replace(camera, readout_s=camera.readout_s + readout_s, clock_offset_s=stamp_s))


CHANGES: dict[str, Change] = {
    "valve_deadband": _apply_deadband,
    "valve_hysteresis": _apply_hysteresis,
    "flow_gain_error": _flow_gain,
    "backlash": _apply_backlash,
    "encoder_bias": _apply_joint_zero_bias,
    "link_length_error": _apply_length_error,
    "gravity_sag": _apply_gravity_sag,
    "focal_length_error": _apply_lens_error,
    "principal_point_error": _apply_lens_error,
    "lens_distortion": _apply_lens_error,
    "hand_eye_rotation": _apply_hand_eye_error,
    "hand_eye_translation": _apply_hand_eye_error,
    "tool_marker_rotation": _tool_marker,
    "tool_marker_translation": _tool_marker,
    "marker_size_error": _apply_marker_size_error,
    "clock_offset": _apply_camera_time_error,
    "camera_latency": _apply_camera_time_error,
    "rolling_shutter": _apply_camera_time_error,
}
