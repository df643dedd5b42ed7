"""A plant of its own for the diagnosis' tests: plain numpy, written from the contract, no code of the kernel.

Another integration step (0.5 ms, explicit midpoint), AR(1) disturbance of the speed, quantised encoders.
Two joints: a slewing one with gravity along its axis, and a boom with mass.
"""

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit

STEP_S = 0.0005
CYCLE_S, LOG_S, SENT_S = 0.001, 0.01, 0.01
DELAY_S = 0.004
OFFSET_S = 3.0
GAIN, WN, ZETA, KP = np.array([0.5, 0.4]), 2 * np.pi * np.array([8.0, 10.0]), 0.8, np.array([6.0, 7.0])
COUNTS = 2**16
START = np.array([0.2, 0.4])
PIXELS, WIDTH, HEIGHT, BASELINE = 700.0, 1920, 1080, 0.12
SIDE, PLACES = 0.3, ((-0.4, 0.3), (0.4, 0.3), (0.4, -0.3), (-0.4, -0.3))
MACHINE = "\n".join(
    [
        '[machine]\nname = "made-up boom"\ngravity_base_m_s2 = [0.0, 0.0, -9.81]',
        *(
            f'[[joint]]\nname = "{name}"\ntype = "revolute"\ndh_convention = "classic"\n'
            f"a_m = {a}\nd_m = {d}\nalpha_deg = {alpha}\ntheta_offset_deg = 0.0\n"
            "q_min_deg = -120.0\nq_max_deg = 120.0\n"
            f"qd_max_deg_s = 40.0\nqdd_max_deg_s2 = 90.0\nvelocity_gain_rad_s = {GAIN[j]}\n"
            f"valve_frequency_hz = {WN[j] / (2 * np.pi)}\nvalve_damping = {ZETA}\nkp_frac_per_rad = {KP[j]}\n"
            f"pt1_tau_s = 0.0\nmass_kg = {mass}\ncom_m = {com}\nencoder_counts_rev = {COUNTS}"
            for j, (name, a, d, alpha, mass, com) in enumerate(
                (("slew", 0.0, 0.8, 90.0, 300.0, [0.0, 0.0, 0.0]), ("boom", 2.5, 0.0, 0.0, 200.0, [-1.2, 0.0, 0.0]))
            )
        ),
        f"[plc]\ncycle_s = {CYCLE_S}\nlog_cycle_s = {LOG_S}\ntransport_delay_s = {DELAY_S}",
        "[points]\ntip = { joint = 2, xyz_m = [0.0, 0.0, 0.0] }",
        "[tracker]\nT_base_tracker = [1.0,0,0,0, 0,1.0,0,0, 0,0,1.0,0, 0,0,0,1.0]",
        f"[camera]\nwidth_px = {WIDTH}\nheight_px = {HEIGHT}\nfx_px = {PIXELS}\nfy_px = {PIXELS}\n"
        f"cx_px = {WIDTH / 2}\ncy_px = {HEIGHT / 2}\ndistortion = [0.0, 0.0, 0.0, 0.0, 0.0]\n"
        f"baseline_m = {BASELINE}\nrate_hz = 10.0\nrectified = true\n"
        "T_tcp_cam_left = [0.0,0,1.0,0, 0,-1.0,0,0, 1.0,0,0,0, 0,0,0,1.0]",
        '[markers]\ndictionary = "DICT_4X4_50"',
        *(
            f'[[markers.marker]]\nid = {number}\nside_m = {SIDE}\non = "ooi"\n'
            f"T_on_marker = [1.0,0,0,{x}, 0,1.0,0,{y}, 0,0,1.0,0, 0,0,0,1.0]"
            for number, (x, y) in enumerate(PLACES)
        ),
        "[tool]\nT_flange_tcp = [1.0,0,0,0, 0,1.0,0,0, 0,0,1.0,0, 0,0,0,1.0]",
    ]
)


@dataclass(frozen=True)
class Fault:
    """What is wrong with the plant, each at nothing; (2,) per joint."""

    deadband: tuple[float, float] = (0.0, 0.0)
    lag_s: tuple[float, float] = (0.0, 0.0)
    gain: tuple[float, float] = (0.0, 0.0)
    asymmetry: tuple[float, float] = (0.0, 0.0)
    hysteresis: tuple[float, float] = (0.0, 0.0)
    kp: tuple[float, float] = (0.0, 0.0)
    saturation: tuple[float, float] = (1.0, 1.0)
    delay_s: float = 0.0
    quantum: float = 0.0
    backlash: tuple[float, float] = (0.0, 0.0)  # behind the encoders
    length_m: float = 0.0  # of the boom
    sag_rad_nm: float = 0.0  # of the boom's joint
    bias: tuple[float, float] = (0.0, 0.0)  # of the encoders
    focal: float = 0.0  # of the camera, share
    camera_late_s: float = 0.0  # stamps later than the exposure
    mount_rad: float = 0.0  # of the camera about its own x
    trolley_m: float = 0.0  # foreign: the tip slides sideways with the slewing angle's third multiple
    spool_rate: tuple[float, float] = (np.inf, np.inf)  # foreign: largest speed of the spool [1/s]
    warming: float = 0.0  # foreign: flow gain drifts by this share a minute
    gear: tuple[float, float] = (0.0, 0.0)  # foreign: speed ripple, 23 periods a turn... in share of the speed


def reference(kind: str, t: np.ndarray, seed: int = 0) -> np.ndarray:
    """Command (m, 2) [rad] that starts and ends at rest."""
    fade = np.clip(np.minimum(t, t[-1] - t) / 1.0, 0.0, 1.0)[:, None]
    rates = np.array([1.1, 0.83])
    x = t[:, None] * rates
    if kind == "steps":
        level = np.sign(np.sin(0.9 * x)) * (0.4 + 0.6 * np.abs(np.sin(0.31 * x + seed)))
        return START + fade * 0.12 * level
    if kind == "workcycle":
        return START + fade * 0.25 * np.clip(1.6 * np.sin(0.5 * x + 0.3), -1.0, 1.0)
    if kind == "sweep":
        return START + fade * 0.06 * np.sin(x * (0.4 + 0.06 * t[:, None]))
    return START + fade * (0.1 * np.sin(x) + 0.05 * np.sin(2.7 * x + 1.0) + 0.02 * np.sin(6.1 * x))


def run(kind: str, fault: Fault, rng: np.random.Generator, seconds: float, t0: float, noise: float, log: tuple) -> dict:
    """One segment: PLC rows and sent rows. `log`: seconds between rows, and the encoders' counts in a turn."""
    per, cycles = round(CYCLE_S / STEP_S), round(seconds / CYCLE_S)
    t_sent = np.arange(0.0, seconds, SENT_S)
    sent = reference(kind, t_sent)
    dead, lag, hyst, rate = map(np.array, (fault.deadband, fault.lag_s, fault.hysteresis, fault.spool_rate))
    up, limit = 1.0 + np.array(fault.asymmetry), np.array(fault.saturation)
    gain = GAIN * (1.0 + np.array(fault.gain))
    faults = np.array([dead, lag, hyst, rate, up, limit, KP * (1.0 + np.array(fault.kp)), gain, np.array(fault.gear)])
    shock = rng.normal(0.0, noise, (cycles, 2))
    rows = _stepped(
        cycles, per, sent, DELAY_S + fault.delay_s, fault.quantum, faults, fault.warming / 60.0, t0, shock, *log
    )
    return {"plc": rows.tolist(), "sent": [(t0 + t + OFFSET_S, *row) for t, row in zip(t_sent, sent, strict=True)]}


@njit(cache=True)
def _stepped(cycles, per, sent, delay, quantum, faults, warming, t0, shock, log_s, counts):
    """Rows time, ref (2,), encoder (2,), command (2,), number of the reference, true angle (2,)."""
    dead, lag, hyst, rate, up, limit, kp, gain, gear = faults
    every, step = round(log_s / CYCLE_S), 2.0 * np.pi / counts
    rows = np.zeros(((cycles - 1) // every + 1, 10))
    q, x, xd, slow, play, wind, u = np.concatenate((START, np.zeros(12))).reshape(7, 2)
    for k in range(cycles):
        t = k * CYCLE_S
        number = min(max(int(np.floor((t - delay) / SENT_S + 1e-9)), 0), len(sent) - 1)
        for j in range(2):
            ref = sent[number, j] if quantum == 0.0 else np.round(sent[number, j] / quantum) * quantum
            enc = np.round(q[j] / step) * step
            u[j] = min(max(kp[j] * (ref - enc), -limit[j]), limit[j])
            if k % every == 0:
                rows[k // every, 0], rows[k // every, 7] = t0 + t, number
                rows[k // every, 1 + j], rows[k // every, 3 + j], rows[k // every, 5 + j] = ref, enc, u[j]
                rows[k // every, 8 + j] = q[j]
            wind[j] = 0.995 * wind[j] + shock[k, j]
            share = 1.0 - np.exp(-STEP_S / lag[j]) if lag[j] > 0.0 else 1.0
            now = gain[j] * (1.0 + warming * (t0 + t))
            for _ in range(per):
                play[j] = min(max(play[j], u[j] - hyst[j]), u[j] + hyst[j])
                slow[j] += share * (play[j] - slow[j])
                half = xd[j] + 0.5 * STEP_S * (WN[j] ** 2 * (slow[j] - x[j]) - 2 * ZETA * WN[j] * xd[j])
                middle = x[j] + 0.5 * STEP_S * xd[j]
                xd[j] += STEP_S * (WN[j] ** 2 * (slow[j] - middle) - 2 * ZETA * WN[j] * half)
                xd[j] = min(max(xd[j], -rate[j]), rate[j])
                x[j] += STEP_S * min(max(half, -rate[j]), rate[j])
                opening = max(abs(x[j]) - dead[j], 0.0) / (1.0 - dead[j])
                speed = now * (opening * up[j] if x[j] > 0.0 else -opening)
                q[j] += STEP_S * (speed * (1.0 + gear[j] * np.sin(23.0 * q[j])) + wind[j])
    return rows


def tip(q: np.ndarray, fault: Fault) -> np.ndarray:
    """Where the tip is (m, 3) [m] at true joint angles (m, 2): slewing about z at 0.8 m, boom of 2.5 m."""
    weight = 200.0 * 9.81 * 1.3 * np.cos(q[:, 1])  # the boom's centre of mass is 1.3 m out
    boom = q[:, 1] - fault.sag_rad_nm * weight
    reach, length = np.cos(boom), 2.5 + fault.length_m
    out = np.stack([np.cos(q[:, 0]) * reach, np.sin(q[:, 0]) * reach, np.sin(boom)], axis=1) * length
    side = fault.trolley_m * np.sin(7.0 * q[:, 0])
    return out + np.array([0.0, 0.0, 0.8]) + side[:, None] * np.stack([-np.sin(q[:, 0]), np.cos(q[:, 0]), 0 * side], 1)


def tracked(rows: list, fault: Fault, rng: np.random.Generator, noise_m: float) -> list:
    """Tip at 20 Hz, of joints behind their backlash."""
    q = np.array([row[8:10] for row in rows])
    link, half = q.copy(), 0.5 * np.array(fault.backlash)
    for k in range(1, len(q)):
        link[k] = np.minimum(np.maximum(link[k - 1], q[k] - half), q[k] + half)
    points = tip(link, fault) + rng.normal(0.0, noise_m, (len(q), 3))
    return [(rows[k][0], "tip", *points[k]) for k in range(0, len(q), 5)]


R_TCP_CAM = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])  # looks along the boom, its y down


def tcp(q: np.ndarray) -> np.ndarray:
    """Pose of the tip (4, 4): x along the boom, z along the boom's axis of turning."""
    c1, s1, c2, s2 = np.cos(q[0]), np.sin(q[0]), np.cos(q[1]), np.sin(q[1])
    R = np.array([[c1 * c2, -c1 * s2, s1], [s1 * c2, -s1 * s2, -c1], [s2, c2, 0.0]])
    return np.vstack([np.c_[R, 2.5 * R[:, 0] + [0.0, 0.0, 0.8]], [0.0, 0.0, 0.0, 1.0]])


def seen(rows: list, fault: Fault, rng: np.random.Generator, noise_px: float) -> list:
    """Corners of four markers, 3.5 m before the tip as it starts, in both eyes at 10 Hz; the camera's clock is ours."""
    T_tcp_cam = np.eye(4)
    c, s = np.cos(fault.mount_rad), np.sin(fault.mount_rad)
    T_tcp_cam[:3, :3] = R_TCP_CAM @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    T_object = np.eye(4)
    T_object[:3, :3], T_object[:3, 3] = R_TCP_CAM @ np.diag([1.0, -1.0, -1.0]), [3.5, 0.0, 0.0]
    T_base_object = tcp(START) @ T_object
    t, q = np.array([row[0] for row in rows]), np.array([row[8:10] for row in rows])
    square = 0.5 * SIDE * np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
    out = []
    for when in np.arange(t[0] + 0.1, t[-1] - 0.1, 0.1):
        now = np.array([np.interp(when, t, q[:, j]) for j in range(2)])
        T = np.linalg.inv(tcp(now) @ T_tcp_cam) @ T_base_object
        for number, place in enumerate(PLACES):
            points = np.c_[square + place, np.zeros(4)] @ T[:3, :3].T + T[:3, 3]
            for eye, shift in (("left", 0.0), ("right", BASELINE)):
                xy = (points[:, :2] - [shift, 0.0]) / points[:, 2:] * PIXELS * (1.0 + fault.focal)
                pixels = xy + np.array([WIDTH / 2, HEIGHT / 2]) + rng.normal(0.0, noise_px, (4, 2))
                out.append((when + fault.camera_late_s + OFFSET_S, eye, number, *pixels.ravel()))
    return out


def poses(fault: Fault, rng: np.random.Generator, count: int, noise_m: float) -> list:
    """Poses at rest with the tip's place; every third pose is measured again at the end."""
    q = np.stack([rng.uniform(-1.5, 1.5, count), rng.uniform(-0.4, 1.2, count)], axis=1)
    q = np.concatenate([q, q[::3]])
    points = tip(q - np.array(fault.bias), fault) + rng.normal(0.0, noise_m, (len(q), 3))
    return [(k, *q[k], "tip", *points[k]) for k in range(len(q))]


KINDS = ("repeat", "repeat", "repeat", "repeat", "steps", "workcycle", "sweep")


def write(
    folder: Path,
    fault: Fault,
    seed: int = 1,
    seconds: float = 20.0,
    noise: float = 2e-5,
    kinds: tuple = KINDS,
    tracker_m: float = 0.0,
    static: int = 0,
    camera_px: float = 0.0,
    log_s: float = LOG_S,
    counts: int = COUNTS,
) -> Path:
    """A recording folder as the format says. `tracker_m`: noise of a tracker, 0 without; `static`: poses
    at rest; `camera_px`: noise of marker corners, 0 without; `log_s`: between logged rows; `counts`: encoders'."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "machine.toml").write_text(_machine(log_s, counts) + "\n", encoding="utf-8")
    plc, sent, places, corners, segments, first = [], [], [], [], [], 0
    for number, kind in enumerate(kinds):
        t0 = number * (seconds + 1.0)
        made = run(kind, fault, rng, seconds, t0, noise, (log_s, counts))
        plc += [(*row[:7], first + int(row[7])) for row in made["plc"]]
        sent += [(row[0], first + k, *row[1:]) for k, row in enumerate(made["sent"])]
        first += len(made["sent"])
        corners += seen(made["plc"], fault, rng, camera_px) if camera_px > 0.0 else []
        places += tracked(made["plc"], fault, rng, tracker_m) if tracker_m > 0.0 else []
        again = '\nrepeat_of = "A"' if kind == "repeat" else ""
        segments.append(
            f'[[segment]]\nname = "{kind}{number}"\nkind = "{kind}"\nt_start_plc_s = {t0!r}\n'
            f"t_end_plc_s = {made['plc'][-1][0]!r}{again}\n"
        )
    head = '[run]\nname = "made up"\nstarted_utc = "2026-01-01T00:00:00Z"\nseed = 1\nformat_version = 1\n'
    clocks = f"[clocks]\nplc_to_pc_offset_s = {OFFSET_S}\ncamera_to_pc_offset_s = 0.0\n"
    (folder / "run.toml").write_text(head + clocks + "\n".join(segments), encoding="utf-8")
    names = ["t_plc_s", *(f"{n}_{j}_{u}" for n, u in (("q_ref", "rad"), ("q", "rad"), ("u", "frac")) for j in (1, 2))]
    place = ["point", "x_m", "y_m", "z_m"]
    if places:
        _csv(folder / "tracker.csv", ["t_plc_s", *place], places)
    if corners:
        pixels = [f"{axis}{k}_px" for k in range(4) for axis in "uv"]
        _csv(folder / "markers.csv", ["t_camera_s", "eye", "marker_id", *pixels], corners)
    if static:
        found = poses(fault, rng, static, 2e-4)
        _csv(folder / "static.csv", ["pose_index", "q_1_rad", "q_2_rad", *place], found)
    if not plc:
        return folder
    _csv(folder / "plc.csv", [*names, "seq_received"], plc)
    _csv(folder / "sent.csv", ["t_pc_s", "seq", "q_sent_1_rad", "q_sent_2_rad"], sent)
    return folder


def rewritten(place: Path, change: Callable[[list], None] | None = None, without: tuple[str, ...] = ()) -> Path:
    """The folder with its PLC's rows (dicts of text) changed in place, and without columns that begin so."""
    with (place / "plc.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    if change is not None:
        change(rows)
    names = [name for name in rows[0] if not any(name.startswith(one) for one in without)]
    _csv(place / "plc.csv", names, [[row[name] for name in names] for row in rows])
    return place


def _machine(log_s: float, counts: int) -> str:
    text = MACHINE.replace(f"log_cycle_s = {LOG_S}", f"log_cycle_s = {log_s}")
    return text.replace(f"encoder_counts_rev = {COUNTS}", f"encoder_counts_rev = {counts}")


def _csv(path: Path, names: list, rows: list) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows(rows)
