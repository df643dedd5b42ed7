"""Recordings made by the reduced-order model itself, with noise: small, seeded, and easy to spoil."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from machine.description import parse_machine_toml
from machine.effects.dynamics import Actuators, actuators_of, drive_by_sent, simulate
from machine.effects.entries import EffectEntry, pack
from recording.content import Recording
from recording.folder import write_folder
from recording.rows import PlcState, Row, Sent
from recording.run import RunInfo, Segment

MACHINE_TOML = (Path(__file__).parents[3] / "machine" / "machines" / "hiab033.toml").read_text(encoding="utf-8")
MACHINE = parse_machine_toml(MACHINE_TOML)
PLANT = actuators_of(MACHINE)
Q_START = np.array([0.3, 0.5, -1.0, 0.2, 0.8, -0.4])
OFFSET_S = 5.0  # t_pc = t_plc + 5 s
NOISE_RAD = 2e-5
SEGMENT_S = 12.0


def reference(kind: str, t: np.ndarray) -> np.ndarray:
    """A command (m, 6) [rad] that starts and ends at rest."""
    rates = np.array([1.3, 0.9, 1.1, 1.9, 1.6, 2.2])
    fade = np.clip(np.minimum(t, SEGMENT_S - t) / 1.0, 0.0, 1.0)[:, None]
    if kind == "steps":
        return Q_START + fade * 0.05 * np.sign(np.sin(t[:, None] * rates))
    return Q_START + fade * 0.08 * (np.sin(t[:, None] * rates) + 0.3 * np.sin(3.7 * t[:, None] * rates))


def run_segment(
    kind: str,
    rng: np.random.Generator,
    effects: tuple[EffectEntry, ...],
    t_start: float,
    plant: Actuators = PLANT,
    noise_rad: float = NOISE_RAD,
) -> tuple[list[Row], list[Row]]:
    """Sent and logged rows of one segment on the PLC's clock from t_start."""
    cycles = round(SEGMENT_S / PLANT.cycle_s)
    t_cycle = PLANT.cycle_s * np.arange(cycles)
    sent = reference(kind, t_cycle[::4])
    traces = simulate(plant, pack(effects, 6), drive_by_sent(plant, t_cycle[::4], sent, 0.0, cycles))
    enc = traces.enc[0] + rng.normal(0.0, noise_rad, traces.enc[0].shape)
    t_log = t_start + PLANT.log_cycle_s * np.arange(len(enc))
    first = 1 + round(t_start * 1000)
    logged: list[Row] = [
        PlcState(
            t_plc_s=float(t_log[k]),
            seq_received=first + (k * 10) // 4,
            q_ref_rad=tuple(traces.ref[0, k].tolist()),
            qd_ref_rad_s=(),
            q_rad=tuple(enc[k].tolist()),
            u_frac=tuple(traces.u[0, k].tolist()),
            p_a_pa=(),
            p_b_pa=(),
            p_supply_pa=float("nan"),
            t_oil_c=float("nan"),
        )
        for k in range(len(enc))
    ]
    posted: list[Row] = [
        Sent(float(t_start + 0.004 * i + OFFSET_S), first + i, tuple(sent[i].tolist())) for i in range(len(sent))
    ]
    return posted, logged


def recording(
    kinds: tuple[str, ...] = ("repeat", "repeat", "repeat", "repeat", "steps"),
    effects: tuple[EffectEntry, ...] = (),
    seed: int = 1,
    plant: Actuators = PLANT,
    noise_rad: float = NOISE_RAD,
) -> Recording:
    """One segment of each kind, 1 s apart; those called repeat share one command."""
    rng = np.random.default_rng(seed)
    sent: list[Row] = []
    logged: list[Row] = []
    segments = []
    for number, kind in enumerate(kinds):
        start = number * (SEGMENT_S + 1.0)
        posted, rows = run_segment(kind, rng, effects, start, plant, noise_rad)
        sent += posted
        logged += rows
        name, end = f"{kind}{number}", start + SEGMENT_S - PLANT.log_cycle_s
        segments.append(Segment(name, kind, start, end, "A" if kind == "repeat" else ""))
    info = RunInfo("made up", "2026-01-01T00:00:00Z", seed, OFFSET_S, 0.0, None, tuple(segments))
    return Recording("folder", info, MACHINE_TOML, (*sent, *logged))


def folder(tmp_path: Path, made: Recording) -> Path:
    """The recording as a folder."""
    write_folder(made, tmp_path / "run")
    return tmp_path / "run"


def changed(made: Recording, row_type: type[Row], change) -> Recording:
    """The recording with `change(number, row)` in place of each row of one kind (None drops it)."""
    rows: list[Row] = []
    number = 0
    for row in made.rows:
        if not isinstance(row, row_type):
            rows.append(row)
            continue
        new = change(number, row)
        number += 1
        rows += [] if new is None else [new]
    return replace(made, rows=tuple(rows))


def permuted(values: tuple[float, ...], i: int, j: int) -> tuple[float, ...]:
    """Two entries exchanged."""
    out = list(values)
    out[i], out[j] = out[j], out[i]
    return tuple(out)
