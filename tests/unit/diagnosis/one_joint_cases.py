"""One joint in closed loop by a loop of its own (no kernel of ours): what its log looks like, as a folder."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SPEED, WN, DAMPING, KP, TAU_S = 0.5, 2.0 * np.pi * 12.0, 0.8, 4.0, 0.1
CYCLE_S, STEPS = 2e-3, 8
SECONDS = 14.0


@dataclass(frozen=True)
class Machine:
    """How it is driven, disturbed, logged and spoilt."""

    kinds: tuple[str, ...] = ("repeat", "multisine", "repeat", "steps", "repeat", "sweep", "repeat")
    log_every: int = 5
    disturbance_rad_s: float = 2e-4
    disturbance_s: float = 0.2
    noise_rad: float = 5e-6
    prismatic: bool = False
    gain: Callable[[float], float] = lambda _t: 1.0
    wave: Callable[[float], float] = lambda _q: 0.0
    speed_rad_s: float = SPEED
    valve_hz: float = WN / 2.0 / np.pi
    kp: float = KP
    tau_s: float = TAU_S
    play_frac: float = 0.0  # half width of the spool's hysteresis
    ahead: float = 0.0  # share of the reference's own speed that is fed forward
    dead_frac: float = 0.0  # taken off every opening
    push: Callable[[float], float] = lambda _t: 0.0  # rad/s by which it creeps
    oil_hz: float | None = None  # of the swing by which what moves follows the valve; None: it follows at once


def reference(kind: str, t: np.ndarray) -> np.ndarray:
    """A command (m,) from rest to rest; jumps fall between logged rows."""
    fade = np.clip(np.minimum(t, SECONDS - t), 0.0, 1.0)
    slow = 0.12 * np.sin(1.1 * t) + 0.05 * np.sin(2.9 * t + 1.0) + 0.02 * np.sin(7.1 * t)
    jumps = 0.08 * np.sign(np.sin(1.7 * t + 0.3))
    if kind == "repeat":
        return fade * np.where(t < 0.5 * SECONDS, slow, jumps)
    return fade * {"multisine": slow[::-1], "steps": jumps, "sweep": 0.2 * np.sin(0.25 * t * t)}[kind]


def recorded(place: Path, machine: Machine, seed: int = 1) -> Path:
    """The folder: plc.csv, machine.toml, run.toml."""
    rng, unit = np.random.default_rng(seed), "m" if machine.prismatic else "rad"
    rows, segments = [], []
    for number, kind in enumerate(machine.kinds):
        start = 100.0 + number * (SECONDS + 1.0)
        ref = reference(kind, CYCLE_S * np.arange(round(SECONDS / CYCLE_S)))
        rows += _run(machine, ref, start, rng)
        end = start + SECONDS - CYCLE_S * machine.log_every
        repeat = 'repeat_of = "A"' if kind == "repeat" else ""
        segments.append(
            f'[[segment]]\nname = "s{number}"\nkind = "{kind}"\nt_start_plc_s = {start}\nt_end_plc_s = {end}\n{repeat}'
        )
    kind = "prismatic" if machine.prismatic else "revolute"
    header = f"t_plc_s,q_ref_1_{unit},q_1_{unit},u_1_frac"
    (place / "plc.csv").write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    (place / "run.toml").write_text("\n".join(['[run]\nname = "one joint"', *segments]), encoding="utf-8")
    (place / "machine.toml").write_text(
        f'[machine]\nname = "one joint"\n[[joint]]\nname = "lift"\ntype = "{kind}"\n'
        f"velocity_gain_rad_s = {machine.speed_rad_s}\nvalve_frequency_hz = {machine.valve_hz}\n"
        f"valve_damping = {DAMPING}\nkp_frac_per_rad = {machine.kp}\npt1_tau_s = {machine.tau_s}\n"
        f"[plc]\ncycle_s = {CYCLE_S}\nlog_cycle_s = {CYCLE_S * machine.log_every}\ntransport_delay_s = 0.0\n",
        encoding="utf-8",
    )
    return place


def _run(machine: Machine, ref: np.ndarray, start: float, rng: np.random.Generator) -> list[str]:
    """Logged rows of one segment: the nominal model of shared definition, and what spoils it.

    In plain floats: numpy's scalars take ten times as long in this loop.
    """
    dt, fade, wn = CYCLE_S / STEPS, float(np.exp(-CYCLE_S / machine.disturbance_s)), 2.0 * np.pi * machine.valve_hz
    q = x = xd = lagged = pushed = swung = swung_d = spool = before = 0.0
    share, rows = 1.0 - float(np.exp(-CYCLE_S / machine.tau_s)) if machine.tau_s > 0.0 else 1.0, []
    shock = float(np.sqrt(1.0 - fade**2))
    stiffness, damping = wn * wn, 2.0 * DAMPING * wn
    drawn = rng.normal(0.0, [machine.noise_rad, machine.disturbance_rad_s], (len(ref), 2)).tolist()
    for k, (wanted, (noise, disturbance)) in enumerate(zip(ref.tolist(), drawn, strict=True)):
        t = start + k * CYCLE_S
        enc = q + float(machine.wave(q)) + noise
        lagged += share * (machine.kp * (wanted - enc) - lagged)
        fed = machine.ahead * (wanted - (before if k else wanted)) / CYCLE_S / machine.speed_rad_s
        before = wanted
        u = min(max(lagged + fed, -1.0), 1.0)
        if k % machine.log_every == 0:
            rows.append(f"{t:.6f},{wanted:.9f},{enc:.9f},{u:.9f}")
        spool = min(max(spool, u - machine.play_frac), u + machine.play_frac)
        pushed = fade * pushed + shock * disturbance
        gain, push = machine.speed_rad_s * float(machine.gain(t)), float(machine.push(t))
        for _ in range(STEPS):
            xd += dt * (stiffness * (spool - x) - damping * xd)
            x += dt * xd
            opening = max(abs(x) - machine.dead_frac, 0.0)
            speed = gain * (opening if x > 0.0 else -opening) + push
            if machine.oil_hz is not None:
                w = 2.0 * np.pi * machine.oil_hz
                swung_d += dt * (w * w * (speed - swung) - 2.0 * 0.1 * w * swung_d)
                swung += dt * swung_d
                speed = swung
            q += dt * (speed + pushed)
    return rows
