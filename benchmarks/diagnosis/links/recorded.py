"""Recordings over a link as it is: datagrams that wait and get lost, clocks that drift; numbered as a PLC logs them.

The machine is the reduced model that the diagnosis replays: what it leaves is the link's and the encoders' noise.
"""

import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machine.effects.dynamics import SimulatedTraces, actuators_of, drive_by_sent, simulate
from machine.effects.entries import EffectEntry, pack_effects
from machine.rotations import Array
from recording.content import Recording
from recording.rows import PlcState, Row, Sent
from recording.run import RunInfo, Segment, SegmentKind
from server.settings import read_machine, read_machine_text

MACHINE_TOML = read_machine_text("hiab033")
PLANT = actuators_of(read_machine("hiab033"))
JOINTS = 6
SECTION = re.compile(r"\n(?=\[)")
Q_START = np.array([0.3, 0.5, -1.0, 0.2, 0.8, -0.4])
OFFSET_S = 5.0  # t_pc = t_plc + 5 s
NOISE_RAD = 2e-5
PAUSE_S = 1.0  # between two segments
NUMBERS = 20_000  # between the first datagrams of two segments, at least
BEFORE = 25  # datagrams sent before a segment's first row
RATES = np.array([1.3, 0.9, 1.1, 1.9, 1.6, 2.2])
SLOWER = 0.37  # a work cycle


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


@dataclass(frozen=True)
class Course:
    """What is commanded: a segment of each kind, and how many joints there are; the first ones of the crane."""

    kinds: tuple[SegmentKind, ...] = ("repeat", "repeat", "repeat", "repeat", "steps")
    segment_s: float = 12.0
    joints: int = JOINTS

    def command(self, kind: SegmentKind, t: Array) -> Array:
        """A command (m, joints) [rad] that starts and ends at rest."""
        fade = np.clip(np.minimum(t, self.segment_s - t) / 1.0, 0.0, 1.0)[:, None]
        start = Q_START[: self.joints]
        phase = t[:, None] * RATES[: self.joints] * (SLOWER if kind == "workcycle" else 1.0)
        if kind == "steps":
            return start + fade * 0.05 * np.sign(np.sin(phase))
        return start + fade * 0.08 * (np.sin(phase) + 0.3 * np.sin(3.7 * phase))

    def machine_toml(self, log_cycle_s: float) -> str:
        """The machine file of that many joints; of the whole arm with its tool, camera and markers."""
        text = MACHINE_TOML.replace("log_cycle_s = 0.01\n", f"log_cycle_s = {log_cycle_s:g}\n")
        if self.joints == JOINTS:
            return text
        parts = SECTION.split(text)
        joints = [one for one in parts if one.startswith("[[joint]]")][: self.joints]
        machine, plc = (next(one for one in parts if one.startswith(head)) for head in ("[machine]", "[plc]"))
        return "\n".join([machine, *joints, plc])


FIVE = Course()


def arrived(link: Link, t_s: Array, rng: np.random.Generator) -> tuple[NDArray[np.int64], Array]:
    """Which of the datagrams sent at t_s (k,) come, and when."""
    when = np.maximum.accumulate(t_s + link.delay_s + rng.exponential(link.jitter_s, len(t_s)))
    there = rng.random(len(t_s)) >= link.loss_frac
    there[:2] = True
    which = np.nonzero(there)[0]
    return which, when[which]


def over(link: Link, effects: tuple[EffectEntry, ...] = (), seed: int = 1, course: Course = FIVE) -> Recording:
    """The course as it is logged; all segments called repeat share one command."""
    rng = np.random.default_rng(seed)
    plant = replace(PLANT, joints=PLANT.joints[: course.joints], log_cycle_s=link.log_cycles * PLANT.cycle_s)
    cycles = round(course.segment_s / plant.cycle_s)
    t_s = 1e-3 * link.sent_ms * np.arange(-BEFORE, round(1e3 * course.segment_s / link.sent_ms), dtype=np.float64)
    numbers = max(NUMBERS, len(t_s))
    sent: list[Row] = []
    logged: list[Row] = []
    segments = []
    for number, kind in enumerate(course.kinds):
        start, first = number * (course.segment_s + PAUSE_S), 1 + numbers * number
        q = course.command(kind, np.maximum(t_s, 0.0))
        which, when = arrived(link, t_s, rng)
        traces = simulate(
            plant, pack_effects(effects, course.joints), drive_by_sent(plant, when, q[which], 0.0, cycles)
        )
        enc = traces.enc[0] + rng.normal(0.0, NOISE_RAD, traces.enc[0].shape)
        t_log = plant.log_cycle_s * np.arange(len(enc), dtype=np.float64)
        seen = which[np.searchsorted(when, t_log + 1e-9, side="right") - 1]
        logged += logged_rows(start + t_log, first + seen, traces, enc)
        stamps = OFFSET_S + (start + t_s) * (1.0 + link.drift)
        sent += [Sent(float(t), first + k, tuple(q[k].tolist())) for k, t in enumerate(stamps)]
        end = start + course.segment_s - plant.log_cycle_s
        segments.append(Segment(f"{kind}{number}", kind, start, end, "A" if kind == "repeat" else ""))
    info = RunInfo("made up", "2026-01-01T00:00:00Z", seed, OFFSET_S, 0.0, None, tuple(segments))
    return Recording("folder", info, course.machine_toml(plant.log_cycle_s), (*sent, *logged))


def logged_rows(t_plc_s: Array, seq: NDArray[np.int64], traces: SimulatedTraces, enc: Array) -> list[Row]:
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
