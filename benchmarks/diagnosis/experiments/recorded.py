"""Recordings of the bench's machines: runs of joints, tours of postures with looks, poses with measured points."""

from dataclasses import dataclass

import numpy as np

from benchmarks.diagnosis.experiments import arm, plant
from benchmarks.diagnosis.experiments.arm import Link, Truth
from diagnosis.experiments.library import Experiment, Motion
from machine.rotations import Array
from recording.content import Recording
from recording.rows import MarkerCorners, PlcState, Row, Sent, StaticPoint
from recording.run import RunInfo, Segment, SegmentKind

SAMPLE_S = 0.01
OFFSET_S = 3.0
TOUR_S, DWELL_S, LOOKS_S = 8.0, 5.0, (0.5, 2.4, 4.4)
ROW_S = 0.05
NONE: tuple[float, ...] = ()
NAN = float("nan")


@dataclass(frozen=True)
class Rig:
    """What is measured, and how well. `logged`: signals of the PLC's log; `eyes`: 1 left only, 2 both, 0 none."""

    links: tuple[Link, ...]
    truth: Truth
    T_base_marker: Array
    wind: float = 0.0
    logged: tuple[str, ...] = ("ref", "u")
    eyes: int = 0
    corner_px: float = 0.0
    point_m: float = 0.0


@dataclass(frozen=True)
class Run:
    """A reference (m, n) every 10 ms, as a segment."""

    kind: SegmentKind
    q: Array
    repeat: bool = False


def of_runs(rig: Rig, runs: list[Run], rng: np.random.Generator) -> Recording:
    """Every run from rest, one after the other."""
    rows: list[Row] = []
    segments = []
    start, seq, n = 0.0, 0, len(rig.links)
    for number, run in enumerate(runs):
        log = plant.driven(run.q, SAMPLE_S, rig.truth, rig.wind, rng)
        ref, enc, u = log[:, :n], log[:, n : 2 * n], log[:, 2 * n :]
        for k in range(len(log)):
            t = start + arm.LOG_S * k
            rows.append(_plc(t, enc[k], ref[k] if "ref" in rig.logged else None, u[k] if "u" in rig.logged else None))
        for i, q in enumerate(run.q):
            rows.append(Sent(start + SAMPLE_S * i + OFFSET_S, seq, tuple(q.tolist())))
            seq += 1
        end = start + arm.LOG_S * (len(log) - 1)
        segments.append(Segment(f"{run.kind}{number}", run.kind, start, end, "A" if run.repeat else ""))
        start = end + 1.0
    return _recording(rig, rows, tuple(segments), True)


def of_tour(rig: Rig, postures: Array, rng: np.random.Generator) -> Recording:
    """Encoders in the postures (k, n), three looks at the marker in each."""
    rows: list[Row] = []
    t_end = TOUR_S * len(postures)
    t = np.arange(0.0, t_end - 1e-9, ROW_S)
    for at, q in zip(t, _tour(postures, t), strict=True):
        rows.append(_plc(float(at), q, None, None))
    for k, posture in enumerate(postures):
        T = arm.frames(rig.links, arm.true_angles(rig.links, posture, rig.truth))[-1]
        exact = arm.corners(T, rig.T_base_marker, rig.truth)
        for late in LOOKS_S:
            rows += _look(rig, TOUR_S * k + late, exact, rng)
    segment = Segment("tour", "static", 0.0, float(t[-1]))
    return _recording(rig, rows, (segment,), False)


def of_points(rig: Rig, postures: Array, again: int, rng: np.random.Generator) -> Recording:
    """The tip measured in each posture (k, n); the first `again` once more at the end."""
    rows: list[Row] = []
    for k, q in enumerate(np.concatenate([postures, postures[:again]])):
        tip = arm.frames(rig.links, arm.true_angles(rig.links, q, rig.truth))[-1][:3, 3]
        x, y, z = (tip + rng.normal(0.0, rig.point_m, 3)).tolist()
        rows.append(StaticPoint(k, tuple(q.tolist()), "tip", x, y, z))
    return _recording(rig, rows, (), False)


def executed(rig: Rig, experiment: Experiment, rng: np.random.Generator) -> Recording:
    """What the machine records of a proposed experiment."""
    if isinstance(experiment, Motion):
        return of_runs(rig, [Run(experiment.segment_kind, experiment.q)], rng)
    if rig.eyes:
        return of_tour(rig, experiment.q, rng)
    return of_points(rig, experiment.q, 0, rng)


def _tour(postures: Array, t: Array) -> Array:
    k = np.minimum((t / TOUR_S).astype(int), len(postures) - 1)
    following = postures[np.minimum(k + 1, len(postures) - 1)]
    u = np.clip((t - TOUR_S * k - DWELL_S) / (TOUR_S - DWELL_S), 0.0, 1.0)[:, None]
    return postures[k] + (3.0 * u**2 - 2.0 * u**3) * (following - postures[k])


def _look(rig: Rig, t_plc_s: float, exact: Array, rng: np.random.Generator) -> list[Row]:
    out: list[Row] = []
    for eye, name in zip(range(rig.eyes), ("left", "right"), strict=False):
        pixels = exact[eye] + rng.normal(0.0, rig.corner_px, (4, 2))
        inside = (pixels > 3.0).all() and (pixels < np.array([arm.WIDTH, arm.HEIGHT]) - 4.0).all()
        if np.isfinite(pixels).all() and inside:
            out.append(MarkerCorners(t_plc_s + OFFSET_S, name, 0, *pixels.ravel().tolist()))
    return out


def _plc(t: float, enc: Array, ref: Array | None, u: Array | None) -> PlcState:
    columns = [NONE if one is None else tuple(one.tolist()) for one in (ref, enc, u)]
    return PlcState(t, -1, columns[0], NONE, columns[1], columns[2], NONE, NONE, NAN, NAN)


def _recording(rig: Rig, rows: list[Row], segments: tuple[Segment, ...], driven: bool) -> Recording:
    run = RunInfo("bench", "2026-01-01T00:00:00Z", None, OFFSET_S, 0.0, None, segments)
    return Recording("folder", run, arm.machine_toml(rig.links, driven), tuple(rows))
