"""Point and go, whole: real UDP, rendered bare rock of a drawn world, a click, a job; truth joined by PLC time."""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from benchmarks.positioning.end_to_end import resting
from benchmarks.reproduce.rendered_cases import read_truth
from benchmarks.targets.scene import true_target
from longreach.fleet_client import Finished, JobClient, JobRefusedError
from longreach.processes import Stack, StackPorts
from machine.description import Machine
from machine.poses import inverse_pose, pose
from machine.rotations import Array, geodesic_angle, rotation_from_quat_wxyz
from sim_plc.camera.wall import wall_relief
from sim_plc.draw_world import draw_world
from sim_plc.world import World

PRESET = "realistic"
READY_S = 420.0
CAMERA_HZ = 6.0  # so that renderer, vision and plant keep real time on two shared cores
SHOWN_S = 2.0  # the newest image is then one of a machine at rest
TRIES = 12  # clicks until one is measured and its reach preview accepts it; the others are counted
STAND_OFF_M = 0.1
INSIDE_MM = 5.0
UNREACHABLE, NOT_CHOSEN = "unreachable", "not chosen"
CLICK_U_PX, CLICK_V_PX = (480.0, 800.0), (180.0, 400.0)


@dataclass(frozen=True, slots=True)
class PointCase:
    """One machine. true_mm: tool minus goal in true target axes after each move; rotation_deg: the same angle."""

    seed: int
    state: str
    reason: str
    refused_clicks: int
    unreachable_clicks: int
    place_mm: float
    stated_normal_deg: float
    true_mm: tuple[tuple[float, float, float], ...]
    image_mm: tuple[tuple[float, float, float], ...]
    rotation_deg: tuple[float, ...]
    reached: bool
    seconds: float

    @property
    def inside_after_one(self) -> bool:
        """Whether the tool stood truly inside 5 mm on each axis after one move."""
        return bool(self.true_mm) and max(map(abs, self.true_mm[0])) <= INSIDE_MM

    @property
    def confidently_wrong(self) -> bool:
        """Whether the job said that it was reached and the tool truly stood outside."""
        return self.reached and max(map(abs, self.true_mm[-1])) > INSIDE_MM


def point_case(machine: Machine, seed: int, folder: Path) -> PointCase:
    """One machine: processes of its own, one click in the picture, one positioning job."""
    own = folder / f"seed-{seed}"
    (own / "truth").mkdir(parents=True, exist_ok=True)
    settings = own / "settings.toml"
    settings.write_text("[recording]\nimages = false\n", encoding="utf-8")
    stack = Stack(
        StackPorts.free(),
        preset=PRESET,
        seed=seed,
        truth_log=own / "truth",
        runs_folder=own / "runs",
        settings_file=settings,
        log_folder=own / "logs",
        camera_rate_hz=CAMERA_HZ,
        sim_options=("--bare-rock",),
    )
    none = PointCase(seed, "refused", "", 0, 0, np.nan, np.nan, (), (), (), False, 0.0)
    try:
        with stack, JobClient(stack.url) as client, httpx.Client(base_url=stack.url, timeout=60.0) as rest:
            client.wait_ready(READY_S)
            time.sleep(SHOWN_S)
            patch, refused = _choose(rest, np.random.default_rng([seed, 0x636C69636B]))
            none = replace(none, refused_clicks=len(refused) - refused.count(UNREACHABLE))
            none = replace(none, unreachable_clicks=refused.count(UNREACHABLE))
            if patch is None:
                return replace(none, state=NOT_CHOSEN, reason=f"no click was accepted: {sorted(set(refused))}")
            finished = client.run({"kind": "position", "owner": "bench"})
            time.sleep(0.6)  # the truth log is flushed twice a second
    except JobRefusedError as error:
        return replace(none, reason=str(error))
    if finished.result is None:
        return replace(none, state=finished.state, reason=finished.reason)
    return _judged(draw_world(machine, PRESET, seed), none, patch, finished, read_truth(own / "truth/truth.csv"))


def _choose(rest: httpx.Client, rng: np.random.Generator) -> tuple[dict[str, Any] | None, list[str]]:
    """Click in the newest image until a patch is measured and its preview accepted, then use it; why others were not.

    An operator chooses among the places that the panel states to be reachable.
    """
    refused: list[str] = []
    for _ in range(TRIES):
        image = int(rest.get("/v1/target/image").headers["Longreach-Image"])
        click = {"image": image, "u_px": float(rng.uniform(*CLICK_U_PX)), "v_px": float(rng.uniform(*CLICK_V_PX))}
        patch = rest.post("/v1/target/measure", json=click).raise_for_status().json()
        if patch["status"] == "ok" and patch["reach"] == "reachable":
            lease = rest.post("/v1/lease", json={"owner": "bench", "kind": "operator"}).raise_for_status().json()
            held = {"Longreach-Lease": lease["lease_id"], "Longreach-Fencing": str(lease["fencing"])}
            rest.post("/v1/target", json={"target_id": patch["target_id"]}, headers=held).raise_for_status()
            rest.delete(f"/v1/lease/{lease['lease_id']}", headers=held)
            return patch, refused
        refused.append(UNREACHABLE if patch["status"] == "ok" else patch["status"])
    return None, refused


def _judged(world: World, none: PointCase, patch: dict[str, Any], finished: Finished, truth: Array) -> PointCase:
    result = finished.result
    if result is None:
        raise ValueError("the job has no result to judge")
    at_start = _T_ooi_tool(truth, result["t_start_plc_ns"])
    T_ooi_cam = at_start @ inverse_pose(world.scene.T_tcp_tool) @ world.camera.T_tcp_cam_left
    scene = world.scene
    relief = wall_relief(scene.texture_seed, scene.wall_relief_m, scene.wall_offset_m)
    T_cam_target = true_target(relief, world.camera.left, T_ooi_cam, (patch["u_px"], patch["v_px"]))
    goal = pose(np.eye(3), np.array([0.0, 0.0, STAND_OFF_M]))
    T_goal_ooi = inverse_pose(T_ooi_cam @ T_cam_target @ goal)
    moves = [move for move in result["moves"] if move["kind"] == "move" and move["after"] is not None]
    errors = [T_goal_ooi @ _T_ooi_tool(truth, move["t_rest_plc_ns"]) for move in moves]
    return replace(
        none,
        state=finished.state,
        reason=result["reason"],
        place_mm=float(abs(patch["distance_mm"] - 1e3 * np.linalg.norm(T_cam_target[:3, 3]))),
        stated_normal_deg=patch["normal_deg"],
        true_mm=tuple(_three(1e3 * error[:3, 3]) for error in errors),
        image_mm=tuple(_three([move["after"][f"{axis}_mm"] for axis in "xyz"]) for move in moves),
        rotation_deg=tuple(float(np.rad2deg(geodesic_angle(np.eye(3), error[:3, :3]))) for error in errors),
        reached=result["reached"],
        seconds=finished.elapsed_s,
    )


def _three(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _T_ooi_tool(truth: Array, t_plc_ns: int) -> Array:
    near = truth[resting(truth[:, 0], t_plc_ns)]
    if len(near) == 0:
        raise ValueError(f"the truth log has nothing in the 0.3 s before PLC time {t_plc_ns} ns")
    return pose(rotation_from_quat_wxyz(near[len(near) // 2, 4:]), near[:, 1:4].mean(axis=0))
