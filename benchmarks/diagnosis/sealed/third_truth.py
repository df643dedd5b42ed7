"""The third plant itself, and what each of its effects is worth in millimetres when it alone is taken away."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.diagnosis.sealed import third_camera as camera
from benchmarks.diagnosis.sealed.third_arm import Arm, Array, arm_of
from benchmarks.diagnosis.sealed.third_cases import STAGE, Entry, working_range
from benchmarks.diagnosis.sealed.third_dynamics import (
    BACKLASH,
    Drive,
    Motion,
    drive_of,
    encoder_angles,
    run,
    true_angles,
)

RANDOM_POSTURES, OWN_POSTURES, LOOKS = 200, 200, 40
SHAKEN = ("backlash", "link_flexibility")  # between the true joint and its link


@dataclass(frozen=True)
class Plant:
    """A machine with its effects: what bends, what drives, what sees."""

    arm: Arm
    drive: Drive
    eyes: camera.Eyes


def plant_of(machine: dict[str, Any], effects: list[Entry]) -> Plant:
    """The plant of a machine file (as parsed) with a list of effects; none: the nominal model of the contract."""
    return Plant(arm_of(machine, effects), drive_of(machine, effects), camera.eyes_of(machine, effects))


@dataclass(frozen=True)
class Scene:
    """Where effects are weighed: the sent reference (m, n) or none, encoder readings (k, n), flanks, the object."""

    machine: dict[str, Any]
    sent: Array | None
    readings: Array
    flanks: Array
    T_base_ooi: Array

    def driven(self, plant: Plant) -> Motion | None:
        """The plant's motion along the sent reference without noise."""
        if self.sent is None:
            return None
        return run(plant.drive, self.sent, np.zeros_like(self.sent), np.random.default_rng(0))

    def resting(self, plant: Plant) -> Array:
        """Places of the tip (k, 3) [m] at the readings, each joint on its flank."""
        angles = true_angles(self.readings, plant.drive.table) + self.flanks * plant.drive.table[:, BACKLASH]
        return _tips(plant, angles)


def scene_of(machine: dict[str, Any], sent: Array | None, T_base_ooi: Array, rng: np.random.Generator) -> Scene:
    """Random postures in the working range, each approached from a random side."""
    low, high = working_range(len(machine["joint"]))
    readings = rng.uniform(low, high, (RANDOM_POSTURES, len(low)))
    return Scene(machine, sent, readings, rng.choice((-0.5, 0.5), readings.shape), T_base_ooi)


def _rms_mm(miss: Array) -> float:
    return float(1e3 * np.sqrt((miss**2).sum(axis=-1).mean()))


def _tips(plant: Plant, link: Array) -> Array:
    return plant.arm.frames(link)[:, -1, :3, 3]


class Weighed:
    """A plant with its effects, to be compared with what it becomes without some of them."""

    def __init__(self, scene: Scene, effects: list[Entry]) -> None:
        """Drive the plant once with all effects."""
        self.scene, self.effects = scene, effects
        self.plant = plant_of(scene.machine, effects)
        self.driven = scene.driven(self.plant)

    def worth(self, without: list[Entry]) -> dict[str, float | None]:
        """How far the tip moves [mm, RMS] if the plant becomes the one with the effects `without` only.

        static_mm: at the same encoder readings, over random postures and the recording's own; tracking_mm: by what
        the encoders do on the same commands; tip_mm: both, as the root of the sum of squares; posture_mm: static over
        the random postures alone; motion_mm: both over the recording's own motion alone.
        """
        other = plant_of(self.scene.machine, without)
        posture = self.scene.resting(self.plant) - self.scene.resting(other)
        driven, driven_other = self.driven, self.scene.driven(other)
        if driven is None or driven_other is None:
            static = _rms_mm(posture)
            return {"tip_mm": static, "static_mm": static, "tracking_mm": None, "posture_mm": static}
        rows = np.linspace(0, len(driven.link) - 1, OWN_POSTURES).astype(int)
        tip, tip_other = _tips(self.plant, driven.link[rows]), _tips(other, driven_other.link[rows])
        readings = encoder_angles(driven.true[rows], self.plant.drive.table)  # before counting
        same = true_angles(readings, other.drive.table) + self._behind(driven, without)[rows]
        shift = tip - _tips(other, same)
        static, tracking = _rms_mm(np.concatenate([posture, shift])), _rms_mm(tip - tip_other - shift)
        return {
            "tip_mm": float(np.hypot(static, tracking)),
            "static_mm": static,
            "tracking_mm": tracking,
            "posture_mm": _rms_mm(posture),
            "motion_mm": _rms_mm(tip - tip_other),
        }

    def _behind(self, driven: Motion, without: list[Entry]) -> Array:
        """What the link side adds to the true joint, less that of joints that lose backlash or flexibility."""
        kept = driven.link - driven.true
        left = [(effect["name"], effect["joint"]) for effect in without]
        for effect in self.effects:
            if effect["name"] in SHAKEN and (effect["name"], effect["joint"]) not in left:
                kept[:, effect["joint"] - 1] = 0.0
        return kept

    def seen(self, without: list[Entry]) -> float | None:
        """How far [mm, RMS] the place of the object in base, as the nominal camera reads it, moves without effects.

        The tip's own place is taken from the true arm, so that only what the camera says counts.
        """
        if self.driven is None:
            return None
        there = self._read_object(self.plant.eyes, self.driven)
        other = self._read_object(plant_of(self.scene.machine, without).eyes, self.driven)
        both = np.isfinite(there).all(axis=1) & np.isfinite(other).all(axis=1)
        return _rms_mm((there - other)[both]) if both.any() else None

    def _read_object(self, eyes: camera.Eyes, driven: Motion) -> Array:
        machine, arm = self.scene.machine, self.plant.arm
        nominal = camera.eyes_of(machine, [])
        t = np.arange(len(driven.link)) * machine["plc"]["cycle_s"]
        exposed = np.linspace(0.05 * t[-1], 0.95 * t[-1], LOOKS)
        T_base_tcp, T_stamped, T_later = (
            arm.frames(angles_at(t, driven.link, when))[:, -1]
            for when in (exposed, eyes.stamp(exposed), exposed + 0.01)
        )
        T_cam_ooi, T_after = (np.linalg.inv(T @ eyes.T_tcp_cam) @ self.scene.T_base_ooi for T in (T_base_tcp, T_later))
        slipped = exposed >= eyes.slips_from_frac * t[-1]
        pixels = camera.shuttered(eyes, 0.01, *(camera.project(eyes, T, slipped) for T in (T_cam_ooi, T_after)))
        good = camera.inside(eyes, pixels).all(axis=(1, 2))
        out = np.full((len(exposed), 3), np.nan)
        if good.any():
            T_read = camera.read_poses(nominal, pixels[good], T_cam_ooi[good])
            out[good] = (T_stamped[good] @ nominal.T_tcp_cam @ T_read)[:, :3, 3]
        return out


def angles_at(t: Array, q: Array, when: Array) -> Array:
    """Angles (k, n) at times (k,), interpolated; the ends are held."""
    return np.stack([np.interp(when, t, column) for column in q.T], axis=1)


def truth_of(scene: Scene, effects: list[Entry]) -> dict[str, Any]:
    """Every effect with what it is worth, and how far the nominal model misses in all."""
    weighed = Weighed(scene, effects)
    out: dict[str, Any] = {f"nominal_{key}": value for key, value in weighed.worth([]).items()}
    out["nominal_seen_mm"] = weighed.seen([]) if _is_seen(effects) else 0.0
    out["effects"] = []
    for k, effect in enumerate(effects):
        without = effects[:k] + effects[k + 1 :]
        value = next(iter(effect["parameters"].values()))
        entry = {"name": effect["name"], "joint": effect["joint"], "stage": STAGE[effect["name"]], "value": value}
        entry |= {"parameters": effect["parameters"], "detail": effect.get("detail", {})}
        entry["catalogue"] = effect.get("catalogue", True)
        entry |= weighed.worth(without) | {"seen_mm": weighed.seen(without) if _is_seen([effect]) else 0.0}
        out["effects"].append(entry)
    return out


def _is_seen(effects: list[Entry]) -> bool:
    return any(STAGE[effect["name"]] in ("camera", "time") for effect in effects)
