"""The third plant itself, and what each of its effects is worth in millimetres when it alone is taken away."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.gap_benchmark import third_camera as camera
from tests.gap_benchmark.third_arm import Arm, Array, arm_of
from tests.gap_benchmark.third_cases import STAGE, Entry, working_range
from tests.gap_benchmark.third_dynamics import BACKLASH, Drive, Motion, drive_of, encoder_angles, run, true_angles

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
    """Where the effects are weighed: the sent reference (m, n) or none, encoder readings (k, n), flanks, the object."""

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


def scene_of(machine: dict[str, Any], sent: Array | None, T_base_ooi: Array, rng: np.random.Generator) -> Scene:
    """Random postures in the working range, each approached from a random side."""
    low, high = working_range(len(machine["joint"]))
    readings = rng.uniform(low, high, (RANDOM_POSTURES, len(low)))
    return Scene(machine, sent, readings, rng.choice((-0.5, 0.5), readings.shape), T_base_ooi)


def _rms_mm(miss: Array) -> float:
    return float(1e3 * np.sqrt((miss**2).sum(axis=-1).mean())) if len(miss) else 0.0


def _tips(plant: Plant, link: Array) -> Array:
    return plant.arm.frames(link)[:, -1, :3, 3]


def worth(scene: Scene, effects: list[Entry], without: list[Entry]) -> dict[str, float | None]:
    """How far the tip moves [mm, RMS] if the plant with `effects` becomes the one `without` some of them.

    static_mm: at the same encoder readings, over random postures and the recording's own; tracking_mm: by what the
    encoders do on the same commands; tip_mm: both, as the root of the sum of squares; posture_mm: the random ones.
    """
    full, other = plant_of(scene.machine, effects), plant_of(scene.machine, without)
    tips = [_tips(p, _at_rest(p, scene)) for p in (full, other)]
    posture = tips[0] - tips[1]
    out: dict[str, float | None] = {"posture_mm": _rms_mm(posture)}
    static, tracking = posture, None
    driven, driven_other = scene.driven(full), scene.driven(other)
    if driven is not None and driven_other is not None:
        rows = np.linspace(0, len(driven.link) - 1, OWN_POSTURES).astype(int)
        tip, tip_other = _tips(full, driven.link[rows]), _tips(other, driven_other.link[rows])
        readings = encoder_angles(driven.true[rows], full.drive.table)  # before counting
        same = true_angles(readings, other.drive.table) + _behind(effects, without, driven)[rows]
        shift = tip - _tips(other, same)
        static = np.concatenate([posture, shift])
        tracking = _rms_mm(tip - tip_other - shift)
        out["motion_mm"] = _rms_mm(tip - tip_other)
    out |= {"static_mm": _rms_mm(static), "tracking_mm": tracking}
    out["tip_mm"] = float(np.hypot(_rms_mm(static), tracking or 0.0))
    return out


def _at_rest(plant: Plant, scene: Scene) -> Array:
    """Link-side angles at the scene's encoder readings."""
    return true_angles(scene.readings, plant.drive.table) + scene.flanks * plant.drive.table[:, BACKLASH]


def _behind(effects: list[Entry], without: list[Entry], driven: Motion) -> Array:
    """What the link side adds to the true joint, less that of joints whose backlash or flexibility was taken away."""
    kept = driven.link - driven.true
    left = [(effect["name"], effect["joint"]) for effect in without]
    for effect in effects:
        if effect["name"] in SHAKEN and (effect["name"], effect["joint"]) not in left:
            kept[:, effect["joint"] - 1] = 0.0
    return kept


def seen(scene: Scene, effects: list[Entry], without: list[Entry]) -> float | None:
    """How far [mm, RMS] the place of the object in base, as the nominal camera reads it, moves without some effects.

    The tip's own place is taken from the true arm, so that only what the camera says counts.
    """
    if scene.sent is None:
        return None
    full = plant_of(scene.machine, effects)
    driven = scene.driven(full)
    assert driven is not None
    places = [_read_object(scene, full.arm, plant_of(scene.machine, some).eyes, driven) for some in (effects, without)]
    both = np.isfinite(places[0]).all(axis=1) & np.isfinite(places[1]).all(axis=1)
    return _rms_mm((places[0] - places[1])[both]) if both.any() else None


def _read_object(scene: Scene, arm: Arm, eyes: camera.Eyes, driven: Motion) -> Array:
    cycle, nominal = scene.machine["plc"]["cycle_s"], camera.eyes_of(scene.machine, [])
    t = np.arange(len(driven.link)) * cycle
    exposed = np.linspace(0.05 * t[-1], 0.95 * t[-1], LOOKS)
    T_base_tcp, T_stamped, T_later = (
        arm.frames(angles_at(t, driven.link, when))[:, -1] for when in (exposed, eyes.stamp(exposed), exposed + 0.01)
    )
    T_cam_ooi, T_after = (np.linalg.inv(T @ eyes.T_tcp_cam) @ scene.T_base_ooi for T in (T_base_tcp, T_later))
    slipped = exposed >= eyes.slips_from_frac * t[-1]
    pixels = camera.shuttered(eyes, 0.01, *(camera.project(eyes, T, slipped) for T in (T_cam_ooi, T_after)))
    good = np.isfinite(pixels).all(axis=(1, 2, 3, 4)) & (np.abs(pixels) < 1e4).all(axis=(1, 2, 3, 4))
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
    out: dict[str, Any] = {f"nominal_{key}": value for key, value in worth(scene, effects, []).items()}
    out["nominal_seen_mm"] = seen(scene, effects, []) if _sees(effects) else 0.0
    out["effects"] = []
    for k, effect in enumerate(effects):
        without = effects[:k] + effects[k + 1 :]
        value = next(iter(effect["parameters"].values()))
        entry = {"name": effect["name"], "joint": effect["joint"], "stage": STAGE[effect["name"]], "value": value}
        entry |= {"parameters": effect["parameters"], "detail": effect.get("detail", {})}
        entry["catalogue"] = effect.get("catalogue", True)
        entry |= worth(scene, effects, without) | {"seen_mm": seen(scene, effects, without) if _sees([effect]) else 0.0}
        out["effects"].append(entry)
    return out


def _sees(effects: list[Entry]) -> bool:
    return any(STAGE[effect["name"]] in ("camera", "time") for effect in effects)
