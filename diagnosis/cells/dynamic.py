"""Cells of link, controller and actuator: 20 Hz increments of measured less replayed, white by the repeats' noise."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.log.tables import fill_gaps
from diagnosis.noise.floor import BLOCK_DURATION_S, Floor, Whitener, block_means
from diagnosis.replay.read_off import candidates_within_log, read_off
from diagnosis.replay.replayer import PreparedStretch, Replayer, measured_output
from diagnosis.replay.stage_floor import at_noise, stage_floor
from diagnosis.replay.stage_replay import START_SKIPPED_INCREMENTS, Replay, StretchReplay, part_of, white_rows
from diagnosis.replay.stretches import Stretch
from diagnosis.search.candidates import (
    ENCODER_VISIBLE_EFFECTS,
    SUPPLY_DROOP_EFFECT,
    Candidate,
    candidates_of,
    candidates_of_effects,
)
from diagnosis.search.cell import Cell, ResidualRows, blocks_of, folds_of
from diagnosis.sliding import unit_of
from machine.effects.layout import ParameterSets
from machine.remainder import Remainder
from machine.rotations import Array

# What a remainder of the dynamic stages may go with: commands, motion, time, other joints.
BLOCK_MOTION_MIN_RAD = 1e-4  # within a block


def regressors_of(
    parts: tuple[StretchReplay, ...], joints: list[int], order: int, skipped: int, rows_of: list[int]
) -> tuple[tuple[tuple[str, Array], ...], Array]:
    """What a remainder may go with, at the residuals' rows."""
    by_name: dict[str, list[Array]] = {}
    times: list[Array] = []
    for part, rows in zip(parts, rows_of, strict=True):
        one, dt = part.stretch, part.stretch.dt_s
        position = one.enc if one.enc is not None else one.ref
        q = block_means(fill_gaps(position) if position is not None else part.measured_output, dt)
        u = block_means(fill_gaps(one.u), dt) if one.u is not None else np.zeros_like(q)
        t = one.t_s[0] + max(BLOCK_DURATION_S, dt) * np.arange(len(q))
        skip = 1 + order + skipped
        for j in joints:
            moves = BLOCK_MOTION_MIN_RAD if one.enc_step is None else max(BLOCK_MOTION_MIN_RAD, float(one.enc_step[j]))
            for name, values in _explanatory_signals(q, u, t - one.t_s[0], j, moves).items():
                by_name.setdefault(name, []).append(values[skip : skip + rows])
            times.append(t[skip : skip + rows])
    return tuple((name, np.concatenate(values)) for name, values in by_name.items()), np.concatenate(times)


def _explanatory_signals(q: Array, u: Array, t: Array, j: int, moves: float) -> dict[str, Array]:
    """`moves`: change within a block [rad] from which a joint moves: a step of its encoder is in the residual, too."""
    v, du = np.gradient(q[:, j]), np.gradient(u[:, j])
    others = np.delete(np.abs(u), j, axis=1).sum(axis=1)
    way = np.sign(np.where(np.abs(v) > moves, v, 0.0))
    turning = np.abs(np.gradient(way))
    return {
        "command": u[:, j],
        "size of the command": np.abs(u[:, j]),
        "change of the command": du,
        "fast change of the command": du * np.abs(du),
        "cube of the command": u[:, j] ** 3,
        "sign of motion": way,
        "reversals": turning * np.sign(np.gradient(v)),
        "position": q[:, j],
        "speed times position": v * (q[:, j] - q[:, j].mean()),
        "time": t,
        "speed times time": v * (t - t.mean()),
        "other joints' commands": others,
        "speed times other joints' commands": v * (others - others.mean()),
    }


STAGE_UNITS = {"link": "rad", "controller": "1", "actuator": "rad/s"}
MIXED_JOINTS_UNIT = "noise floors"  # where some joints turn and others slide


def stage_cells(
    stage: str, replayer: Replayer, stretches: tuple[Stretch, ...], base: ParameterSets, course: ParameterSets
) -> list[Cell]:
    """The cells of one stage that the stretches allow: the link as one, controller and actuator joint by joint.

    Args: course: what is known of the stages before, for the inputs' course between logged rows.
    """
    prepared = [replayer.prepare(stretch, course) for stretch in stretches]
    some = [
        entry for entry in prepared if stage in entry.stage_inputs and measured_output(stage, entry.stretch) is not None
    ]
    if not some:
        return []
    floor = stage_floor(replayer, stage, some, base)
    seen = [j for j in range(replayer.nominal_machine.n) if all(_has_replay_signals(stage, entry, j) for entry in some)]
    groups = [tuple(seen)] if stage == "link" else [(j,) for j in seen]
    cells = (cell_of(stage, joints, some, floor, base, replayer) for joints in groups if joints)
    return [replace(cell, upstream_parameters=course) for cell in cells]


def coupled_cell(
    replayer: Replayer, stretches: tuple[Stretch, ...], base: ParameterSets, course: ParameterSets
) -> Cell | None:
    """All joints' actuators together, for what couples them: the pump's sharing."""
    some = [entry for entry in (replayer.prepare(s, course) for s in stretches) if "actuator" in entry.stage_inputs]
    n = replayer.nominal_machine.n
    if not some or n < 2 or not all(_has_replay_signals("actuator", entry, j) for entry in some for j in range(n)):
        return None
    floor = stage_floor(replayer, "actuator", some, base)
    cell = cell_of("actuator", tuple(range(n)), some, floor, base, replayer)
    return replace(cell, candidates=candidates_of_effects((SUPPLY_DROOP_EFFECT,), ()))


def _has_replay_signals(stage: str, one: PreparedStretch, j: int) -> bool:
    """Whether everything that a joint's replay needs was recorded."""
    needed = {
        "link": (one.stretch.ref,),
        "controller": (one.stretch.ref, one.stretch.enc, one.stretch.u),
        "actuator": (one.stretch.u, one.stretch.enc),
    }[stage]
    return all(signal is not None and bool(np.isfinite(signal[:, j]).all()) for signal in needed)


def cell_of(
    stage: str,
    joints: tuple[int, ...],
    prepared: list[PreparedStretch],
    floor: Floor,
    base: ParameterSets,
    replayer: Replayer,
) -> Cell:
    """One cell of a stage: these joints (0-based) over all prepared stretches."""
    chosen = list(joints)
    white = floor.whitener.of_channels(chosen)
    parts = tuple(part_of(stage, entry, chosen, replayer) for entry in prepared)
    replay = Replay(stage, joints, parts, white)
    kinds = [part.stretch.segment_kind for part in parts]
    per_channel = [white_rows(part, white.lag_count) for part in parts]
    blocks_by_part, folds_by_part = layout_of(kinds, per_channel)
    spread = [np.tile(numbers, len(chosen)) for numbers in blocks_by_part]
    folds = [np.tile(numbers, len(chosen)) for numbers in folds_by_part]
    channel = [np.repeat(np.arange(len(chosen)), rows) for rows in per_channel]
    series = [k * len(chosen) + numbers for k, numbers in enumerate(channel)]
    rows = ResidualRows(*(np.concatenate(numbers).astype(np.int64) for numbers in (folds, spread, series, channel)))
    per_second = 1.0 / BLOCK_DURATION_S if stage == "actuator" else 1.0
    units = {unit_of(STAGE_UNITS[stage], replayer.nominal_machine.joint_slides, j) for j in joints}
    one_unit = len(units) == 1
    scale = (floor.increment_rms[chosen] * per_second)[rows.channel] if one_unit else np.ones(rows.row_count)
    regressors, t_s = regressors_of(parts, chosen, white.lag_count, START_SKIPPED_INCREMENTS, per_channel)
    one_based = tuple(j + 1 for j in joints)
    whole = stage == "link" or len(joints) > 1
    known = [replayer.nominal_machine.baseline_remainder(stage, j + 1) for j in joints]

    def again(noise: Whitener) -> Cell:
        return cell_of(stage, joints, prepared, at_noise(floor, chosen, noise), base, replayer)

    return Cell(
        stage=stage,
        joint=None if whole else one_based[0],
        unit=units.pop() if one_unit else MIXED_JOINTS_UNIT,
        candidates=_dynamic_candidates(stage, one_based, prepared, replayer),
        baseline_parameters=base,
        whitened=replay,
        rows=rows,
        scale=scale,
        quiet=float(np.mean(floor.deviation_rms[chosen] ** 2)),
        floor_known=floor.is_measured,
        regressors=regressors,
        t_s=t_s,
        baseline_gain_nats=usual_of(known),
        at_noise=None if floor.is_measured or stage != "actuator" or any(known) else again,
    )


def usual_of(known: Sequence[Remainder | None]) -> tuple[tuple[str, float], ...] | None:
    """What each effect gains on baseline recordings, the most of any joint [nats]; None without a baseline."""
    some = [record for record in known if record is not None]
    most: dict[str, float] = {}
    for record in some:
        for name, nats in record.usual:
            most[name] = max(most.get(name, 0.0), nats)
    return tuple(most.items()) if some else None


def layout_of(kinds: list[str], lengths: list[int]) -> tuple[list[NDArray[np.int64]], list[NDArray[np.int64]]]:
    """Blocks and folds of each piece."""
    blocks, _ = blocks_of(lengths)
    folds, _ = folds_of(kinds, lengths, blocks)
    cuts = np.cumsum(lengths)[:-1]
    return np.split(blocks, cuts), np.split(folds, cuts)


def _dynamic_candidates(
    stage: str, joints: tuple[int, ...], prepared: list[PreparedStretch], replayer: Replayer
) -> tuple[Candidate, ...]:
    machine = stage == "link"
    found = candidates_of(stage, joints, machine)  # pyright: ignore[reportArgumentType]
    if stage == "link":
        found = read_off(found, tuple(entry.stretch for entry in prepared))
        plant = replayer.plant
        cycles = (plant.cycle_s, plant.transport_delay_s)
        found = tuple(
            replace(candidate, cycle_and_delay_s=cycles) if candidate.name == "transport_delay" else candidate
            for candidate in found
        )
    if stage == "controller":
        found = candidates_within_log(found, tuple(entry.stretch for entry in prepared))
    if stage == "actuator":
        found = tuple(
            candidate for candidate in found if candidate.name != SUPPLY_DROOP_EFFECT
        ) + candidates_of_effects(ENCODER_VISIBLE_EFFECTS, joints)
    loaded = replayer.torque_reference
    return tuple(candidate for candidate in found if is_effect_possible(candidate, replayer, loaded))


def is_effect_possible(one: Candidate, replayer: Replayer, loaded: Array | None) -> bool:
    """Whether a machine can have an effect at all: no droop without load, no lag error without a lag."""
    if one.joint is None:
        return True
    if one.name in ("load_droop", "internal_leakage"):
        return loaded is not None and bool(np.isfinite(loaded[one.joint - 1]))
    return one.name != "controller_lag_error" or bool(replayer.plant.joints[one.joint - 1, 4] > 0.0)
