"""What a baseline leaves of the model's form on recordings that it was not fitted to, cell by cell."""

from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import stdtrit

from diagnosis.behind.corner_residual import CornerResidual
from diagnosis.behind.point_residual import PointResidual
from diagnosis.cells.behind import behind_cells, cells_fitting_joint, cells_without, measurement_of, shown_behind
from diagnosis.cells.dynamic import stage_cells
from diagnosis.cells.own_step import at_its_step
from diagnosis.errors import DiagnosisError
from diagnosis.known.form import form_of, most_of
from diagnosis.known.known import with_known
from diagnosis.known.wander import wander_of
from diagnosis.noise.excess import common_excess
from diagnosis.noise.floor import AR_ORDER_MAX, REMAINDER_AR_ORDER, repeat_deviations
from diagnosis.noise.of_corners import UNIT_CORNER_NOISE, variances_of
from diagnosis.noise.of_points import variances_of as variances_of_points
from diagnosis.reading.read import Read
from diagnosis.replay.replayer import replayer_of
from diagnosis.replay.stage_replay import START_SKIPPED_INCREMENTS, Replay, part_increments
from diagnosis.replay.stretches import repeat_groups
from diagnosis.search.cell import DYNAMIC_STAGES, Cell
from machine.effects.entries import EffectEntry, pack_under
from machine.effects.layout import ParameterSets
from machine.remainder import Remainder
from machine.rotations import Array

POINT_AXIS_COUNT = 3  # radial, tangential, up
NEGLIGIBLE_VARIANCE_FRAC = 1e-6  # share of the mean square
PREDICTION_LIMIT_QUANTILE = 0.999  # share of healthy recordings below a level; a recording has about ten parts
WHITE_NOISE_VARIANCE_FRAC = 1e-3  # of the variance: the least eigenvalue of the moments


def cells_of(whole: Read) -> list[Cell]:
    """Every cell of a recording, with its machine's baseline, link first."""
    nominal = whole.nominal_machine
    if nominal is None:
        return []
    base, cells = pack_under(nominal.baseline_effects, nominal.n), []
    replayer, behind = replayer_of(nominal, whole.stretches), behind_cells(whole, base)
    if replayer is not None and whole.stretches:
        replayer = at_its_step(replayer, whole.stretches, base)
        for stage in DYNAMIC_STAGES:
            cells += with_known(stage_cells(stage, replayer, whole.stretches, base, base), nominal)
    return cells_fitting_joint(cells_without(cells, shown_behind(behind)) + behind, nominal)


def with_baseline(whole: Read, effects: tuple[EffectEntry, ...], remainders: tuple[Remainder, ...]) -> Read:
    """A recording read with another baseline than its machine file's.

    Raises: DiagnosisError: there is no machine file.
    """
    if whole.nominal_machine is None:
        raise DiagnosisError(f"{whole.recording_path.name}: there is no machine file")
    return replace(
        whole, nominal_machine=replace(whole.nominal_machine, baseline_effects=effects, baseline_remainders=remainders)
    )


def forms_of(wholes: list[Read]) -> tuple[Remainder, ...]:
    """What the model is wrong by on all these recordings alike, as remainders that say nothing else."""
    places = _by_place(wholes)
    return tuple(
        Remainder(stage, joint, on, 0.0, 0.0, form=form)
        for (stage, joint, on), cells in places.items()
        if (form := form_of(cells))
    )


def with_wanders(remainders: tuple[Remainder, ...], wholes: list[Read]) -> tuple[Remainder, ...]:
    """Remainders with what their joints' numbers wander by over recordings that these remainders belong to."""
    found = {place: wander_of(cells) for place, cells in _by_place(wholes).items()}
    return tuple(
        replace(remainder, wander=found.get((remainder.stage, remainder.joint, remainder.on), ()))
        for remainder in remainders
    )


def with_mosts(remainders: tuple[Remainder, ...], wholes: list[Read]) -> tuple[Remainder, ...]:
    """Remainders with the most that their forms say of any of these recordings, which these remainders belong to."""
    cells = _by_place(wholes)
    places = [(remainder, cells.get((remainder.stage, remainder.joint, remainder.on), [])) for remainder in remainders]
    return tuple(
        replace(remainder, form_most=most_of(own, remainder.form)) if remainder.form else remainder
        for remainder, own in places
    )


def with_levels(remainders: tuple[Remainder, ...], wholes: list[Read]) -> tuple[Remainder, ...]:
    """Remainders with the mean square that one more recording like these, which they belong to, stays below."""
    found = {
        place: prediction_limit([mean_square(cell) for cell in cells]) for place, cells in _by_place(wholes).items()
    }
    return tuple(
        replace(remainder, level=max(1.0, found.get((remainder.stage, remainder.joint, remainder.on), 1.0)))
        for remainder in remainders
    )


def prediction_limit(values: list[float]) -> float:
    """What one more value of a log-normal sample stays below with PREDICTION_LIMIT_QUANTILE; 1 for fewer than two.

    Source: prediction interval of one future observation, unknown mean and variance (Student's t).
    """
    if len(values) < 2:
        return 1.0
    logs = np.log(np.maximum(values, NEGLIGIBLE_VARIANCE_FRAC))
    wide = float(stdtrit(len(logs) - 1, PREDICTION_LIMIT_QUANTILE)) * np.sqrt(1.0 + 1.0 / len(logs))
    return float(np.exp(logs.mean() + wide * logs.std(ddof=1)))


def mean_square(cell: Cell) -> float:
    """What a cell leaves of the healthy machine, in floors."""
    return float(np.mean(cell.whitened(cell.baseline_parameters)[0] ** 2))


def remainders_of(checked: list[Read]) -> tuple[Remainder, ...]:
    """What the baseline leaves on these recordings, without the noise, cell by cell."""
    out: list[Remainder] = []
    for (stage, joint, on), cells in _by_place(checked).items():
        if stage in DYNAMIC_STAGES:
            out += _dynamic_remainders(stage, cells)
        else:
            out.append(_unwhitened_remainder(cells, Remainder(stage, joint, on, 0.0, 0.0)))
    return tuple(out)


def _by_place(wholes: list[Read]) -> dict[tuple[str, int | None, str], list[Cell]]:
    found: dict[tuple[str, int | None, str], list[Cell]] = {}
    for whole in wholes:
        for cell in cells_of(whole):
            for part in cell.joined_cells or (cell,):
                found.setdefault((part.stage, part.joint, measurement_of(part)), []).append(part)
    return found


def _unwhitened_remainder(cells: list[Cell], where: Remainder) -> Remainder:
    """Remainder [m or px] of points or corners, in all and by axis: nothing is whitened there."""
    if where.stage == "camera":
        return _of_corners(cells, where)
    found, noise, variances = [], [], []
    for cell in cells:
        seen = cell.whitened
        if isinstance(seen, PointResidual):
            own, oscillation = variances_of_points(
                seen.metres(cell.baseline_parameters)[0].reshape(-1, POINT_AXIS_COUNT), seen.noise
            )
            found.append(own)
            noise.append(seen.noise.point_sigma_m**2)
            variances.append([max(oscillation, 0.0)])
    if not found:
        return where
    by_axis = np.sqrt(common_excess(np.array(found), np.array(noise)))
    left = float(np.sqrt(np.mean(by_axis**2)))
    oscillation_rad = float(np.sqrt(common_excess(np.array(variances), np.zeros((len(variances), 1)))[0]))
    own_axes = tuple(float(x) for x in by_axis)
    return replace(where, sigma=left, rms=left, by_axis=own_axes, oscillation_rad=oscillation_rad)


def _of_corners(cells: list[Cell], where: Remainder) -> Remainder:
    """What is left of each corner, and what all corners of a frame share."""
    found, noise = [], []
    for cell in cells:
        seen = cell.whitened
        if isinstance(seen, CornerResidual):
            raw = replace(seen, noise=UNIT_CORNER_NOISE)(cell.baseline_parameters)[0]
            found.append(np.concatenate(variances_of(raw, seen.camera_frames.frame_axis_group)))
            noise.append(np.concatenate([seen.noise.corner_sigma_px**2, seen.noise.frame_shared_sigma_px**2]))
    if not found:
        return where
    own, shared = np.split(common_excess(np.array(found), np.array(noise)), 2)
    left = float(np.sqrt(np.mean(own)))
    both = float(np.sqrt(np.mean(own + shared)))
    return replace(where, sigma=left, rms=both, by_axis=tuple(float(x) for x in np.sqrt(shared)))


def _dynamic_remainders(stage: str, cells: list[Cell]) -> list[Remainder]:
    """Remainders of one stage, joint by joint: the autoregression of what all recordings have beyond their noise."""
    replays = [cell.whitened for cell in cells if isinstance(cell.whitened, Replay)]
    out = []
    for column, joint in enumerate(replays[0].joints if replays else ()):
        totals, noises = [], []
        for cell, replay in zip(cells, replays, strict=True):
            sets = _own_joints(cell, replay)
            runs = [
                part_increments(stage, part, sets)[0][0][START_SKIPPED_INCREMENTS:, column]
                for part in replay.stretch_replays
            ]
            noise = [rows[:, 0] for rows in _repeat_noise_increments(stage, cell, replay, column)]
            totals.append(lagged_products(runs))
            noises.append(lagged_products(noise) if noise else np.zeros_like(totals[-1]))
        ar, sigma, rms = common_process(np.array(totals), np.array(noises))
        out.append(Remainder(stage, joint + 1, "", sigma, rms, tuple(float(a) for a in ar)))
    return out


def lagged_products(runs: list[Array]) -> Array:
    """Mean products (p + 1, p + 1) of a sample and the p before it, over runs (m,) without a mean."""
    long = [sliding_window_view(run, REMAINDER_AR_ORDER + 1) for run in runs if len(run) > REMAINDER_AR_ORDER]
    if not long:
        return np.zeros((REMAINDER_AR_ORDER + 1, REMAINDER_AR_ORDER + 1))
    rows = np.concatenate(long)[:, ::-1]
    return rows.T @ rows / len(rows)


def common_process(totals: Array, noises: Array) -> tuple[Array, float, float]:
    """Autoregression (p,), its innovation's sigma, and RMS of what recordings have in common beyond their noise.

    Model: remainder and noise are independent, so that their moments add; recordings weigh as in `common_excess`. What
           chance leaves that no process has is made one by a little white noise; where it is much, the moments are not
           read over many lags. Least squares, not the autocovariances: stretches are short, and their ends would make
           a slow oscillation look damped.
    Args:  totals, noises: (recordings, p + 1, p + 1), moments in all and of noise alone.
    """
    order = totals.shape[1] - 1
    excess = float(common_excess(totals[:, :1, 0], noises[:, :1, 0])[0])
    if excess <= NEGLIGIBLE_VARIANCE_FRAC * float(totals[:, 0, 0].mean()):
        return np.zeros(order), 0.0, 0.0
    weights = (noises[:, 0, 0] + excess) ** -2
    left = np.einsum("k,kij->ij", weights / weights.sum(), totals - noises)
    least = float(np.linalg.eigvalsh(left)[0])
    if (
        least < -WHITE_NOISE_VARIANCE_FRAC * left[0, 0] and order > AR_ORDER_MAX
    ):  # noisy moments: many lags would fit what chance left
        few = AR_ORDER_MAX + 1
        ar, sigma, rms = common_process(totals[:, :few, :few], noises[:, :few, :few])
        return np.concatenate([ar, np.zeros(order - AR_ORDER_MAX)]), sigma, rms
    left += max(0.0, WHITE_NOISE_VARIANCE_FRAC * left[0, 0] - least) * np.eye(order + 1)
    ar = np.linalg.solve(left[1:, 1:], left[1:, 0])
    return ar, float(np.sqrt(left[0, 0] - ar @ left[1:, 0])), float(np.sqrt(left[0, 0]))


def _own_joints(cell: Cell, replay: Replay) -> ParameterSets:
    """The baseline's parameters of the joints that a replay holds."""
    joints = list(replay.joints)
    return replace(
        cell.baseline_parameters,
        joint_parameters=np.ascontiguousarray(cell.baseline_parameters.joint_parameters[:, joints]),
    )


def _repeat_noise_increments(stage: str, cell: Cell, replay: Replay, column: int) -> list[Array]:
    """Increments (m, 1) of the repeats' deviations from their mean."""
    by_name = {part.stretch.name: part for part in replay.stretch_replays}
    groups = repeat_groups(tuple(part.stretch for part in replay.stretch_replays))
    members = max(groups.values(), key=len, default=())
    if len(members) < 2:
        return []
    sets = _own_joints(cell, replay)
    steps = [
        part_increments(stage, by_name[member.name], sets)[0][0][START_SKIPPED_INCREMENTS:, [column]]
        for member in members
    ]
    rows = min(len(step) for step in steps)
    return repeat_deviations(np.stack([step[:rows] for step in steps])) if rows > REMAINDER_AR_ORDER + 20 else []
