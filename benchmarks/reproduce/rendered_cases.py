"""The same cases end to end: rendered images, real UDP, the ordinary server; truth joined afterwards by PLC time."""

import csv
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.positioning.end_to_end import REST_NS, resting
from benchmarks.reproduce.cases import Case
from benchmarks.reproduce.paper_setup import NoSetUpError
from benchmarks.reproduce.placed_sim import PRESET, PlacedStack, SetUp, placed
from benchmarks.reproduce.true_error import StepErrors, Three, true_errors
from longreach.fleet_client import Finished, JobClient, JobRefusedError
from longreach.processes import StackPorts
from machine.description import Machine
from machine.poses import inverse_pose, pose
from machine.rotations import Array, rotation_from_quat_wxyz
from server.jobs.plans.line import LineVariant
from sim_plc.draw_world import draw_world
from sim_plc.presets import PresetError
from sim_plc.world import World

READY_S = 300.0
STAND_OFF_M = 0.1
TRUTH = ("x_ooi_tool_m", "y_ooi_tool_m", "z_ooi_tool_m", "qw_ooi_tool", "qx_ooi_tool", "qy_ooi_tool", "qz_ooi_tool")


def rendered_line_case(machine: Machine, seed: int, variant: LineVariant, folder: Path) -> Case:
    """Table 2, rendered: a job of kind `line`."""
    return _case(machine, seed, "beside", f"line, {variant}", {"kind": "line", "variant": variant}, folder)


def rendered_matching_case(machine: Machine, seed: int, folder: Path) -> Case:
    """Table 4, rendered: a job of kind `position` by the paper's method; it ends when x and y are inside 5 mm."""
    return _case(machine, seed, "nearer", "matching, paper", {"kind": "position", "method": "paper"}, folder)


def _case(machine: Machine, seed: int, set_up: SetUp, kind: str, body: dict[str, Any], folder: Path) -> Case:
    try:
        world = placed(draw_world(machine, PRESET, seed), set_up)
    except (NoSetUpError, PresetError) as error:
        return Case(seed, kind, "no set-up", str(error))
    own = folder / f"{kind.replace(', ', '-').replace(' ', '-')}-{seed}"
    try:
        finished = _run(seed, set_up, body, own)
    except JobRefusedError as error:
        return Case(seed, kind, "refused", str(error))
    if finished.state != "done" or finished.result is None:
        return Case(seed, kind, "refused", finished.reason, notes={"seconds": finished.elapsed_s})
    truth = read_truth(own / "truth" / "truth.csv")
    steps = tuple(_step(world, name, error, t_ns, truth) for name, error, t_ns in looks_of(finished.result))
    note = str(finished.result.get("note", finished.result.get("reason", "")))
    return Case(seed, kind, "done", "", steps, None, {"seconds": finished.elapsed_s, "fit": note})


def _run(seed: int, set_up: SetUp, body: dict[str, Any], own: Path) -> Finished:
    own.mkdir(parents=True, exist_ok=True)
    settings = own / "settings.toml"
    settings.write_text("[recording]\nimages = false\n", encoding="utf-8")  # fifty megabytes a run
    stack = PlacedStack(
        StackPorts.free(),
        preset=PRESET,
        seed=seed,
        truth_log=own / "truth",
        runs_folder=own / "runs",
        settings_file=settings,
        log_folder=own / "logs",
        set_up=set_up,
    )
    with stack, JobClient(stack.url) as client:
        client.wait_ready(READY_S)
        finished = client.run({**body, "owner": "reproduce"})
        time.sleep(0.3)  # the truth log is flushed twice a second
    return finished


def looks_of(result: dict[str, Any]) -> list[tuple[str, dict[str, float], int]]:
    """Name, image-based error and PLC time [ns] of each look of a line or position job."""
    if "looks" in result:
        return [(look["name"], look["error"], look["t_plc_ns"]) for look in result["looks"]]
    found = []
    for move in result["moves"]:
        name = {"orientation": "oriented", "move": f"move {move['number']}"}.get(move["kind"], move["kind"])
        if move["after"] is not None:
            found.append((name, move["after"], move["t_rest_plc_ns"]))
    return found


def read_truth(path: Path) -> Array:
    """Rows (n, 8): PLC time [ns], position [m] and quaternion wxyz of the tool in the OOI."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = [[float(row["t_plc_ns"]), *(float(row[name]) for name in TRUTH)] for row in csv.DictReader(file)
                if all(row.get(name) for name in TRUTH)]  # fmt: skip
    return np.array(rows)


def _step(world: World, name: str, error: dict[str, float], t_plc_ns: int, truth: Array) -> StepErrors:
    near = truth[resting(truth[:, 0], t_plc_ns)]
    if len(near) == 0:
        raise ValueError(
            f"look '{name}': the truth log has nothing in the {REST_NS * 1e-9:g} s before PLC time {t_plc_ns} ns"
        )
    R_ooi_tool = rotation_from_quat_wxyz(near[len(near) // 2, 4:])
    T_base_tool = world.scene.T_base_ooi @ pose(R_ooi_tool, near[:, 1:4].mean(axis=0))
    T_goal = pose(np.eye(3), np.array([0.0, 0.0, STAND_OFF_M]))
    true = true_errors(world, T_base_tool @ inverse_pose(world.scene.T_tcp_tool), T_goal)
    return StepErrors(
        name=name,
        goal_true_mm=true.goal_mm,
        goal_image_mm=_three(error, ""),
        camera_true_mm=true.camera_mm,
        camera_image_mm=_three(error, "camera_"),
        rotation_true_deg=true.rotation_deg,
        rotation_image_deg=error["rotation_deg"],
        euler_true_deg=true.euler_deg,
    )


def _three(error: dict[str, float], prefix: str) -> Three:
    return error[f"{prefix}x_mm"], error[f"{prefix}y_mm"], error[f"{prefix}z_mm"]
