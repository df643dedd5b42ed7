"""Poses at rest of an arm with two points seen by a tracker that stands anywhere."""

from pathlib import Path

import numpy as np
from diagnosis_cases import MACHINE, MACHINE_TOML

from diagnosis.reading.read import Read, examine_recording
from machine.effects.arm import arm_of
from machine.effects.entries import make_entry, pack_effects
from machine.effects.layout import ParameterSets
from machine.effects.registry import effect_named
from machine.effects.structure import link_poses
from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from recording.content import Recording
from recording.rows import Row, StaticPoint
from recording.run import RunInfo

ARM = arm_of(MACHINE)
TRACKER = pose(rotation_from_rotvec(np.array([0.1, -0.4, 2.0])), np.array([4.0, -3.0, 1.0]))  # T_tracker_base
POINTS = "\n[points]\ntip = { joint = 6, xyz_m = [0.0, -0.3, 0.1] }\nelbow = { joint = 2, xyz_m = [0.1, 0.2, 0.0] }\n"
NOISE_M = 2e-4


def packed(name: str, joint: int | None, **parameters: object) -> ParameterSets:
    effect = effect_named(name)
    assert effect is not None
    return pack_effects([make_entry(effect, joint, parameters)], 6)


def static_recording(sets: ParameterSets, toml: str = MACHINE_TOML + POINTS, seed: int = 3) -> Recording:
    """40 poses at rest, two points, a tracker in a frame of its own."""
    rng = np.random.default_rng(seed)
    low, high = (np.array([getattr(j, name) for j in MACHINE.joints]) for name in ("q_min_rad", "q_max_rad"))
    qs = low + (high - low) * rng.uniform(0.1, 0.9, (40, 6))
    rows: list[Row] = []
    for k, links in enumerate(link_poses(ARM, sets, qs)):
        for name, joint, xyz in (("tip", 6, (0.0, -0.3, 0.1)), ("elbow", 2, (0.1, 0.2, 0.0))):
            at = TRACKER @ links[joint] @ np.array([*xyz, 1.0])
            x, y, z = at[:3] + rng.normal(0.0, NOISE_M, 3)
            rows.append(StaticPoint(k, tuple(qs[k].tolist()), name, float(x), float(y), float(z)))
    return Recording("folder", RunInfo("static"), toml, tuple(rows))


def examined(made: Recording) -> Read:
    return examine_recording(made, Path("made_up"))
