"""What to drive next: the motion of a small library that best separates the two leading hypotheses."""

from dataclasses import replace
from typing import Any

import numpy as np

from diagnosis.candidates import put
from diagnosis.cells import Cell
from diagnosis.cells_dynamic import Part, Replay, layout_of, white_rows
from diagnosis.diagnose import CellAnswer, Diagnosis
from diagnosis.fit import fit
from diagnosis.replay import Replayer, replayer_of
from diagnosis.stretches import Stretch
from diagnosis.weigh import SEPARATED_NATS, Key
from machine.effects.dynamics import DynamicStage, drive_actuator, drive_by_sent, simulate
from machine.effects.layout import neutral_sets
from machine.rotations import Array

SECONDS = 60.0
MOVED_SHARE = 0.15  # of the joint's range, at most this much to either side
MOVED_RAD = 0.3
LOG_S = 0.01
BEHIND = "look at a marker, or track a point, from ten postures"
LIBRARY = ("multisine", "steps", "slow reversals", "staircase around zero", "hold under load", "all joints together")


def next_experiment(found: Diagnosis) -> dict[str, Any]:
    """What to drive, how long, which pair it separates, and the nats it should give."""
    live = _live_pair(found)
    replayer = replayer_of(found.whole.nominal) if found.whole.nominal is not None else None
    if live is None or replayer is None:
        return {"what": None, "minutes": None, "separates": [], "expected_nats": None, "why": _idle(found)}
    answer, mine, other = live
    pair = [{"name": name, "joint": joint} for name, joint in (mine, other)]
    if answer.search.cell.stage != "actuator" or not isinstance(answer.search.cell.whitened, Replay):
        return {"what": "steps", "minutes": 1.0, "separates": pair, "expected_nats": None, "why": "not computed"}
    gains = {what: _separation(found, replayer, answer, mine, other, what) for what in LIBRARY}
    best = max(gains, key=lambda what: gains[what])
    if gains[best] < SEPARATED_NATS:
        why = f"no motion tells {mine[0]} from {other[0]} by the encoder; a measurement behind it can"
        behind = {"what": BEHIND, "minutes": 5.0, "separates": pair, "expected_nats": None, "why": why}
        return behind if "encoder" in mine[0] + other[0] else {**behind, "what": None, "why": why.split(" by")[0]}
    return {
        "what": best,
        "minutes": SECONDS / 60.0,
        "separates": pair,
        "expected_nats": float(f"{0.5 * gains[best]:.3g}"),
        "alternatives": {what: float(f"{0.5 * nats:.3g}") for what, nats in gains.items()},
        "why": f"the recording does not tell {mine[0]} from {other[0]}",
    }


def _idle(found: Diagnosis) -> str:
    return "nothing is left to separate" if found.verdict.word in ("none", "effects") else "no pair of names is live"


def _live_pair(found: Diagnosis) -> tuple[CellAnswer, Key, Key] | None:
    """The first class of effects that cannot be told apart; else the two best single names of an undecided cell."""
    for one in found.cells:
        for members in one.same:
            return one, members[0], members[1]
    for one in found.cells:
        best = [
            w.score.fit.hypothesis for w in one.weighed if len(w.score.fit.hypothesis) == 1 and w.probability > 0.02
        ]
        if len(best) > 1:
            return one, best[0][0].key, best[1][0].key
    return None


def _separation(found: Diagnosis, replayer: Replayer, answer: CellAnswer, mine: Key, other: Key, what: str) -> float:
    """T = least |W (f_mine - f_other(theta))|^2 over the other's size, on the nominal machine driven by `what`."""
    cell = _experiment_cell(found, replayer, answer.search.cell, what)
    scores = {one.fit.hypothesis[0].key: one.fit for one in answer.search.scored if len(one.fit.hypothesis) == 1}
    candidates = {one.candidate.key: one for one in answer.search.scans}
    if cell is None or mine not in scores or other not in candidates:
        return 0.0
    truth = scores[mine]
    target = cell.whitened(put(cell.base, truth.hypothesis, truth.theta))[0]
    aimed = replace(cell, whitened=lambda sets: cell.whitened(sets) - target)
    scan = candidates[other]
    start = scores[other].theta if other in scores else scan.thetas[scan.best]
    rival = fit(aimed, (scan.candidate,), start, rounds=4)
    return 2.0 * rival.cost


def _experiment_cell(found: Diagnosis, replayer: Replayer, like: Cell, what: str) -> Cell | None:
    replay = like.whitened
    if not isinstance(replay, Replay):
        return None
    part = _driven(found, replayer, replay.joints, what)
    rows = white_rows(part, replay.whitener.order) * len(replay.joints)
    blocks, folds, _ = layout_of([what], [rows])
    one = np.zeros(rows, np.int64)
    layout = replace(like.rows, fold=folds[0], block=blocks[0], series=one, channel=one)
    return replace(like, whitened=replace(replay, parts=(part,)), rows=layout, regressors=(), t_s=one.astype(float))


def _driven(found: Diagnosis, replayer: Replayer, joints: tuple[int, ...], what: str) -> Part:
    """The nominal machine driven by a motion of the library; its measured output is the nominal one."""
    plant = replayer.at_rate(LOG_S)
    rows = round(SECONDS / LOG_S)
    t = np.asarray(LOG_S * np.arange(rows), dtype=float)
    q = _motion(found, replayer, joints, what, t)
    cycles = (rows - 1) * plant.decimate + 1
    sets = neutral_sets(plant.n)
    traces = simulate(plant, sets, drive_by_sent(plant, t, q, 0.0, cycles))
    loads = replayer.loads(traces.enc[0])
    whole = drive_actuator(plant, traces.u[0], traces.enc[0][0], loads)
    out = simulate(plant, sets, whole, DynamicStage.ACTUATOR).enc[0]
    chosen = list(joints)
    names = ("sent", "ref", "enc", "u", "load", "load_kg")
    cut = {name: np.ascontiguousarray(getattr(whole, name)[:, chosen]) for name in names}
    drive = replace(whole, **cut, enc_start=whole.enc_start[chosen].copy(), u_start=whole.u_start[chosen].copy())
    stretch = Stretch(what, what, "", 0.0, LOG_S, t, None, out, traces.u[0], None, None, None)
    return Part(
        replace(plant, joints=plant.joints[chosen]),
        drive,
        out[:, chosen],
        stretch,
        np.zeros((len(t) // 5 - 1, len(chosen))),
    )


def _motion(found: Diagnosis, replayer: Replayer, joints: tuple[int, ...], what: str, t: Array) -> Array:
    """Reference (m, n) around where the recording's middle was; within 15 % of the joints' ranges."""
    nominal = replayer.nominal
    recorded = [one.enc for one in found.whole.stretches if one.enc is not None]
    centre = np.nanmedian(np.concatenate(recorded), axis=0) if recorded else np.zeros(nominal.n)
    span = np.where(np.isfinite(nominal.q_max - nominal.q_min), nominal.q_max - nominal.q_min, 2.0)
    size = np.minimum(MOVED_SHARE * span, MOVED_RAD)
    moving = np.zeros(nominal.n)
    moving[list(joints)] = 1.0
    if what == "all joints together":
        moving[:] = 1.0
    shapes = np.stack([_shape(what, t, j) for j in range(nominal.n)], axis=1)
    fade = np.clip(np.minimum(t, t[-1] - t), 0.0, 1.0)[:, None]
    return centre + fade * moving * size * shapes


def _shape(what: str, t: Array, j: int) -> Array:
    w = 0.7 + 0.13 * j
    if what == "steps":
        return np.sign(np.sin(w * t)) * (0.3 + 0.7 * np.abs(np.sin(0.29 * w * t)))
    if what == "slow reversals":
        return 0.3 * np.sin(0.15 * w * t)
    if what == "staircase around zero":
        return 0.2 * np.round(4.0 * np.sin(0.2 * w * t)) / 4.0
    if what == "hold under load":
        return np.clip(t / 5.0, 0.0, 1.0)
    return 0.5 * np.sin(w * t) + 0.3 * np.sin(2.3 * w * t + 1.0) + 0.2 * np.sin(5.1 * w * t + 2.0)
