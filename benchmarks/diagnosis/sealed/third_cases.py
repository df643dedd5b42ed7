"""The third plant's machines and cases: nominal numbers of each machine, and which effects it has, with their sizes.

Sizes are those of a machine that nobody has measured; an entry is {name, joint, parameters} as in a machine file.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.diagnosis.sealed.third_arm import Array

Rng = np.random.Generator
Entry = dict[str, Any]
LOADED, WITH_PT1 = (2, 3), (2, 3)
FEWEST, MOST = 8, 20  # effects of a machine with many
STAGES = {
    "time": ("clock_offset", "clock_drift"),
    "link": ("transport_delay", "packet_loss", "reference_quantisation", "reference_rate_limit"),
    "controller": ("controller_gain_error", "controller_lag_error", "controller_saturation"),
    "actuator": (
        "valve_deadband", "valve_lag", "valve_hysteresis", "valve_asymmetry", "flow_gain_error", "supply_droop",
        "internal_leakage", "load_droop", "stiction", "spool_rate_limit", "thermal_gain_drift", "cable_tug",
    ),
    "joint": ("backlash", "encoder_bias", "encoder_scale", "encoder_eccentricity", "gear_eccentricity"),
    "structure": (
        "gravity_sag", "link_length_error", "base_tilt", "base_compliance", "payload_error", "link_flexibility",
        "joint_axis_tilt",
    ),
    "camera": (
        "focal_length_error", "principal_point_error", "lens_distortion", "marker_size_error", "hand_eye_rotation",
        "hand_eye_translation", "stereo_misalignment", "camera_latency", "rolling_shutter", "loose_marker",
    ),
}  # fmt: skip
STAGE = {name: stage for stage, names in STAGES.items() for name in names}


def _between(rng: Rng, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


def _signed(rng: Rng, low: float, high: float) -> float:
    return float(rng.uniform(low, high) * rng.choice((-1.0, 1.0)))


def _normal(rng: Rng, sd: float, least: float) -> float:
    """Normal with this standard deviation, at least `least` in size: below it nothing could be seen."""
    while True:
        value = float(rng.normal(0.0, sd))
        if abs(value) >= least:
            return value


def _direction(rng: Rng, dims: int) -> list[float]:
    v = rng.normal(size=dims)
    return [float(x) for x in v / np.linalg.norm(v)]


def _length(rng: Rng, joint: int) -> Entry:
    return {
        "error_m": _normal(rng, 0.004, 0.0008),
        "of": "a" if joint in (2, 3) else "d" if joint > 3 else _either(rng),
    }


def _either(rng: Rng) -> str:
    return "a" if rng.uniform() < 0.5 else "d"


@dataclass(frozen=True)
class Kind:
    """One effect: its joints (None: the machine; (): all), its weight in a draw at each place, its parameters."""

    name: str
    joints: tuple[int, ...] | None
    weight: float
    draw: Callable[[Rng, int], Entry]


CATALOGUE = (
    Kind("valve_deadband", (), 0.0, lambda r, _: {"half_width_frac": _between(r, 0.01, 0.04)}),
    Kind("valve_hysteresis", (), 0.0, lambda r, _: {"half_width_frac": _between(r, 0.001, 0.008)}),
    Kind("flow_gain_error", (), 0.8, lambda r, _: {"gain_frac": _signed(r, 0.03, 0.15)}),
    Kind("valve_asymmetry", (), 0.4, lambda r, _: {"gain_frac": _signed(r, 0.03, 0.12)}),
    Kind("valve_lag", (), 0.4, lambda r, _: {"time_constant_s": _between(r, 0.015, 0.08)}),
    Kind("internal_leakage", LOADED, 0.5, lambda r, _: {"drift_rad_s": _between(r, 0.0005, 0.003)}),
    Kind("load_droop", LOADED, 0.6, lambda r, _: {"droop_frac": _between(r, 0.05, 0.2)}),
    Kind("supply_droop", None, 0.6, lambda r, _: {"flow_limit_frac": _between(r, 0.3, 0.7)}),
    Kind("stiction", (), 0.05, lambda r, _: {"breakaway_frac": _between(r, 0.03, 0.06)}),
    Kind("encoder_bias", (), 4.0, lambda r, _: {"bias_rad": _normal(r, 0.005, 0.0008)}),
    Kind("encoder_scale", (), 0.06, lambda r, _: {"scale_frac": _signed(r, 0.001, 0.005)}),
    Kind(
        "encoder_eccentricity", (), 0.06,
        lambda r, _: {
            "amplitude_rad": _between(r, 0.0008, 0.003), "order": float(r.integers(1, 3)),
            "phase_rad": _between(r, -3.0, 3.0),
        },
    ),
    Kind("backlash", (), 0.25, lambda r, _: {"width_rad": _between(r, 0.0006, 0.003)}),
    Kind("gravity_sag", LOADED, 12.0, lambda r, _: {"compliance_rad_nm": _between(r, 0.5e-6, 2.5e-6)}),
    Kind("link_length_error", (), 1.3, _length),
    Kind(
        "joint_axis_tilt", (2, 3, 4, 5, 6), 0.4,
        lambda r, joint: {"tilt_rad": _normal(r, 0.002, 4e-4), "about": _xy(r, joint)},
    ),
    Kind(
        "base_tilt", None, 1.0, lambda r, _: {"tilt_rad": _between(r, 0.001, 0.006), "axis": [*_direction(r, 2), 0.0]}
    ),
    Kind("base_compliance", None, 0.8, lambda r, _: {"compliance_rad_nm": _between(r, 0.3e-7, 2.0e-7)}),
    Kind("payload_error", None, 0.5, lambda r, _: {"mass_kg": _between(r, 8.0, 60.0)}),
    Kind(
        "link_flexibility", LOADED, 0.05,
        lambda r, _: {
            "gain": _between(r, 0.15, 0.5), "frequency_hz": _between(r, 1.5, 4.0), "damping": _between(r, 0.03, 0.1)
        },
    ),
    Kind("transport_delay", None, 0.5, lambda r, _: {"delay_s": 0.01 * float(r.integers(1, 5))}),
    Kind("packet_loss", None, 0.1, lambda r, _: {"loss_frac": _between(r, 0.01, 0.1)}),
    Kind("reference_quantisation", (), 0.02, lambda r, _: {"step_rad": _between(r, 0.0005, 0.003)}),
    Kind("reference_rate_limit", (), 0.02, lambda r, _: {"rate_rad_s": _between(r, 0.05, 0.12)}),
    Kind("controller_gain_error", (), 0.4, lambda r, _: {"gain_frac": _signed(r, 0.04, 0.2)}),
    Kind("controller_lag_error", WITH_PT1, 0.3, lambda r, _: {"lag_frac": _signed(r, 0.08, 0.4)}),
    Kind("controller_saturation", (), 0.02, lambda r, _: {"limit_frac": _between(r, 0.12, 0.3)}),
    Kind(
        "hand_eye_rotation", None, 14.0, lambda r, _: {"angle_rad": _between(r, 0.005, 0.04), "axis": _direction(r, 3)}
    ),
    Kind(
        "hand_eye_translation", None, 10.0,
        lambda r, _: {"distance_m": _between(r, 0.003, 0.015), "direction": _direction(r, 3)},
    ),
    Kind("camera_latency", None, 8.0, lambda r, _: {"latency_s": _between(r, 0.02, 0.08)}),
    Kind("focal_length_error", None, 1.5, lambda r, _: {"scale_frac": _signed(r, 0.003, 0.015)}),
    Kind("marker_size_error", None, 1.0, lambda r, _: {"scale_frac": _signed(r, 0.003, 0.015)}),
    Kind(
        "principal_point_error", None, 0.4,
        lambda r, _: {"shift_px": _between(r, 1.0, 6.0), "direction": _direction(r, 2)},
    ),
    Kind("lens_distortion", None, 0.3, lambda r, _: {"k1": _signed(r, 0.005, 0.03)}),
    Kind(
        "stereo_misalignment", None, 0.4,
        lambda r, _: {"angle_rad": _between(r, 0.0005, 0.004), "axis": _direction(r, 3)},
    ),
    Kind("rolling_shutter", None, 0.2, lambda r, _: {"readout_s": _between(r, 0.008, 0.025), "stamp_row": 0.0}),
    Kind("clock_offset", None, 0.0, lambda r, _: {"offset_s": _signed(r, 0.02, 0.08)}),
    Kind("clock_drift", None, 0.1, lambda r, _: {"rate_ppm": _signed(r, 80.0, 400.0), "zero_s": 0.0}),
)  # fmt: skip
FOREIGN = (
    Kind(  # slower ones make the controller of that joint hunt by centimetres
        "spool_rate_limit", (), 1.0,
        lambda r, joint: {"rate_frac_s": _between(r, 0.9, 1.6) if joint <= 3 else _between(r, 0.3, 0.9)},
    ),
    Kind(
        "thermal_gain_drift", (), 1.0,
        lambda r, _: {"gain_frac": _signed(r, 0.1, 0.3), "time_constant_s": _between(r, 60.0, 200.0)},
    ),
    Kind(
        "gear_eccentricity", (), 1.0,
        lambda r, _: {"amplitude_rad": _between(r, 0.0008, 0.004), "order": float(r.integers(9, 40))},
    ),
    Kind(
        "cable_tug", (), 1.0,
        lambda r, _: {"speed_rad_s": _between(r, 0.003, 0.015), "from_rad": 0.0, "side": float(r.choice((-1.0, 1.0)))},
    ),
    Kind(
        "loose_marker", None, 1.0,
        lambda r, _: {
            "marker": int(r.integers(0, 3)), "slip_m": _between(r, 0.004, 0.02), "from_frac": _between(r, 0.3, 0.6),
        },
    ),
)  # fmt: skip
BY_NAME = {kind.name: kind for kind in (*CATALOGUE, *FOREIGN)}


def _xy(rng: Rng, joint: int) -> str:
    """About x or y; behind a twist of 90 degrees y is the axis of the joint before, whose zero moves the tip alike."""
    drawn = "x" if rng.uniform() < 0.5 else "y"
    return drawn if joint == 3 else "x"


def machine_of(rng: Rng, n: int) -> dict[str, Any]:
    """A nominal machine as in the shared recordings, its numbers varied by some per cent; n = 6, 4 or 3 joints."""
    vary = lambda value, share=0.08: round(float(value * rng.uniform(1.0 - share, 1.0 + share)), 4)  # noqa: E731
    a, d = [vary(0.16), vary(1.95), vary(0.14), 0.0, 0.0, 0.0], [vary(1.75), 0.0, 0.0, vary(2.1), 0.0, vary(0.55)]
    gain, mass = [vary(g) for g in (0.5, 0.45, 0.55, 1.2, 1.2, 1.5)], [vary(k) for k in (150, 190, 140, 30, 40, 40)]
    com = [
        [-0.5 * a[0], -0.5 * d[0], 0.0], [-0.5 * a[1], 0.0, 0.0], [-0.5 * a[2], 0.0, 0.0], [0.0, -0.5 * d[3], 0.0],
        [0.0, 0.0, 0.0], [0.0, -0.5 * d[5], 0.0],
    ]  # fmt: skip
    ranges = ((-170, 170), (-25, 80), (-145, -5), (-170, 170), (-110, 110), (-170, 170))
    frequency, damping = round(float(rng.uniform(9.0, 15.0)), 1), round(float(rng.uniform(0.7, 0.9)), 2)
    joints = [
        {
            "name": f"joint{j + 1}", "type": "revolute", "dh_convention": "classic", "a_m": a[j], "d_m": d[j],
            "alpha_deg": (90, 0, 90, 90, -90, 90)[j], "theta_offset_deg": 90 if j == 2 else 0,
            "q_min_deg": ranges[j][0], "q_max_deg": ranges[j][1], "qd_max_deg_s": round(float(np.rad2deg(gain[j])), 4),
            "qdd_max_deg_s2": 120.0, "velocity_gain_rad_s": gain[j], "valve_frequency_hz": frequency,
            "valve_damping": damping, "kp_frac_per_rad": (6.0, 8.0, 8.0, 4.0, 4.0, 4.0)[j],
            "pt1_tau_s": 0.15 if j in (1, 2) else 0.0,
            "mass_kg": mass[j], "com_m": com[j], "encoder_counts_rev": 262144,
        }
        for j in range(n)
    ]  # fmt: skip
    T_flange_tcp = np.eye(4)
    if n == 3:  # the tilt boom ends in the tool: its length and its weight belong to the third link
        T_flange_tcp[2, 3] = d[3]
        joints[2]["com_m"] = [-0.5 * a[2], 0.0, round(0.45 * d[3], 4)]
    T_tcp_cam = np.eye(4)
    T_tcp_cam[:3, 3] = 0.0, -0.15, -0.35
    return {
        "machine": {"name": f"third-{n}", "gravity_base_m_s2": [0.0, 0.0, -9.81]},
        "joint": joints,
        "tool": {"T_flange_tcp": T_flange_tcp.ravel().tolist(), "T_tcp_tool": np.eye(4).ravel().tolist()},
        "camera": {
            "width_px": 1280, "height_px": 720, "fx_px": 528.0, "fy_px": 528.0, "cx_px": 640.0, "cy_px": 360.0,
            "distortion": [0.0] * 5, "baseline_m": 0.12, "rate_hz": 20.0, "rectified": True,
            "T_tcp_cam_left": T_tcp_cam.ravel().tolist(),
        },
        "markers": {"dictionary": "DICT_4X4_50", "marker": [_marker(k) for k in range(3)]},
        "points": {"tip": {"joint": n, "xyz_m": _on_flange(T_flange_tcp, (0.0, 0.0, 0.0))},
                   "side": {"joint": n, "xyz_m": _on_flange(T_flange_tcp, (0.3, 0.0, -0.2))}},
        "plc": {"cycle_s": 0.01, "log_cycle_s": 0.01, "transport_delay_s": 0.01},
        "tracker": {"T_base_tracker": np.eye(4).ravel().tolist()},
    }  # fmt: skip


def _on_flange(T_flange_tcp: Array, place: tuple[float, float, float]) -> list[float]:
    return (T_flange_tcp[:3, :3] @ np.array(place) + T_flange_tcp[:3, 3]).tolist()


def _marker(k: int) -> dict[str, Any]:
    angle, x, y, z = ((0.0, 0.0, 0.25, 0.0), (0.35, -0.25, -0.12, 0.03), (-0.6, 0.25, -0.12, -0.02))[k]
    c, s = float(np.cos(angle)), float(np.sin(angle))
    T = [c, -s, 0.0, x, s, c, 0.0, y, 0.0, 0.0, 1.0, z, 0.0, 0.0, 0.0, 1.0]
    return {"id": 10 + k, "side_m": 0.15, "on": "ooi", "T_on_marker": T}


def home_of(rng: Rng, n: int) -> Array:
    """Where the recorded motion begins and ends (n,) [rad]; varied from machine to machine."""
    return np.deg2rad(np.array([10.0, 35.0, -75.0, 0.0, 40.0, 0.0]) + rng.uniform(-8.0, 8.0, 6))[:n]


def working_range(n: int) -> tuple[Array, Array]:
    """Lowest and highest angles (n,) [rad] of the poses that are measured at rest."""
    low = np.deg2rad([-50.0, 5.0, -115.0, -60.0, -10.0, -90.0])
    high = np.deg2rad([70.0, 65.0, -37.0, 60.0, 90.0, 90.0])
    return low[:n], high[:n]


def draw_many(rng: Rng, n: int) -> list[Entry]:
    """A dead band in every valve, hysteresis in about half of them, and more effects: FEWEST to MOST in all."""
    joints = range(1, n + 1)
    places: list[tuple[Kind, int | None]] = [(BY_NAME["valve_deadband"], joint) for joint in joints]
    places += [(BY_NAME["valve_hysteresis"], joint) for joint in joints if rng.uniform() < 0.5]
    more = int(rng.integers(max(FEWEST, len(places) + 4), MOST + 1)) - len(places)
    others = [(kind, joint) for kind in CATALOGUE if kind.weight > 0.0 for joint in _places(kind, n)]
    weights = np.array([kind.weight for kind, _ in others])
    chosen = rng.choice(len(others), size=more, replace=False, p=weights / weights.sum())
    places += [others[k] for k in sorted(chosen)]
    entries = [_entry(kind, joint, rng) for kind, joint in places]
    if rng.uniform() < 0.5:  # valves that do not close tight: the shared recordings' let 2 % through inside the band
        for entry in entries:
            entry |= {"detail": {"in_band_frac": 0.02}} if entry["name"] == "valve_deadband" else {}
    return entries


def draw_one(rng: Rng, n: int, kinds: tuple[Kind, ...], number: int) -> Entry:
    """One effect at one place; each kind has its turn by the case's number."""
    kind = kinds[number % len(kinds)]
    places = _places(kind, n)
    return _entry(kind, places[int(rng.integers(0, len(places)))], rng)


def _places(kind: Kind, n: int) -> list[int | None]:
    if kind.joints is None:
        return [None]
    return [joint for joint in (kind.joints or range(1, n + 1)) if joint <= n]


def _entry(kind: Kind, joint: int | None, rng: Rng) -> Entry:
    return {"name": kind.name, "joint": joint, "parameters": kind.draw(rng, joint or 0)}
