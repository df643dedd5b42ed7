"""Recordings over a link as it is: datagrams that wait and get lost, clocks that drift; numbered as a PLC logs them."""

from dataclasses import dataclass, replace

import numpy as np
from diagnosis_cases import MACHINE_TOML, NOISE_RAD, OFFSET_S, PLANT, SEGMENT_S, reference

from machine.effects.dynamics import drive_by_sent, simulate
from machine.effects.entries import EffectEntry, pack
from recording.content import Recording
from recording.rows import PlcState, Row, Sent
from recording.run import RunInfo, Segment

BEFORE = 25  # datagrams sent before a segment's first row
KINDS = ("repeat", "repeat", "repeat", "repeat", "steps")


@dataclass(frozen=True)
class Link:
    """`jitter_s`: mean of an exponential wait beside `delay_s`. `drift`: of the PC's clock. `sent_ms`: between two."""

    jitter_s: float = 0.0
    delay_s: float = 0.0
    drift: float = 0.0
    loss_frac: float = 0.0
    sent_ms: int = 4
    log_cycles: int = 10


def arrived(link: Link, t_s: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Which of the datagrams sent at t_s (k,) come, and when."""
    when = np.maximum.accumulate(t_s + link.delay_s + rng.exponential(link.jitter_s, len(t_s)))
    there = rng.random(len(t_s)) >= link.loss_frac
    there[:2] = True
    which = np.nonzero(there)[0]
    return which, when[which]


def over(link: Link, effects: tuple[EffectEntry, ...] = (), seed: int = 1) -> Recording:
    """Four repeats of one command, and its steps."""
    rng = np.random.default_rng(seed)
    plant = replace(PLANT, log_cycle_s=link.log_cycles * PLANT.cycle_s)
    cycles = round(SEGMENT_S / plant.cycle_s)
    t_s = 1e-3 * link.sent_ms * np.arange(-BEFORE, round(1e3 * SEGMENT_S / link.sent_ms))
    sent: list[Row] = []
    logged: list[Row] = []
    segments = []
    for number, kind in enumerate(KINDS):
        start, first = number * (SEGMENT_S + 1.0), 1 + 20000 * number
        q = reference(kind, np.maximum(t_s, 0.0))
        which, when = arrived(link, t_s, rng)
        traces = simulate(plant, pack(effects, 6), drive_by_sent(plant, when, q[which], 0.0, cycles))
        enc = traces.enc[0] + rng.normal(0.0, NOISE_RAD, traces.enc[0].shape)
        t_log = plant.log_cycle_s * np.arange(len(enc))
        seen = which[np.searchsorted(when, t_log + 1e-9, side="right") - 1]
        logged += [
            PlcState(
                t_plc_s=float(start + t),
                seq_received=int(first + k),
                q_ref_rad=tuple(ref.tolist()),
                qd_ref_rad_s=(),
                q_rad=tuple(q_enc.tolist()),
                u_frac=tuple(u.tolist()),
                p_a_pa=(),
                p_b_pa=(),
                p_supply_pa=float("nan"),
                t_oil_c=float("nan"),
            )
            for t, k, ref, q_enc, u in zip(t_log, seen, traces.ref[0], enc, traces.u[0], strict=True)
        ]
        stamps = OFFSET_S + (start + t_s) * (1.0 + link.drift)
        sent += [Sent(float(t), first + k, tuple(q[k].tolist())) for k, t in enumerate(stamps)]
        end = start + SEGMENT_S - plant.log_cycle_s
        segments.append(Segment(f"{kind}{number}", kind, start, end, "A" if kind == "repeat" else ""))
    info = RunInfo("made up", "2026-01-01T00:00:00Z", seed, OFFSET_S, 0.0, None, tuple(segments))
    machine = MACHINE_TOML.replace("log_cycle_s = 0.01\n", f"log_cycle_s = {plant.log_cycle_s:g}\n")
    return Recording("folder", info, machine, (*sent, *logged))
