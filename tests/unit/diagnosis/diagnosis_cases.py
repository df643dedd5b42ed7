"""Recordings made by the reduced-order model itself, with noise: small, seeded, and easy to spoil."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.diagnosis.links.recorded import FIVE, MACHINE_TOML, NOISE_RAD, OFFSET_S, PLANT, logged_rows
from machine.description import parse_machine_toml
from machine.effects.dynamics import Actuators, drive_by_sent, simulate
from machine.effects.entries import EffectEntry, make_entry, pack_effects
from machine.effects.registry import effect_named
from recording.content import Recording
from recording.folder import write_folder
from recording.rows import Row, Sent
from recording.run import RunInfo, Segment

MACHINE = parse_machine_toml(MACHINE_TOML)


def entry(name: str, joint: int | None, **parameters: object) -> EffectEntry:
    """An effect of the catalogue with these numbers."""
    effect = effect_named(name)
    assert effect is not None
    return make_entry(effect, joint, parameters)


def run_segment(
    kind: str,
    rng: np.random.Generator,
    effects: tuple[EffectEntry, ...],
    t_start: float,
    plant: Actuators = PLANT,
    noise_rad: float = NOISE_RAD,
) -> tuple[list[Row], list[Row]]:
    """Sent and logged rows of one segment on the PLC's clock from t_start."""
    cycles = round(FIVE.segment_s / PLANT.cycle_s)
    t_cycle = PLANT.cycle_s * np.arange(cycles)
    sent = FIVE.command(kind, t_cycle[::4])
    traces = simulate(plant, pack_effects(effects, 6), drive_by_sent(plant, t_cycle[::4], sent, 0.0, cycles))
    enc = traces.enc[0] + rng.normal(0.0, noise_rad, traces.enc[0].shape)
    t_log = t_start + PLANT.log_cycle_s * np.arange(len(enc))
    first = 1 + round(t_start * 1000)
    logged = logged_rows(t_log, first + (10 * np.arange(len(enc))) // 4, traces, enc)
    posted: list[Row] = [
        Sent(float(t_start + 0.004 * i + OFFSET_S), first + i, tuple(sent[i].tolist())) for i in range(len(sent))
    ]
    return posted, logged


def recording(
    kinds: tuple[str, ...] = FIVE.kinds,
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
        start = number * (FIVE.segment_s + 1.0)
        posted, rows = run_segment(kind, rng, effects, start, plant, noise_rad)
        sent += posted
        logged += rows
        name, end = f"{kind}{number}", start + FIVE.segment_s - PLANT.log_cycle_s
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


SMALL_MM = 2.0  # at the tool: what matters there


def likely(answer: dict[str, Any]) -> list[dict[str, Any]]:
    """Effects of an answer that are more likely there than not and matter at the tool, or whose size there nobody
    knows.
    """
    return [
        one
        for one in answer["budget"]["effects"]
        if one["status"] != "doubtful" and (one["tool_mm"] >= SMALL_MM or not one["column"])
    ]


def confirmed(answer: dict[str, Any]) -> dict[tuple[str, int | None], dict[str, Any]]:
    """The parameters of the confirmed effects of an answer, whatever they do at the tool."""
    return {
        (one["name"], one["joint"]): one["parameters"]
        for one in answer["budget"]["effects"]
        if one["status"] == "confirmed"
    }
