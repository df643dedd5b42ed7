"""`python -m benchmarks.diagnosis.sealed.third_plant OUT --n N --seed S [--kind KIND] [--first K]`: first-day cases.

The third plant is written from the contract alone and imports nothing of machine, sim_plc or diagnosis. OUT/case_000/
is what the tool gets, with the hash of its truth; OUT/truth.json holds all truths and is for the scorer.
"""

import argparse
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.diagnosis.sealed import third_camera as camera
from benchmarks.diagnosis.sealed.third_arm import Array, rotation
from benchmarks.diagnosis.sealed.third_cases import (
    CATALOGUE,
    FOREIGN,
    Entry,
    draw_many,
    draw_one,
    home_of,
    machine_of,
    working_range,
)
from benchmarks.diagnosis.sealed.third_dynamics import BACKLASH, DISTURBANCE_MEMORY, Motion, run, true_angles
from benchmarks.diagnosis.sealed.third_files import write_csv, write_run, write_toml
from benchmarks.diagnosis.sealed.third_motion import Segment, programme
from benchmarks.diagnosis.sealed.third_truth import Plant, angles_at, plant_of, scene_of, truth_of

POSES, TWICE = 60, 10
TRACKER_S = 0.1
LEVELS = (1.0, 1.0, 1.0, 3.0)  # noise of a case; the shared recordings are of levels 1 and 3
PIXEL, PLACE_M, SPEED_RAD_S = 0.15, 0.0002, 0.00031  # standard deviations at level 1, those of the shared recordings
JOINTS = (6, 6, 6, 6, 4, 3)


@dataclass(frozen=True)
class Recording:
    """What is driven, which files are written, and how many poses at rest are visited twice."""

    programme: str = "identify"
    files: frozenset[str] = frozenset({"sent", "plc", "markers", "static", "tracker"})
    twice: int = TWICE

    @property
    def moves(self) -> bool:
        """Whether anything of the motion is written."""
        return "plc" in self.files


CAMERA_AND_PLC = frozenset({"sent", "plc", "markers"})
RECORDINGS = {
    "full": Recording(),
    "no_repeats": Recording("no_repeats", twice=0),
    "one_job": Recording("one_job", CAMERA_AND_PLC),
    "no_tracker": Recording("identify", CAMERA_AND_PLC),
    "camera_only": Recording("rests", frozenset({"plc", "markers"})),
    "static_only": Recording("identify", frozenset({"static"}), twice=0),
}
KINDS = {  # effects (none, one, many, foreign, foreign_many) and the recording of each kind
    "many": ("many", "full"),
    "healthy": ("none", "full"),
    "healthy_no_repeats": ("none", "no_repeats"),
    "single": ("one", "full"),
    "foreign": ("foreign", "full"),
    "foreign_many": ("foreign_many", "full"),
    **{name: ("many", name) for name in RECORDINGS if name != "full"},
}


@dataclass(frozen=True)
class Case:
    """One drawn case: its machine (as parsed), effects, motion, noise, and where the object stands."""

    kind: str
    machine: dict[str, Any]
    effects: list[Entry]
    sent: Array
    segments: tuple[Segment, ...]
    level: float
    T_base_ooi: Array
    clocks: tuple[float, float]  # plc to pc, camera to pc [s]
    tracked: bool
    seed: tuple[int, int]
    recording: Recording


def draw(kind: str, number: int, seed: int, recording: str | None = None, shorten: float = 1.0) -> Case:
    """Case `number` of a kind, the same for the same seed.

    Args: recording: another one than the kind's own. shorten: of the motion's length, for tests.
    """
    drawn, recorded = KINDS[kind][0], RECORDINGS[recording or KINDS[kind][1]]
    rng = np.random.default_rng([seed, number, list(KINDS).index(kind)])
    n = int(rng.choice(JOINTS))
    machine, home = machine_of(rng, n), home_of(rng, n)
    effects: list[Entry] = []
    if "many" in drawn:
        effects += draw_many(rng, n)
    if drawn == "one":
        effects.append(draw_one(rng, n, CATALOGUE, number))
    if "foreign" in drawn:
        effects.append(draw_one(rng, n, FOREIGN, number) | {"catalogue": False})
        if effects[-1]["name"] == "cable_tug":
            effects[-1]["parameters"]["from_rad"] = float(home[effects[-1]["joint"] - 1])
    sent, segments = programme(recorded.programme, rng, home, machine["plc"]["cycle_s"], shorten)
    plant = plant_of(machine, effects)
    T_cam_ooi = np.eye(4)
    T_cam_ooi[:3, :3] = rotation(rng.normal(size=3), float(rng.uniform(0.0, 0.3))) @ np.diag([1.0, -1.0, -1.0])
    T_cam_ooi[:3, 3] = *rng.uniform(-0.08, 0.08, 2), rng.uniform(0.85, 1.4)
    T_base_ooi = plant.arm.frames(home[None])[0, -1] @ camera.eyes_of(machine, []).T_tcp_cam @ T_cam_ooi
    clocks = (round(float(rng.uniform(-0.5, 0.5)), 6), round(float(rng.uniform(-0.5, 0.5)), 6))
    level, tracked = float(rng.choice(LEVELS)), bool(rng.uniform() < 0.5)
    return Case(kind, machine, effects, sent, segments, level, T_base_ooi, clocks, tracked, (seed, number), recorded)


def write_case(case: Case, folder: Path) -> dict[str, Any]:
    """Write what the tool gets, sealed by its truth's hash; the truth is returned."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([*case.seed, 1])
    plant, files = plant_of(case.machine, case.effects), case.recording.files
    shock = SPEED_RAD_S * case.level * np.sqrt(1.0 - DISTURBANCE_MEMORY**2) * rng.normal(size=case.sent.shape)
    motion = run(plant.drive, case.sent, shock, rng)
    t = np.arange(len(case.sent)) * case.machine["plc"]["cycle_s"]
    if "sent" in files:
        columns = {"t_pc_s": t + case.clocks[0], "seq": np.arange(len(t))} | _columns("q_sent_{}_rad", case.sent)
        write_csv(folder / "sent.csv", columns)
    if "plc" in files:
        _write_plc(case, motion, t, folder)
    if "markers" in files:
        _write_markers(case, plant, motion, t, rng, folder)
    if "static" in files:
        _write_static(case, plant, rng, folder)
    if "tracker" in files and case.tracked:
        _write_tracker(case, plant, motion, t, rng, folder)
    write_toml(folder / "machine.toml", _without_tracker(case))
    moving = case.recording.moves
    write_run(folder / "run.toml", folder.name, case.segments if moving else (), case.clocks if moving else (0.0, 0.0))
    scene = scene_of(case.machine, case.sent if moving else None, case.T_base_ooi, np.random.default_rng(200))
    truth = _header(case, plant, folder) | truth_of(scene, case.effects)
    (folder / "seal.json").write_text(json.dumps({"sha256": digest(truth)}), encoding="utf-8")
    return truth


def _without_tracker(case: Case) -> dict[str, Any]:
    """The machine file; a tracker that measured nothing is left out."""
    measured = bool(case.recording.files & {"static", "tracker"})
    return {table: values for table, values in case.machine.items() if measured or table != "tracker"}


def _header(case: Case, plant: Plant, folder: Path) -> dict[str, Any]:
    """What a scorer needs of a case besides its effects."""
    return {
        "kind": case.kind,
        "seed": case.seed[0],
        "number": case.seed[1],
        "joints": len(case.machine["joint"]),
        "noise": {"level": case.level, "pixel_px": PIXEL * case.level, "place_m": PLACE_M * case.level},
        "reference_torque_nm": plant.drive.reference_torque.tolist(),
        "files": sorted(path.name for path in folder.glob("*.csv")),
    }


def digest(truth: dict[str, Any]) -> str:
    """The seal of a truth: SHA-256 of its text with sorted keys."""
    return hashlib.sha256(json.dumps(truth, sort_keys=True).encode()).hexdigest()


def _columns(name: str, values: Array) -> dict[str, Array]:
    return {name.format(j + 1): values[:, j] for j in range(values.shape[1])}


def _write_plc(case: Case, motion: Motion, t: Array, folder: Path) -> None:
    columns = {"t_plc_s": t, "seq_received": motion.seq}
    if case.recording.programme != "rests":
        columns |= _columns("q_ref_{}_rad", motion.ref)
    columns |= _columns("q_{}_rad", motion.encoder)
    if case.recording.programme != "rests":
        columns |= _columns("u_{}_frac", motion.u)
    write_csv(folder / "plc.csv", columns)


def _write_markers(case: Case, plant: Plant, motion: Motion, t: Array, rng: np.random.Generator, folder: Path) -> None:
    """Rows of the markers with all corners in a picture, both eyes, while moving and at rest."""
    eyes = plant.eyes
    exposed = np.arange(0.0, t[-1], 1.0 / case.machine["camera"]["rate_hz"])
    slipped = exposed >= eyes.slips_from_frac * t[-1]
    pixels = []
    for late in (0.0, 0.01):
        T_base_tcp = plant.arm.frames(angles_at(t, motion.link, exposed + late))[:, -1]
        pixels.append(camera.project(eyes, np.linalg.inv(T_base_tcp @ eyes.T_tcp_cam) @ case.T_base_ooi, slipped))
    corners = camera.shuttered(eyes, 0.01, pixels[0], pixels[1])
    corners = corners + rng.normal(0.0, PIXEL * case.level, corners.shape)
    good = camera.inside(eyes, corners)
    when, eye, marker = np.nonzero(good)
    stamp = eyes.stamp(exposed) + case.clocks[0] - case.clocks[1]
    names = [f"{axis}{k}_px" for k in range(4) for axis in "uv"]
    rows = corners[when, eye, marker].reshape(-1, 8)
    columns: dict[str, Array] = {"t_camera_s": stamp[when], "eye": np.array(["left", "right"])[eye]}
    columns |= {"marker_id": np.array(eyes.ids)[marker]} | {name: rows[:, k] for k, name in enumerate(names)}
    write_csv(folder / "markers.csv", columns, decimals=3)


def _points(case: Case) -> tuple[tuple[int, Array], ...]:
    return tuple((point["joint"], np.array(point["xyz_m"])) for point in case.machine["points"].values())


def _write_static(case: Case, plant: Plant, rng: np.random.Generator, folder: Path) -> None:
    """Poses at rest, the first ones visited twice; the arm comes from a random side each time."""
    low, high = working_range(len(case.machine["joint"]))
    q = rng.uniform(low, high, (POSES, len(low)))
    index = np.concatenate([np.arange(POSES), np.arange(case.recording.twice)])
    true = true_angles(q[index], plant.drive.table)
    link = true + rng.choice((-0.5, 0.5), true.shape) * plant.drive.table[:, BACKLASH]
    places = plant.arm.points(link, _points(case))
    places = places + rng.normal(0.0, PLACE_M * case.level, places.shape)
    count = places.shape[1]
    columns: dict[str, Array] = {"pose_index": np.repeat(index, count)}
    columns |= _columns("q_{}_rad", np.repeat(q[index], count, axis=0))
    columns |= {"point": np.tile(list(case.machine["points"]), len(index))}
    write_csv(folder / "static.csv", columns | dict(zip(("x_m", "y_m", "z_m"), places.reshape(-1, 3).T, strict=True)))


def _write_tracker(case: Case, plant: Plant, motion: Motion, t: Array, rng: np.random.Generator, folder: Path) -> None:
    """Both points at 10 Hz while the arm moves."""
    when = np.arange(0.0, t[-1], TRACKER_S)
    places = plant.arm.points(angles_at(t, motion.link, when), _points(case))
    places = places + rng.normal(0.0, PLACE_M * case.level, places.shape)
    count = places.shape[1]
    columns: dict[str, Array] = {
        "t_plc_s": np.repeat(when, count),
        "point": np.tile(list(case.machine["points"]), len(when)),
    }
    write_csv(folder / "tracker.csv", columns | dict(zip(("x_m", "y_m", "z_m"), places.reshape(-1, 3).T, strict=True)))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--n", type=int, default=1, help="machines")
    parser.add_argument("--first", type=int, default=0, help="number of the first machine")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=(*KINDS, "mixed"), default="many", help="mixed: every kind in turn")
    parser.add_argument("--recording", choices=tuple(RECORDINGS), help="another recording than the kind's own")
    parser.add_argument("--shorten", type=float, default=1.0, help="of the motion's length")
    given = parser.parse_args()
    truths: dict[str, Any] = {}
    for number in range(given.first, given.first + given.n):
        kind = list(KINDS)[number % len(KINDS)] if given.kind == "mixed" else given.kind
        name = f"case_{number:03d}"
        truths[name] = write_case(draw(kind, number, given.seed, given.recording, given.shorten), given.out / name)
        (given.out / "truth.json").write_text(json.dumps(truths, indent=1), encoding="utf-8")
        print(name, kind, f"nominal {truths[name]['nominal_tip_mm']:.2f} mm", flush=True)


if __name__ == "__main__":
    main()
