"""Cells of link, controller and actuator: 20 Hz increments of measured less replayed, white by the repeats' noise."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.candidates import SEEN_BY_ENCODER, Candidate, candidates_of, named
from diagnosis.cells import FORM_SHARE, Cell, Rows, blocks_of, folds_of
from diagnosis.day_noise import DayNoise
from diagnosis.errors import DiagnosisError
from diagnosis.floor import (
    BLOCK_S,
    Floor,
    Whitener,
    deviations,
    encoder_step,
    floor_of_repeats,
    floor_without_repeats,
    increments,
    with_remainder,
)
from diagnosis.read_off import read_off
from diagnosis.regressors import regressors_of
from diagnosis.repeats import overlaid
from diagnosis.replay import Prepared, Replayer, measured_output
from diagnosis.side_by_side import side_by_side
from diagnosis.steady_repeats import steadied
from diagnosis.stretches import Stretch, repeat_groups
from diagnosis.tables import filled
from machine.effects.dynamics import Actuators, Drive, DynamicStage, simulate
from machine.effects.kernel import BREAKAWAY
from machine.effects.layout import ParameterSets, neutral_sets
from machine.remainder import Remainder
from machine.rotations import Array

LAST = {"link": DynamicStage.LINK, "controller": DynamicStage.CONTROLLER, "actuator": DynamicStage.ACTUATOR}
OUTPUT = {"link": "ref", "controller": "u", "actuator": "enc"}
UNIT = {"link": "rad", "controller": "1", "actuator": "rad/s"}
SKIPPED = 10  # increments at a stretch's start: the valve's state is not known there
NO_NOISE = 0.2  # of the least sigma: below it repeats are equal but for rounding, and their filter means nothing
SIGMA_MIN = {"link": 2e-5, "controller": 2e-4, "actuator": 2e-6}  # nothing smaller moves the tcp by 0.1 mm
FORM_SHARE_OIL = 0.03  # friction and dead bands of real valves are no single number
TIMING_S = 1.5e-3
PASSES = 3
UNIFORM = 3.0**-0.5  # standard deviation of what lies anywhere between -1 and 1
SILENT = 1e-3  # of every usual test: a program that leaves nothing, day by day
SILENT_SHARE = 0.25  # of the least sigma, there: what is no noise at all adds up along a move
STEP_SHARE = 0.41  # of an encoder's step, sqrt(2 / 12): two roundings, which repeats do not show when they round alike


@dataclass(frozen=True, slots=True)
class Part:
    """One stretch's replay for some joints (0-based): what drives it, and what was measured (rows, joints).

    `between`: (m, joints), how far two guesses of the input's course between logged rows drive the increments apart;
    `unsure`: (m, joints), the same of jumps that each may be anywhere in its row; None where no row hides a jump.
    `moved`: by joint, what is known of its model beyond what has been taken off `measured`, if it moves like a given
    course (m,); empty, or None, where nothing is.
    """

    plant: Actuators
    drive: Drive
    measured: Array
    stretch: Stretch
    between: Array
    unsure: Array | None = None
    moved: tuple[Callable[[Array], Array] | None, ...] = ()


@dataclass(frozen=True, slots=True)
class Replay:
    """The whitened residual of a stage for some joints, over several stretches.

    `day`: what the machine's numbers wander by from day to day, where that is known.
    """

    stage: str
    joints: tuple[int, ...]
    parts: tuple[Part, ...]
    whitener: Whitener
    day: DayNoise | None = None

    def __call__(self, sets: ParameterSets) -> Array:
        """Residuals (sets, N): stretches end to end, channels within each."""
        chosen = ParameterSets(np.ascontiguousarray(sets.joint[:, list(self.joints)]), sets.machine)
        out = np.concatenate(side_by_side(lambda part: self._white(part, chosen), self.parts), axis=1)
        return out if self.day is None else self.day.white(out)

    def _white(self, part: Part, sets: ParameterSets) -> Array:
        steps, shift = part_increments(self.stage, part, sets)
        weight = trust(part, self.whitener)
        white = whiten_sets(self.whitener, steps)[:, SKIPPED:] * weight
        if self.stage == "actuator":
            columns = [whiten_sets(self.whitener, one)[:, SKIPPED:] * weight for one in (part.between[None], shift)]
            white = _excused(white, columns)
        return white.transpose(0, 2, 1).reshape(len(white), -1)


def trust(part: Part, whitener: Whitener) -> Array | float:
    """The weight of rows (1, m, joints): those after a jump that may be anywhere in its row count less.

    Model: 1 / (1 + x^2) over the jump's standard deviation x: beside the noise it tells as much as chance, far above it
           nothing, not one deviation time after time.
    """
    if part.unsure is None:
        return 1.0
    return 1.0 / (1.0 + (UNIFORM * whiten_sets(whitener, part.unsure[None])[:, SKIPPED:]) ** 2)


def _excused(white: Array, columns: list[Array]) -> Array:
    """Residuals without what the log's own coarseness can explain, per set and joint.

    Why: logs are stamped to a cycle, and models stepped at 0.5 and at 1 ms lie as far apart; between two logged rows
    the command's course is a guess. At most once the difference of two guesses, and a shift of at most TIMING_S, are
    no effects. Solved in turn (Gauss-Seidel), the courses first, since each has its own limit: what both can explain
    is theirs.
    """
    amounts = [np.zeros_like(white[:, :1]) for _ in columns]
    left = white
    for _ in range(PASSES):
        for k, (column, most) in enumerate(zip(columns, (1.0, TIMING_S), strict=True)):
            wanted = np.clip(amounts[k] - _share(left, column), -most, most)
            left = left + (wanted - amounts[k]) * column
            amounts[k] = wanted
    return left


def _share(white: Array, column: Array) -> Array:
    """Least-squares amount of a column in the residual, (sets, 1, joints)."""
    power = (column**2).sum(axis=1, keepdims=True)
    return (column * white).sum(axis=1, keepdims=True) / np.where(power > 1e-12, power, np.inf)


def part_increments(stage: str, part: Part, sets: ParameterSets) -> tuple[Array, Array]:
    """20 Hz increments (sets, m, joints) of measured less replayed, and their change per second of delay."""
    traces = simulate(part.plant, sets, part.drive, LAST[stage])
    modelled = getattr(traces, OUTPUT[stage])
    error = part.measured[None, : modelled.shape[1]] - modelled
    for channel, otherwise in enumerate(part.moved):
        if otherwise is None:
            continue
        for k in np.nonzero(sets.joint[:, channel, BREAKAWAY])[0]:
            error[k, :, channel] -= otherwise(modelled[k, :, channel])
    size = max(1, round(BLOCK_S / part.stretch.dt_s))
    rows = error.shape[1] // size * size
    shape = (len(error), -1, size, error.shape[2])
    means = error[:, :rows].reshape(shape).mean(axis=2)
    slopes = np.gradient(modelled[:, :rows], part.stretch.dt_s, axis=1).reshape(shape).mean(axis=2)
    return np.diff(means, axis=1), np.diff(slopes, axis=1)


def whiten_sets(whitener: Whitener, steps: Array) -> Array:
    """White residuals (sets, m - order, n) of increments (sets, m, n)."""
    p = whitener.order
    out = steps[:, p:].copy()
    for i in range(p):
        out -= whitener.a[i] * steps[:, p - 1 - i : steps.shape[1] - 1 - i]
    return out / whitener.sigma


def stage_cells(
    stage: str, replayer: Replayer, stretches: tuple[Stretch, ...], base: ParameterSets, course: ParameterSets
) -> list[Cell]:
    """The cells of one stage that the stretches allow: the link as one, controller and actuator joint by joint.

    Args: course: what is known of the stages before, for the inputs' course between logged rows.
    """
    prepared = [replayer.prepare(one, course) for one in stretches]
    some = [one for one in prepared if stage in one.drives and _measured(stage, one) is not None]
    if not some:
        return []
    floor = stage_floor(replayer, stage, some, base)
    seen = [j for j in range(replayer.nominal.n) if all(_recorded(stage, one, j) for one in some)]
    groups = [tuple(seen)] if stage == "link" else [(j,) for j in seen]
    return [cell_of(stage, joints, some, floor, base, replayer) for joints in groups if joints]


def coupled_cell(
    replayer: Replayer, stretches: tuple[Stretch, ...], base: ParameterSets, course: ParameterSets
) -> Cell | None:
    """All joints' actuators at once, for what couples them: the pump's sharing."""
    some = [one for one in (replayer.prepare(s, course) for s in stretches) if "actuator" in one.drives]
    n = replayer.nominal.n
    if not some or n < 2 or not all(_recorded("actuator", one, j) for one in some for j in range(n)):
        return None
    floor = stage_floor(replayer, "actuator", some, base)
    cell = cell_of("actuator", tuple(range(n)), some, floor, base, replayer)
    return replace(cell, candidates=named(("supply_droop",), ()))


def _measured(stage: str, one: Prepared) -> Array | None:
    return measured_output(stage, one.stretch)


def _recorded(stage: str, one: Prepared, j: int) -> bool:
    """Whether everything that a joint's replay needs was recorded."""
    needed = {
        "link": (one.stretch.ref,),
        "controller": (one.stretch.ref, one.stretch.enc, one.stretch.u),
        "actuator": (one.stretch.u, one.stretch.enc),
    }[stage]
    return all(signal is not None and bool(np.isfinite(signal[:, j]).all()) for signal in needed)


def stage_floor(replayer: Replayer, stage: str, prepared: list[Prepared], base: ParameterSets) -> Floor:
    """The noise of a stage's residual, all joints: from the largest group of repeats, else a stand-in."""
    residuals = {one.stretch.name: replayer.residuals(stage, one, base) for one in prepared}
    known = {name: np.nan_to_num(one[0]) for name, one in residuals.items() if one is not None}
    groups = repeat_groups(tuple(one.stretch for one in prepared))
    members = max(groups.values(), key=len, default=())
    dt = prepared[0].stretch.dt_s
    floor: Floor | None = None
    steps: list[Array] = []
    records = [replayer.nominal.remainder(stage, j + 1) for j in range(replayer.nominal.n)]
    if len(members) > 1:
        try:
            repeats = overlaid(members, [known[one.name] for one in members])
            if stage == "actuator":
                repeats = steadied(
                    repeats, overlaid(members, _encoders(members)), dt, np.array([not one for one in records])
                )
            floor = floor_of_repeats(repeats, dt)
            steps = [increments(one, dt) for one in deviations(repeats)]
        except DiagnosisError:
            floor = None
    if floor is None:
        stand_ins = [floor_without_repeats(one, dt) for one in known.values()]
        sigma = np.median([one.whitener.sigma for one in stand_ins], axis=0)
        floor = replace(stand_ins[0], whitener=Whitener(np.zeros((0, len(sigma))), sigma), increment_rms=sigma)
    least = _smallest(stage, prepared) * np.array([SILENT_SHARE if _silent(one) else 1.0 for one in records])
    floor = _not_below(floor, least)
    if not any(records):
        return floor
    ar = np.zeros((max(len(one.ar) for one in records if one is not None), len(records)))
    for j, one in enumerate(records):
        if one is not None:
            ar[: len(one.ar), j] = one.ar
    sigma, rms = (np.array([getattr(one, name) if one else 0.0 for one in records]) for name in ("sigma", "rms"))
    both = with_remainder(floor, steps, ar, sigma, rms)
    believed = _not_below(both, least)
    return replace(believed, rms=np.where(sigma > 0.0, believed.rms, both.rms))  # no remainder: as the repeats show


def _encoders(members: tuple[Stretch, ...]) -> list[Array]:
    return [np.nan_to_num(filled(one.enc)) for one in members if one.enc is not None]


def _smallest(stage: str, prepared: list[Prepared]) -> Array:
    """The least sigma of an increment (n,) that is believed."""
    n = prepared[0].plant.n
    least = np.full(n, SIGMA_MIN[stage])
    if stage == "actuator":
        steps = [
            encoder_step(one.stretch.enc[:, j]) for one in prepared[:1] if one.stretch.enc is not None for j in range(n)
        ]
        least = np.maximum(least, STEP_SHARE * np.array(steps))
    return least


def _silent(record: Remainder | None) -> bool:
    """Whether a joint's stage was never seen to leave anything on the undisturbed machine."""
    return record is not None and bool(record.usual) and all(size < SILENT for _, size in record.usual)


def _not_below(floor: Floor, least: Array) -> Floor:
    """Sigma raised to what is believed; where there is no noise, the increments are taken as white.

    Returns: the floor with `rms` turned into the share of sigma that the repeats themselves show (n,).
    """
    sigma = floor.whitener.sigma
    a = np.where(sigma < NO_NOISE * least, 0.0, floor.whitener.a)
    white = Whitener(a, np.maximum(sigma, least))
    share = np.minimum(1.0, sigma / white.sigma)
    return replace(floor, rms=share, whitener=white, increment_rms=np.maximum(floor.increment_rms, least))


def cell_of(
    stage: str, joints: tuple[int, ...], prepared: list[Prepared], floor: Floor, base: ParameterSets, replayer: Replayer
) -> Cell:
    """One cell of a stage: these joints (0-based) over all prepared stretches."""
    chosen = list(joints)
    white = floor.whitener.only(chosen)
    parts = tuple(part_of(stage, one, chosen, replayer) for one in prepared)
    replay = Replay(stage, joints, parts, white)
    kinds = [part.stretch.kind for part in parts]
    per_channel = [white_rows(part, white.order) for part in parts]
    blocks_by_part, folds_by_part, same = layout_of(kinds, per_channel)
    spread = [np.tile(one, len(chosen)) for one in blocks_by_part]
    folds = [np.tile(one, len(chosen)) for one in folds_by_part]
    channel = [np.repeat(np.arange(len(chosen)), rows) for rows in per_channel]
    series = [k * len(chosen) + one for k, one in enumerate(channel)]
    rows = Rows(*(np.concatenate(one).astype(np.int64) for one in (folds, spread, series, channel)))
    per_second = 1.0 / BLOCK_S if stage == "actuator" else 1.0
    scale = (floor.increment_rms[chosen] * per_second)[rows.channel]
    regressors, t_s = regressors_of(parts, chosen, white.order, SKIPPED, per_channel)
    one_based = tuple(j + 1 for j in joints)
    whole = stage == "link" or len(joints) > 1
    left = _records(replayer, stage, joints, white.sigma)

    def at_noise(noise: Whitener) -> Cell:
        other = _at_noise(floor, chosen, noise)
        return cell_of(stage, joints, prepared, other, base, replayer)

    return Cell(
        stage=stage,
        joint=None if whole else one_based[0],
        unit=UNIT[stage],
        candidates=_candidates(stage, one_based, prepared, replayer),
        base=base,
        whitened=replay,
        rows=rows,
        scale=scale,
        quiet=float(np.mean(floor.rms[chosen] ** 2)),
        floor_known=floor.known,
        same_kind=same,
        regressors=regressors,
        t_s=t_s,
        coarse=any(part.plant.decimate > 1 for part in parts),
        spread_least=left.spread,
        form_share=FORM_SHARE_OIL if stage == "actuator" else FORM_SHARE,
        usual=left.usual,
        left_share=float(np.mean(left.shares)),
        usual_names=left.usual_names,
        at_noise=None if floor.known or stage != "actuator" or any(left.known) else at_noise,
    )


def _at_noise(floor: Floor, chosen: list[int], noise: Whitener) -> Floor:
    """A floor with another filter for some joints (0-based)."""
    n = len(floor.whitener.sigma)
    a, sigma, rms = np.zeros((noise.order, n)), floor.whitener.sigma.copy(), floor.increment_rms.copy()
    a[:, chosen], sigma[chosen], rms[chosen] = noise.a, noise.sigma, noise.sigma
    return replace(floor, rms=np.ones(n), whitener=Whitener(a, sigma), increment_rms=rms)


@dataclass(frozen=True, slots=True)
class _Records:
    """What the machine file's baseline leaves of a cell's joints: a record each (None: nothing known), and its share of
    that joint's floor, in squares."""

    known: tuple[Remainder | None, ...]
    shares: tuple[float, ...]

    @property
    def usual(self) -> tuple[tuple[str, float], ...]:
        """Tests that fire on the undisturbed machine, the largest size of any joint."""
        pairs = zip(self.known, self.shares, strict=True)
        rows = [row for one, share in pairs if one is not None for row in one.usual_at(share)]
        return tuple({name: max(size for n, size in rows if n == name) for name, _ in rows}.items())

    @property
    def usual_names(self) -> tuple[tuple[str, float], ...]:
        """Names that gain much there, and what [nats]."""
        return tuple({name: nats for one in self.known if one is not None for name, nats in one.usual_names}.items())

    @property
    def spread(self) -> float:
        """By how much scores are divided at least: the most that a joint asks for."""
        return max((one.spread for one in self.known if one is not None), default=1.0)


def _records(replayer: Replayer, stage: str, joints: tuple[int, ...], sigma: Array) -> _Records:
    """Of joints (0-based) with floors `sigma` (joints,)."""
    known = tuple(replayer.nominal.remainder(stage, j + 1) for j in joints)
    shares = (0.0 if one is None else min(1.0, (one.sigma / s) ** 2) for one, s in zip(known, sigma, strict=True))
    return _Records(known, tuple(shares))


def layout_of(kinds: list[str], lengths: list[int]) -> tuple[list[NDArray[np.int64]], list[NDArray[np.int64]], bool]:
    """Blocks and folds of each piece, and whether the folds are of one kind."""
    blocks, _ = blocks_of(lengths)
    folds, same = folds_of(kinds, lengths, blocks)
    cuts = np.cumsum(lengths)[:-1]
    return np.split(blocks, cuts), np.split(folds, cuts), same


def _candidates(
    stage: str, joints: tuple[int, ...], prepared: list[Prepared], replayer: Replayer
) -> tuple[Candidate, ...]:
    machine = stage == "link"
    found = candidates_of(stage, joints, machine)  # pyright: ignore[reportArgumentType]
    if stage == "link":
        found = read_off(found, tuple(one.stretch for one in prepared))
        plant = replayer.plant
        cycles = (plant.cycle_s, plant.transport_delay_s)
        found = tuple(replace(one, cycles=cycles) if one.name == "transport_delay" else one for one in found)
    if stage == "actuator":
        found = tuple(one for one in found if one.name != "supply_droop") + named(SEEN_BY_ENCODER, joints)
    loaded = replayer.torque_reference
    return tuple(one for one in found if possible(one, replayer, loaded))


def possible(one: Candidate, replayer: Replayer, loaded: Array | None) -> bool:
    """Whether a machine can have an effect at all: no droop without load, no lag error without a lag."""
    if one.joint is None:
        return True
    if one.name in ("load_droop", "internal_leakage"):
        return loaded is not None and bool(np.isfinite(loaded[one.joint - 1]))
    return one.name != "controller_lag_error" or bool(replayer.plant.joints[one.joint - 1, 4] > 0.0)


def part_of(stage: str, one: Prepared, joints: list[int], replayer: Replayer) -> Part:
    """One stretch's replay narrowed to some joints (0-based)."""
    drive = one.drives[stage]
    signals = {name: getattr(drive, name) for name in ("sent", "ref", "enc", "u", "load", "load_kg")}
    cut = {name: np.ascontiguousarray(values[:, joints]) for name, values in signals.items()}
    narrowed = replace(drive, **cut, enc_start=drive.enc_start[joints].copy(), u_start=drive.u_start[joints].copy())
    plant = replace(one.plant, joints=one.plant.joints[joints])
    output = _measured(stage, one)
    if output is None:
        raise DiagnosisError(f"{one.stretch.name}: the output of stage {stage} was not recorded")
    measured = filled(output)[:, joints]
    part = Part(plant, narrowed, measured, one.stretch, np.zeros((0, len(joints))))
    finer = np.array([0.0 if replayer.learnt(stage, j) else replayer.finer for j in joints])
    if stage == "actuator" and finer.any():
        part = replace(part, measured=measured - finer * by_steps(part)[: len(measured)])
    own = part_increments(stage, part, neutral_sets(len(joints)))[0][0]

    def apart(**inputs: Array) -> Array:
        other = replace(
            part, drive=replace(part.drive, **{k: np.ascontiguousarray(x[:, joints]) for k, x in inputs.items()})
        )
        return own - part_increments(stage, other, neutral_sets(len(joints)))[0][0]

    jumped = one.late.get(stage)
    unsure = None if jumped is None else apart(u=jumped.u) if stage == "actuator" else apart(ref=jumped.ref)
    if stage != "actuator" or one.other is None:
        return replace(part, between=np.zeros_like(own), unsure=unsure)
    return replace(part, between=apart(u=one.other), unsure=unsure)


def by_steps(part: Part) -> Array:
    """What an endless number of steps changes in the modelled course (rows, joints), to first order in the step."""
    own, half = (
        simulate(replace(part.plant, refined=times), neutral_sets(part.plant.n), part.drive).enc[0] for times in (1, 2)
    )
    return 2.0 * (half - own)


def white_rows(part: Part, order: int) -> int:
    """White residuals of one channel in a part."""
    size = max(1, round(BLOCK_S / part.stretch.dt_s))
    return max(0, len(part.measured) // size - 1 - order - SKIPPED)
