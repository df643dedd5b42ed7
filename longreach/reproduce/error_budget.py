"""Which part of the truth costs how much: the same machines with one source of error taken away at a time."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from machine.poses import inverse_pose
from machine.rotations import Array
from sim_plc.plant.plant import Plant
from sim_plc.world import World, rng_for

Change = Callable[[World], World]
_RIGID_NM_RAD = 1e13


def without_backlash(world: World) -> World:
    """No play in slew and wrists."""
    kinematics = replace(world.plant.kinematics, backlash_rad=np.zeros(6))
    return replace(world, plant=replace(world.plant, kinematics=kinematics))


def without_model_error(world: World) -> World:
    """True lengths and joint zeros are the nominal ones."""
    joints = world.nominal.joints
    kinematics = replace(
        world.plant.kinematics,
        a_m=np.array([joint.a_m for joint in joints]),
        d_m=np.array([joint.d_m for joint in joints]),
        theta_zero_rad=np.array([joint.theta_offset_rad for joint in joints]),
    )
    return replace(world, plant=replace(world.plant, kinematics=kinematics))


def without_sag(world: World) -> World:
    """Springs that do not bend."""
    flex = replace(world.plant.flex, stiffness_nm_rad=np.full(5, _RIGID_NM_RAD))
    return replace(world, plant=replace(world.plant, flex=flex))


def without_dead_band(world: World) -> World:
    """Valves without overlap and hysteresis: encoders reach their references."""
    valve = replace(world.plant.valve, dead_band_frac=np.zeros(6), hysteresis_frac=np.zeros(6))
    return replace(world, plant=replace(world.plant, valve=valve))


def without_mount_error(world: World) -> World:
    """The camera sits as the machine file says."""
    return replace(world, camera=replace(world.camera, T_tcp_cam_left=world.nominal.T_tcp_cam_left))


def without_tool_marker_error(world: World) -> World:
    """The tool marker sits as the machine file says."""
    return replace(world, scene=replace(world.scene, T_tcp_tool=world.nominal.T_tcp_tool))


def without_vision_error(world: World) -> World:
    """Lens, rig, prints and layout as the machine file says."""
    nominal = world.nominal
    camera = replace(world.camera, left=nominal.camera, right=nominal.camera)
    scene = replace(world.scene, ooi_markers=nominal.markers_on("ooi"), tool_markers=nominal.markers_on("tool"))
    return replace(world, camera=camera, scene=scene)


SOURCES: dict[str, Change] = {
    "as drawn": lambda world: world,
    "no lengths and zeros error": without_model_error,
    "no sag": without_sag,
    "no backlash": without_backlash,
    "no dead band": without_dead_band,
    "camera mount nominal": without_mount_error,
    "tool marker mount nominal": without_tool_marker_error,
    "lens, rig, print, layout exact": without_vision_error,
}


def changed(world: World, change: Change) -> World:
    """The world after a change, its OOI put where the tool starts from the same place before it."""
    T_before = Plant(world.plant, world.q_start_rad).T_base_tcp()
    T_ooi_tool = inverse_pose(world.scene.T_base_ooi) @ T_before @ world.scene.T_tcp_tool
    after = change(world)
    T_base_tcp: Array = Plant(after.plant, after.q_start_rad).T_base_tcp()
    T_base_ooi = T_base_tcp @ after.scene.T_tcp_tool @ inverse_pose(T_ooi_tool)
    return replace(after, scene=replace(after.scene, T_base_ooi=T_base_ooi))


def bootstrap_mean(values: Array, seed: int = 0, draws: int = 2000) -> tuple[float, float, float]:
    """Mean of values (n,) with its 95 % interval by resampling."""
    rng = rng_for(seed, "bootstrap")
    means = rng.choice(values, (draws, len(values))).mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(values.mean()), float(low), float(high)
