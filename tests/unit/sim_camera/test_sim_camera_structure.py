"""The crane's own structure in the picture: its share, that it moves with the camera, and that it hides no marker."""

from dataclasses import replace
from importlib.resources import files

import cv2
import numpy as np
import pytest

from benchmarks.simulator.demo_scene import demo_tcp_pose, demo_world
from machine.camera import project
from machine.description import Machine, parse_machine_toml
from machine.markers import marker_corners
from machine.poses import inverse_pose, pose, transform_points
from machine.rotations import Array, rotation_about
from sim_plc.camera.boards import marker_board
from sim_plc.camera.own_structure import OwnStructure, eye_views
from sim_plc.camera.renderer import RenderSetup, StereoRenderer
from sim_plc.camera.texture import Grey
from sim_plc.draw_scene import with_structure
from sim_plc.draw_world import STAND_OFF_M, draw_world
from sim_plc.plant.plant import Plant
from sim_plc.world import CameraTruth, SceneTruth, World

QUIET = 8.0 / 6.0  # side of a 4 x 4 marker with its white border against its own


@pytest.fixture(scope="module")
def machine() -> Machine:
    return parse_machine_toml(files("machine").joinpath("machines", "hiab033.toml").read_text())


def structure_of(camera: CameraTruth, scene: SceneTruth, machine: Machine) -> OwnStructure:
    tool = tuple(marker_board(machine.dictionary, marker, scene.T_tcp_tool) for marker in scene.tool_markers)
    return OwnStructure(scene.structure, scene.texture_seed, eye_views(camera, tool))


def painted(structure: OwnStructure, eye: int, T_base_tcp: Array) -> Grey:
    picture = np.zeros((720, 1280), np.uint8)
    structure.paint(picture, eye, T_base_tcp)
    return picture


@pytest.mark.parametrize("share", [0.1, 0.2, 0.3, 0.4])
def test_it_covers_the_wanted_share_of_the_picture(machine: Machine, share: float) -> None:
    structure = structure_of(*demo_world(machine, structure_frac=share, hoses_move=False), machine)
    covered = np.mean([mask.mean() for mask in structure.own_masks(np.eye(4))])
    assert abs(covered - share) < 0.01


def test_the_masks_are_exactly_what_hides_the_wall(machine: Machine) -> None:
    T_base_tcp = demo_tcp_pose(machine, 0.6)
    camera, scene = demo_world(machine, noise_grey=0.0, psf_px=0.0, structure_frac=0.25)
    bare = replace(scene, ooi_markers=())
    walls = (bare, replace(bare, texture_contrast_frac=0.5))
    renderers = [StereoRenderer(RenderSetup(camera, wall)) for wall in walls]
    pictures = [renderer.render_static(T_base_tcp) for renderer in renderers]
    masks = renderers[0].structure.own_masks(T_base_tcp)
    for mask, one, other in zip(masks, *pictures, strict=True):
        inside = cv2.erode(mask.astype(np.uint8), np.ones((3, 3))) > 0
        outside = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3))) == 0
        difference = np.abs(one.astype(int) - other)
        assert difference[inside].max() <= 1  # grey levels: of a rounded share where two edges meet
        assert np.mean(difference[outside] > 0) > 0.9


def test_beams_stand_still_and_hoses_move_with_the_wrist(machine: Machine) -> None:
    camera, scene = demo_world(machine, structure_frac=0.2)
    structure = structure_of(camera, scene, machine)
    # As far as a path of the calibration, without turning: the wrist bends by 4 deg.
    poses = demo_tcp_pose(machine, 0.6), demo_tcp_pose(machine, 0.6, (0.0, 0.15))
    for eye in (0, 1):
        one, other = (painted(structure, eye, T_base_tcp) for T_base_tcp in poses)
        moved = one != other
        assert 0.01 < moved.mean() < 0.10
        assert not moved[:, 400:860].any()  # between the beams: tool and housing
    resting = replace(scene.structure, hoses_move=False) if scene.structure else None
    still = structure_of(camera, replace(scene, structure=resting), machine)
    assert np.array_equal(painted(still, 0, poses[0]), painted(still, 0, poses[1]))


def test_hoses_sag_with_gravity(machine: Machine) -> None:
    structure = structure_of(*demo_world(machine, structure_frac=0.2), machine)
    level = demo_tcp_pose(machine, 0.6)
    rolled = level @ pose(rotation_about("z", np.deg2rad(10.0)), np.zeros(3))
    assert np.mean(painted(structure, 0, level) != painted(structure, 0, rolled)) > 0.01


def test_plain_paint_has_no_texture(machine: Machine) -> None:
    spread = []
    for contrast_frac in (0.0, 1.0):
        world = demo_world(machine, structure_frac=0.4, structure_contrast_frac=contrast_frac)
        picture = painted(structure_of(*world, machine), 0, demo_tcp_pose(machine, 0.6))
        spread.append(float(picture[200:300, 290:325].std()))  # of the left beam's end
    assert spread[0] == 0.0
    assert spread[1] > 10.0


def hidden_markers(world: World, T_base_tcp: Array) -> list[int]:
    """Markers, white border included, of which beams, housing or hoses hide a part in an eye."""
    scene = world.scene
    views = eye_views(world.camera, ())
    masks = OwnStructure(scene.structure, scene.texture_seed, views).own_masks(T_base_tcp)
    hidden = []
    for view, mask in zip(views, masks, strict=True):
        T_cam_tcp = inverse_pose(view.T_tcp_cam)
        T_cam_ooi = T_cam_tcp @ inverse_pose(T_base_tcp) @ scene.T_base_ooi
        seen = [(T_cam_ooi, marker) for marker in scene.ooi_markers]
        seen += [(T_cam_tcp @ scene.T_tcp_tool, marker) for marker in scene.tool_markers]
        for T_cam_object, marker in seen:
            corners = transform_points(T_cam_object @ marker.T_on_marker, marker_corners(QUIET * marker.side_m))
            area = np.zeros(mask.shape, np.uint8)
            cv2.fillConvexPoly(area, np.rint(project(view.rays.camera, corners)).astype(np.int32), 1)
            if np.any(mask & (area > 0)):
                hidden.append(marker.marker_id)
    return hidden


@pytest.mark.parametrize("preset", ["realistic", "paper"])
@pytest.mark.parametrize("seed", range(1, 5))
def test_no_marker_is_hidden_at_the_start_and_at_the_goal(machine: Machine, preset: str, seed: int) -> None:
    world = draw_world(machine, preset, seed)
    assert world.scene.structure is not None
    T_base_start = Plant(world.plant, world.q_start_rad).T_base_tcp()
    T_ooi_goal = pose(np.eye(3), np.array([0.0, 0.0, STAND_OFF_M]))
    T_base_goal = world.scene.T_base_ooi @ T_ooi_goal @ inverse_pose(world.scene.T_tcp_tool)
    assert hidden_markers(world, T_base_start) == []
    assert hidden_markers(world, T_base_goal) == []


def test_only_the_ideal_crane_is_invisible_unless_requested(machine: Machine) -> None:
    world = draw_world(machine, "ideal", 1)
    assert world.scene.structure is None
    asked = with_structure(world, 0.3, None).scene.structure
    assert asked is not None
    assert (asked.cover_frac, asked.contrast_frac) == (0.3, 1.0)
    assert with_structure(world, None, None).scene.structure is None


def test_a_share_on_request_changes_nothing_else(machine: Machine) -> None:
    world = draw_world(machine, "realistic", 1)
    before, after = world.scene.structure, with_structure(world, 0.4, None).scene.structure
    assert before is not None
    assert after is not None
    assert (after.cover_frac, after.contrast_frac) == (0.4, before.contrast_frac)
    assert np.array_equal(after.elbow_base_m, before.elbow_base_m)
    assert with_structure(world, 0.0, None).scene.structure is None
