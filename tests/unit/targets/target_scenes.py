"""Bare rock seen twice, with its truth, for the tests of targets."""

from functools import lru_cache
from pathlib import Path

import numpy as np

from benchmarks.targets.scene import bare_rock, left_eye, true_target, view
from machine.description import Machine, parse_machine_toml
from machine.poses import inverse_pose
from server.targets.anchor import anchor_target
from server.targets.contracts import AnchoredTarget, TargetSettings
from server.targets.surface import measure_patch

ROOT = Path(__file__).parents[3]
PIXEL = (640.0, 250.0)
SETTINGS = TargetSettings()


@lru_cache
def machine() -> Machine:
    return parse_machine_toml((ROOT / "machine" / "machines" / "hiab033.toml").read_text(encoding="utf-8"))


@lru_cache
def rock():
    return bare_rock(machine(), seed=3)


@lru_cache
def pair_at(distance_m: float, seed: int):
    """A pair (left, right), and the true T_ooi_cam."""
    rng = np.random.default_rng(seed)
    T = view(machine(), rng, distance_m)
    return rock().render_static(T, rng), left_eye(rock(), T)


@lru_cache
def anchored() -> tuple[AnchoredTarget, np.ndarray]:
    """A target measured from afar, and its true pose in the OOI."""
    pair, T_ooi_cam = pair_at(0.7, 1)
    patch = measure_patch(*pair, machine().camera, PIXEL, SETTINGS)
    assert patch.ok, patch.reason
    target = anchor_target(1, patch, *pair, machine().camera, SETTINGS)
    assert isinstance(target, AnchoredTarget), target.reason
    return target, T_ooi_cam @ true_target(rock().relief, machine().camera, T_ooi_cam, PIXEL)


def true_in(T_ooi_cam: np.ndarray) -> np.ndarray:
    """T_cam_target as it truly is."""
    return inverse_pose(T_ooi_cam) @ anchored()[1]


def pixel_of(T_ooi_cam: np.ndarray) -> tuple[int, int]:
    """Where the target is in the left image."""
    from machine.camera import project

    u, v = project(machine().camera, true_in(T_ooi_cam)[None, :3, 3])[0]
    return round(u), round(v)
