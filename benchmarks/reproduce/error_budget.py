"""Which part of the truth costs how much: the same machines with one source of error taken away at a time."""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np

from machine.poses import inverse_pose
from machine.rotations import Array
from machine.targets import Marker
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


def focal_off(share: float) -> Change:
    """Both eyes' true focal length longer than drawn by a share: nothing between the eyes shows it."""

    def change(world: World) -> World:
        left, right = (
            replace(eye, fx_px=eye.fx_px * (1.0 + share), fy_px=eye.fy_px * (1.0 + share))
            for eye in (world.camera.left, world.camera.right)
        )
        return replace(world, camera=replace(world.camera, left=left, right=right))

    return change


def printed_off(share: float, *objects: Literal["tool", "ooi"]) -> Change:
    """All markers of these objects printed larger than drawn by a share, where they hang."""

    def change(world: World) -> World:
        def grown(markers: tuple[Marker, ...], on: Literal["tool", "ooi"]) -> tuple[Marker, ...]:
            by = 1.0 + share if on in objects else 1.0
            return tuple(replace(marker, side_m=by * marker.side_m) for marker in markers)

        scene = world.scene
        tool, ooi = grown(scene.tool_markers, "tool"), grown(scene.ooi_markers, "ooi")
        return replace(world, scene=replace(scene, tool_markers=tool, ooi_markers=ooi))

    return change


FOCAL_PCT, PRINT_PCT = (0.5, 1.0, -1.0, 2.0, -2.0, 4.0, -4.0), (0.2, 0.5, 1.0, -1.0)
#: What all pairs have in common and no pair shows by itself (`longreach bench unchecked`).
SEEING: dict[str, Change] = {
    **{f"focal {pct:+g} %": focal_off(1e-2 * pct) for pct in FOCAL_PCT},
    **{f"tool print {pct:+g} %": printed_off(1e-2 * pct, "tool") for pct in PRINT_PCT},
    **{f"OOI print {pct:+g} %": printed_off(1e-2 * pct, "ooi") for pct in PRINT_PCT},
    **{f"all prints {pct:+g} %": printed_off(1e-2 * pct, "tool", "ooi") for pct in PRINT_PCT},
}

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
