"""The paper's set-up in a drawn world: as near to the OOI as its Table 2 says, beside it where the circle needs it."""

from dataclasses import replace

import numpy as np

from benchmarks.reproduce.paper_tables import tool_distances_mm
from benchmarks.reproduce.true_corners import TrueView
from machine.poses import inverse_pose, pose
from machine.rotations import Array
from sim_plc.world import World, rng_for

LINE_LATERAL_M = (0.26, 0.40)  # the OOI must lie outside of the circle of 0.2 m; the paper gives no number
CIRCLE_M = 0.2
_TRIES = 200


class NoSetUpError(RuntimeError):
    """No such set-up keeps the OOI in view in this world."""


def nearer(world: World, T_base_tcp: Array) -> World:
    """The world with its OOI moved along its normal: the tool starts as far from it as in one of the paper's runs.

    Preset worlds start 0.6 to 0.9 m away; the paper's Table 2 tells 0.30 to 0.61 m, since that method leaves depth.
    """
    rng = rng_for(world.seed, "paper set-up")
    T_ooi_tool = inverse_pose(world.scene.T_base_ooi) @ T_base_tcp @ world.scene.T_tcp_tool
    for _ in range(_TRIES):
        moved = T_ooi_tool.copy()
        moved[2, 3] = 1e-3 * rng.choice(tool_distances_mm())
        placed = _placed(world, T_base_tcp, moved)
        if _seen_at(placed, [T_base_tcp]):
            return placed
    raise NoSetUpError(f"seed {world.seed}: OOI not in view at any of the paper's distances")


def beside(world: World, T_base_tcp: Array) -> World:
    """The world with its OOI near as in Table 2 and beside the tool, so that it lies outside of the circle.

    Raises: NoSetUpError: the left eye would lose the OOI on the circle wherever it is put.
    """
    rng = rng_for(world.seed, "paper set-up, line equation")
    T_ooi_tool = inverse_pose(world.scene.T_base_ooi) @ T_base_tcp @ world.scene.T_tcp_tool
    around = CIRCLE_M * np.array([[np.cos(a), np.sin(a)] for a in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)])
    for _ in range(_TRIES):
        bearing, lateral = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*LINE_LATERAL_M)
        distance = 1e-3 * rng.choice(tool_distances_mm())
        moved = pose(T_ooi_tool[:3, :3], np.array([lateral * np.cos(bearing), lateral * np.sin(bearing), distance]))
        placed = _placed(world, T_base_tcp, moved)
        stations = [np.zeros(2), *around, -moved[:2, 3]]
        upright = [_shifted(placed, moved, station) for station in stations]
        if _seen_at(placed, [T_base_tcp, *upright]):
            return placed
    raise NoSetUpError(f"seed {world.seed}: OOI not in view all around the circle in {_TRIES} draws")


def _placed(world: World, T_base_tcp: Array, T_ooi_tool: Array) -> World:
    T_base_ooi = T_base_tcp @ world.scene.T_tcp_tool @ inverse_pose(T_ooi_tool)
    return replace(world, scene=replace(world.scene, T_base_ooi=T_base_ooi))


def _shifted(world: World, T_ooi_tool: Array, across: Array) -> Array:
    """True tool pose with the tool parallel to the OOI and moved across its normal."""
    position = T_ooi_tool[:3, 3] + np.array([*across, 0.0])
    return world.scene.T_base_ooi @ pose(np.eye(3), position) @ inverse_pose(world.scene.T_tcp_tool)


def _seen_at(world: World, Ts_base_tcp: list[Array]) -> bool:
    """Whether the left eye sees the tool and at least one OOI marker at every pose: one is enough for the paper."""
    view = TrueView(world)
    for T_base_tcp in Ts_base_tcp:
        seen = {one.on for one in view.corners(T_base_tcp) if one.left_px is not None}
        if seen != {"tool", "ooi"}:
            return False
    return True
