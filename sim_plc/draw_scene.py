"""Draw the machine's placement and the wall with its markers."""

from dataclasses import replace

import numpy as np

from machine.chain import chain_of
from machine.description import Machine, Marker
from machine.kinematics import link_poses
from machine.poses import inverse_pose, pose
from machine.rotations import Array, rotation_about, rotation_from_rotvec
from sim_plc.camera.round_marks import draw_marks
from sim_plc.camera.wall import wall_relief
from sim_plc.draw_camera import random_axis
from sim_plc.presets import spread_of
from sim_plc.world import SceneTruth, StructureTruth, World, rng_for

WALL_OFFSET_M = 0.06  # the wall's mean plane behind the OOI's origin
_ELBOW_LINK = 2  # the lift boom ends where the tilt boom begins
NOMINAL_MARKER_SIDE_MM = 150.0  # to which the printing error refers


def draw_posture(machine: Machine, preset: str, rng: np.random.Generator) -> Array | None:
    """Encoder readings (6,) [rad] at the start, or None where the drawn reach and wrist angle do not fit together.

    Model:   theta5 and the tool's pitch fix the tilt boom's elevation lift + tilt; the reach then fixes lift.
    """

    def draw(name: str) -> float:
        return float(spread_of(preset, name).draw(rng)[0])

    slew, reach, theta5, pitch = draw("slew"), draw("reach"), draw("theta5"), draw("tool_pitch")
    theta4, theta6 = draw("theta4"), draw("theta6")
    j = machine.joints
    elevation = np.deg2rad(theta5 - pitch)
    forearm = j[3].d_m * np.cos(elevation) - j[2].a_m * np.sin(elevation)
    cosine = (reach - j[0].a_m - forearm - j[5].d_m * np.cos(np.deg2rad(pitch))) / j[1].a_m
    if abs(cosine) > 1.0:
        return None
    lift = np.arccos(cosine)
    return np.array([
        np.deg2rad(slew), lift, elevation - lift, np.deg2rad(theta4), np.deg2rad(theta5), np.deg2rad(theta6)
    ])  # fmt: skip


def draw_start(preset: str, rng: np.random.Generator) -> Array:
    """T_ooi_tool at the start: in front of the OOI, a little to the side, a little turned."""
    distance = spread_of(preset, "start_distance").draw(rng)[0]
    lateral = spread_of(preset, "start_lateral").draw(rng)[0]
    bearing = rng.uniform(0.0, 2.0 * np.pi)
    x, y, z = np.deg2rad(spread_of(preset, "start_rotation").draw(rng, 3))
    rotation = rotation_about("z", z) @ rotation_about("y", y) @ rotation_about("x", x)
    return pose(rotation, np.array([lateral * np.cos(bearing), lateral * np.sin(bearing), distance]))


def draw_tool(machine: Machine, preset: str, rng: np.random.Generator) -> Array:
    """True T_tcp_tool: the tool marker turned against the tcp."""
    angle = np.deg2rad(spread_of(preset, "tool_marker_angle").draw(rng)[0])
    turned = pose(rotation_from_rotvec(random_axis(rng) * angle), np.zeros(3))
    return machine.T_tcp_tool @ turned


def draw_structure(machine: Machine, preset: str, seed: int, q_start: Array) -> StructureTruth | None:
    """What of itself the crane shows its camera; None: only the tool."""

    def draw(name: str) -> float:
        return float(spread_of(preset, name).draw(rng_for(seed, name))[0])

    shown = draw("structure_cover"), draw("structure_contrast"), draw("hoses_move") == 1.0
    return structure_truth(machine, q_start, *shown)


def structure_truth(
    machine: Machine, q_start: Array, cover_frac: float, contrast_frac: float, hoses_move: bool
) -> StructureTruth | None:
    """Structure over a share of the picture, its boom as the nominal machine holds it at the start; None for 0."""
    if cover_frac == 0.0:
        return None
    elbow_base_m = link_poses(chain_of(machine), q_start)[_ELBOW_LINK, :3, 3]
    gravity = machine.gravity_base_m_s2
    return StructureTruth(cover_frac, contrast_frac, hoses_move, elbow_base_m, gravity / np.linalg.norm(gravity))


def with_structure(world: World, cover_frac: float | None, contrast_frac: float | None) -> World:
    """The world with another share of the picture covered, or another texture; None: as the preset drew it.

    What the preset did not draw (`ideal`) is textured, and its hoses move.
    """
    drawn = world.scene.structure
    structure = structure_truth(
        world.nominal,
        world.q_start_rad,
        (drawn.cover_frac if drawn else 0.0) if cover_frac is None else cover_frac,
        (drawn.contrast_frac if drawn else 1.0) if contrast_frac is None else contrast_frac,
        drawn.hoses_move if drawn else True,
    )
    return replace(world, scene=replace(world.scene, structure=structure))


def with_bare_rock(world: World) -> World:
    """The same wall without the object's markers and boards: the OOI's frame stays as the truth's reference."""
    return replace(world, scene=replace(world.scene, ooi_markers=(), ooi_boards=()))


def with_round_marks(world: World, count: int) -> World:
    """The same wall with so many boreholes and painted rings, drawn by the wall's own seed; 0: none."""
    scene = world.scene
    relief = wall_relief(scene.texture_seed, scene.wall_relief_m, scene.wall_offset_m)
    return replace(world, scene=replace(scene, round_marks=draw_marks(scene.texture_seed, count, relief)))


def draw_scene(
    machine: Machine,
    preset: str,
    seed: int,
    T_base_tcp: Array,
    T_tcp_tool: Array,
    T_ooi_tool: Array,
    structure: StructureTruth | None,
) -> SceneTruth:
    """The wall and its markers so that the tool, truly at T_base_tcp, stands at T_ooi_tool."""

    def draw(name: str) -> float:
        return float(spread_of(preset, name).draw(rng_for(seed, name))[0])

    return SceneTruth(
        T_base_ooi=T_base_tcp @ T_tcp_tool @ inverse_pose(T_ooi_tool),
        ooi_markers=tuple(_draw_true_marker(m, preset, seed, laid_out=True) for m in machine.markers_on("ooi")),
        tool_markers=tuple(_draw_true_marker(m, preset, seed, laid_out=False) for m in machine.markers_on("tool")),
        T_tcp_tool=T_tcp_tool,
        wall_offset_m=WALL_OFFSET_M,
        wall_relief_m=draw("wall_relief"),
        texture_contrast_frac=draw("texture_contrast"),
        texture_seed=int(rng_for(seed, "texture_seed").integers(1, 2**31)),
        ooi_boards=tuple(board for board in machine.boards_on("ooi") if board.kind == "charuco"),
        structure=structure,
    )


def _draw_true_marker(marker: Marker, preset: str, seed: int, laid_out: bool) -> Marker:
    """A marker as it truly is: its printed side, and for the OOI its place against the measured layout."""
    key = f"_{marker.marker_id}"
    side_mm = spread_of(preset, "marker_size").draw(rng_for(seed, "marker_size" + key))[0]
    side_m = marker.side_m * (1.0 + side_mm / NOMINAL_MARKER_SIDE_MM)
    if not laid_out:
        return replace(marker, side_m=side_m)
    shift = 1e-3 * spread_of(preset, "layout_position").draw(rng_for(seed, "layout_position" + key), 3)
    turn = np.deg2rad(spread_of(preset, "layout_rotation").draw(rng_for(seed, "layout_rotation" + key), 3))
    nominal = marker.T_on_marker
    T_on_marker = pose(nominal[:3, :3] @ rotation_from_rotvec(turn), nominal[:3, 3] + shift)
    T_on_marker.setflags(write=False)
    return replace(marker, side_m=side_m, T_on_marker=T_on_marker)
