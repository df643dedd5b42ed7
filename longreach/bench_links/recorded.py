"""Recordings over a link as it is: datagrams that wait and get lost, clocks that drift; numbered as a PLC logs them.

The machine is the reduced model that the diagnosis replays: what it leaves is the link's and the encoders' noise.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machine.effects.dynamics import Traces, actuators_of, drive_by_sent, simulate
from machine.effects.entries import EffectEntry, pack
from machine.rotations import Array
from recording.content import Recording
from recording.rows import PlcState, Row, Sent
from recording.run import RunInfo, Segment
from server.settings import read_machine, read_machine_text

MACHINE_TOML = read_machine_text("hiab033")
PLANT = actuators_of(read_machine("hiab033"))
JOINTS = 6
Q_START = np.array([0.3, 0.5, -1.0, 0.2, 0.8, -0.4])
OFFSET_S = 5.0  # t_pc = t_plc + 5 s
NOISE_RAD = 2e-5
SEGMENT_S = 12.0
BEFORE = 25  # datagrams sent before a segment's first row
KINDS = ("repeat", "repeat", "repeat", "repeat", "steps")
RATES = np.array([1.3, 0.9, 1.1, 1.9, 1.6, 2.2])


@dataclass(frozen=True)
class Link:
    """`jitter_s`: mean of an exponential wait beside `delay_s`. `drift`: of the PC's clock. `sent_ms`: between two."""

    jitter_s: float = 0.0
    delay_s: float = 0.0
    drift: float = 0.0
    loss_frac: float = 0.0
    sent_ms: int = 4
    log_cycles: int = 10

    @property
    def usual_delay_s(self) -> float:
        """What half of the datagrams take at most."""
        return self.delay_s + float(np.log(2.0)) * self.jitter_s


def arrived(link: Link, t_s: Array, rng: np.random.Generator) -> tuple[NDArray[np.int64], Array]:
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
    t_s = 1e-3 * link.sent_ms * np.arange(-BEFORE, round(1e3 * SEGMENT_S / link.sent_ms), dtype=np.float64)
    sent: list[Row] = []
    logged: list[Row] = []
    segments = []
    for number, kind in enumerate(KINDS):
        start, first = number * (SEGMENT_S + 1.0), 1 + 20000 * number
        q = command(kind, np.maximum(t_s, 0.0))
        which, when = arrived(link, t_s, rng)
        traces = simulate(plant, pack(effects, JOINTS), drive_by_sent(plant, when, q[which], 0.0, cycles))
        enc = traces.enc[0] + rng.normal(0.0, NOISE_RAD, traces.enc[0].shape)
        t_log = plant.log_cycle_s * np.arange(len(enc), dtype=np.float64)
        seen = which[np.searchsorted(when, t_log + 1e-9, side="right") - 1]
        logged += logged_rows(start + t_log, first + seen, traces, enc)
        stamps = OFFSET_S + (start + t_s) * (1.0 + link.drift)
        sent += [Sent(float(t), first + k, tuple(q[k].tolist())) for k, t in enumerate(stamps)]
        end = start + SEGMENT_S - plant.log_cycle_s
        segments.append(Segment(f"{kind}{number}", kind, start, end, "A" if kind == "repeat" else ""))
    info = RunInfo("made up", "2026-01-01T00:00:00Z", seed, OFFSET_S, 0.0, None, tuple(segments))
    machine = MACHINE_TOML.replace("log_cycle_s = 0.01\n", f"log_cycle_s = {plant.log_cycle_s:g}\n")
    return Recording("folder", info, machine, (*sent, *logged))


def logged_rows(t_plc_s: Array, seq: NDArray[np.int64], traces: Traces, enc: Array) -> list[Row]:
    """The PLC's rows at t_plc_s (m,), with the last datagram's number (m,) and what the encoders showed (m, n)."""
    return [
        PlcState(
            t_plc_s=float(t),
            seq_received=int(number),
            q_ref_rad=tuple(ref.tolist()),
            qd_ref_rad_s=(),
            q_rad=tuple(q_enc.tolist()),
            u_frac=tuple(u.tolist()),
            p_a_pa=(),
            p_b_pa=(),
            p_supply_pa=float("nan"),
            t_oil_c=float("nan"),
        )
        for t, number, ref, q_enc, u in zip(t_plc_s, seq, traces.ref[0], enc, traces.u[0], strict=True)
    ]


def command(kind: str, t: Array) -> Array:
    """A command (m, 6) [rad] that starts and ends at rest."""
    fade = np.clip(np.minimum(t, SEGMENT_S - t) / 1.0, 0.0, 1.0)[:, None]
    if kind == "steps":
        return Q_START + fade * 0.05 * np.sign(np.sin(t[:, None] * RATES))
    return Q_START + fade * 0.08 * (np.sin(t[:, None] * RATES) + 0.3 * np.sin(3.7 * t[:, None] * RATES))
