"""One recording of a plant: every signal with its noise, written as the folder form says."""

import csv
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.diagnosis.sealed import behind, motion, own_plant
from benchmarks.diagnosis.sealed import nominal_own as own
from benchmarks.diagnosis.sealed.faults import Faults
from benchmarks.diagnosis.sealed.link import received
from benchmarks.diagnosis.sealed.plants import OWN, Arm, Plant
from machine.rotations import Array

TRACKER_S, CAMERA_S = 1.6, 1.6  # between two samples; a whole number of them from repeat to repeat
STATIC = 24
OFFSET_S = 3.0  # t_pc = t_plc + offset; the camera's clock is the PC's


@dataclass(frozen=True)
class Noise:
    """One noise level: speed disturbance's innovations [rad/s], tracker [m], corners [px], link jitter [s]."""

    speed: float
    tracker_m: float
    corner_px: float
    jitter_s: float


NOISES = (Noise(1e-4, 2e-4, 0.08, 0.0), Noise(3e-4, 5e-4, 0.2, 2e-4), Noise(8e-4, 1.2e-3, 0.5, 6e-4))


@dataclass(frozen=True)
class Made:
    """A recording before it is written."""

    t_s: Array
    ref: Array
    number: Array
    sent: Array
    t_sent_s: Array
    course: own_plant.Course
    pieces: tuple[motion.Piece, ...]
    tracker: list[tuple]
    static: list[tuple]
    markers: list[tuple]
    plant: Plant = OWN


def streams(seed: int) -> dict[str, np.random.Generator]:
    """One random stream a purpose: what is drawn for one does not move another."""
    names = ("motion", "link", "plant", "tracker", "static", "camera", "foreign")
    return {name: np.random.default_rng([seed, k]) for k, name in enumerate(names)}


def make(faults: Faults, noise: Noise, seed: int, plant: Plant = OWN) -> Made:
    """Simulate one recording."""
    rng = streams(seed)
    sent, pieces = motion.programme(rng["motion"], plant.home_rad, own.SENT_S)
    t_sent = own.SENT_S * np.arange(len(sent)) - own.SENT_EARLY_S
    t = own.CYCLE_S * np.arange(round(len(sent) * own.SENT_S / own.CYCLE_S))
    ref, number = received(faults, sent, t_sent, t, noise.jitter_s, rng["link"])
    shock = rng["plant"].normal(0.0, noise.speed, ref.shape)
    course = plant.run(faults, ref, shock)
    course = replace(course, tree_q=behind.swung(faults, course.tree_q, plant.motors))
    arm = plant.arm(faults)
    tracker = _tracked(arm, t, course.tree_q, noise.tracker_m, rng["tracker"])
    static = _static(plant, faults, noise.tracker_m, rng["static"])
    markers = _seen(plant, faults, t, course.tree_q, noise.corner_px, rng["camera"])
    return Made(t, ref, number, sent, t_sent, course, pieces, tracker, static, markers, plant)


def _tracked(arm: Arm, t: Array, tree_q: Array, sd: float, rng: np.random.Generator) -> list[tuple]:
    when = np.arange(0.5, t[-1] - 0.5, TRACKER_S)
    out = []
    for at, q in zip(when, behind.at_times(t, tree_q, when), strict=True):
        for name, xyz in arm.points(q).items():
            out.append((at, name, *(xyz + rng.normal(0.0, sd, 3))))
    return out


def _static(plant: Plant, faults: Faults, sd: float, rng: np.random.Generator) -> list[tuple]:
    readings, trees = plant.rest_poses(faults, rng, STATIC)
    arm, out = plant.arm(faults), []
    for k, (reading, q) in enumerate(zip(readings, trees, strict=True)):
        for name, xyz in arm.points(q).items():
            out.append((k, *reading, name, *(xyz + rng.normal(0.0, sd, 3))))
    return out


def _seen(plant: Plant, faults: Faults, t: Array, tree_q: Array, sd: float, rng: np.random.Generator) -> list[tuple]:
    arm, sight, T_ooi = plant.arm(faults), behind.sight_of(faults), plant.T_base_ooi()
    loose = next((one for one in faults.injected if one.name == "loose_marker"), None)
    when = np.arange(0.6, t[-1] - 0.6, CAMERA_S)
    now, later = (behind.at_times(t, tree_q, when + dt) for dt in (0.0, 0.01))
    out = []
    for at, q, q_later in zip(when, now, later, strict=True):
        stamp = at + sight.late_s + sight.rate * at + OFFSET_S
        T, T_later = (arm.tcp(one) @ sight.T_tcp_cam for one in (q, q_later))
        for number, x, y, z in own.PLACES:
            place = np.array([x, y, z])
            if loose is not None and number == 2 and at > 0.4 * t[-1]:
                place = place + np.array([loose.size, -0.5 * loose.size, 0.0])
            out += _rows(sight, stamp, number, T, T_later, T_ooi, own.SIDE_M, place, sd, rng)
        T_tool = np.linalg.inv(sight.T_tcp_cam)  # the tool in the camera: it moves with it
        out += _rows(
            sight, stamp, 10, np.eye(4), np.eye(4), T_tool @ own.T_tcp_marker_tool(), own.TOOL_SIDE_M, np.zeros(3), sd,
            rng,
        )  # fmt: skip
    return out


def _rows(
    sight: behind.Sight,
    stamp: float,
    number: int,
    T: Array,
    T_later: Array,
    T_object: Array,
    side: float,
    place: Array,
    sd: float,
    rng: np.random.Generator,
) -> list[tuple]:
    pixels = behind.corners(sight, T, T_object, side, place)
    if sight.readout_s:
        moved = behind.corners(sight, T_later, T_object, side, place)
        row = pixels[..., 1:] / (sight.camera.height_px - 1.0) - 0.5
        pixels = pixels + (moved - pixels) / 0.01 * row * sight.readout_s
    noisy = pixels + rng.normal(0.0, sd, pixels.shape)
    size = np.array([sight.camera.width_px, sight.camera.height_px])
    return [
        (stamp, eye, number, *corners.ravel())
        for eye, corners in zip(("left", "right"), noisy, strict=True)
        if np.isfinite(corners).all() and (corners > 2).all() and (corners < size - 3).all()
    ]


def write(made: Made, folder: Path, name: str, machine: str, foreign: str = "", seed: int = 0) -> None:
    """The folder form. `foreign`: spoils of the log itself (dropped samples, swapped joints)."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "machine.toml").write_text(machine, encoding="utf-8")
    (folder / "run.toml").write_text(_run_toml(made.pieces, name), encoding="utf-8")
    plc = _plc_rows(made)
    if foreign == "dropped_samples":
        rng = streams(seed)["foreign"]
        kept = np.ones(len(plc), dtype=bool)
        for start in rng.integers(0, len(plc), len(plc) // 400):
            kept[start : start + int(rng.integers(1, 4))] = False
        plc = [row for row, keep in zip(plc, kept, strict=True) if keep]
    if foreign == "swapped_joints":
        order = [0, 1, 2, 4, 3]  # the encoders of lift and slew
        plc = [(*row[:5], row[6], row[5], *row[7:]) for row in plc] if order else plc
    joints = range(1, own.N + 1)
    signals = [("q_ref_{}_rad", joints), ("q_{}_rad", joints), ("u_{}_frac", joints)]
    columns = ["t_plc_s", "seq_received", *(one.format(j) for one, numbers in signals for j in numbers)]
    columns += [f"p_{side}_{j}_pa" for j in joints for side in "ab"] + ["p_supply_pa"]
    _csv(folder / "plc.csv", columns, plc)
    sent = [(t + OFFSET_S, k, *q) for k, (t, q) in enumerate(zip(made.t_sent_s, made.sent, strict=True))]
    _csv(folder / "sent.csv", ["t_pc_s", "seq", *(f"q_sent_{j}_rad" for j in joints)], sent)
    place = ["point", "x_m", "y_m", "z_m"]
    _csv(folder / "tracker.csv", ["t_plc_s", *place], made.tracker)
    _csv(folder / "static.csv", ["pose_index", *(f"q_{j}_rad" for j in joints), *place], made.static)
    pixels = [f"{axis}{k}_px" for k in range(4) for axis in "uv"]
    _csv(folder / "markers.csv", ["t_camera_s", "eye", "marker_id", *pixels], made.markers)


def _plc_rows(made: Made) -> list[tuple]:
    numbers = np.concatenate([made.ref, made.course.enc, made.course.u, made.course.pressures], axis=1).tolist()
    return [(t, int(k), *row) for t, k, row in zip(made.t_s.tolist(), made.number, numbers, strict=True)]


def _run_toml(pieces: tuple[motion.Piece, ...], name: str) -> str:
    text = f'[run]\nname = "{name}"\nformat_version = 1\n'
    text += f"[clocks]\nplc_to_pc_offset_s = {OFFSET_S}\ncamera_to_pc_offset_s = 0.0\n"
    first = next(one.name for one in pieces if one.repeat)
    for one in pieces:
        again = f'repeat_of = "{first}"\n' if one.repeat else ""
        text += (
            f'\n[[segment]]\nname = "{one.name}"\nkind = "{one.kind}"\nt_start_plc_s = {one.start_s:.6f}\n'
            f"t_end_plc_s = {one.end_s - own.CYCLE_S:.6f}\n{again}"
        )
    return text


def _csv(path: Path, columns: list[str], rows: Iterable[tuple]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([_cell(value) for value in row] for row in rows)


def _cell(value: object) -> object:
    return f"{value:.9g}" if isinstance(value, float) else value
