"""The noise of measured points, before what a baseline leaves is added: from repeats of one command, from poses that
were measured again, or what no mixture of effects explains.
"""

from dataclasses import dataclass, replace

import numpy as np

from diagnosis.behind.link_angles import Path, largest_encoder_steps, path_index
from diagnosis.behind.measured_again import measured_again
from diagnosis.behind.point_residual import PointResidual, unweighted_residual
from diagnosis.behind.points import PointData, numbers_fitted
from diagnosis.behind.saturated import saturated_noise
from diagnosis.behind.stairs import RAMP_ERROR_RMS_STEP_FRAC
from diagnosis.log.nominal import Nominal
from diagnosis.noise.of_repeated_points import RepeatedPoints, repeated_points
from diagnosis.replay.repeats import REFERENCE_SPREAD_MAX_RAD, reference_spread
from diagnosis.replay.stretches import Stretch, repeat_groups
from diagnosis.search.candidates import Candidate
from machine.effects.layout import ParameterSets
from machine.rotations import Array

# Than what no mixture of effects explains: what differs so from repeat to repeat is not scatter
REPEAT_SCATTER_RATIO_MAX = 2.0
DRIFT_TO_SCATTER_RATIO_MAX = 2.0  # of the noise: trackers drift by as much as they scatter
TENTHS, ALIKE_LEAST = 10, 1.8  # of independent instants one recording in a thousand shows more


@dataclass(frozen=True, slots=True)
class PointScatter:
    """Standard deviations [m]: `point_sigma_m` of each point's own (3,), radial, tangential and up, `common_m` of a
    shift that the points of one instant share. `is_measured`: from `sigma_dof` independent squares, not guessed.
    `loose_target_text`: which point of poses at rest moved by itself, in words. `correlated_instants`: for how many
    instants one speaks, since a tracker drifts.
    """

    point_sigma_m: Array
    common_m: float
    is_measured: bool
    sigma_dof: int = 0
    loose_target_text: str = ""
    correlated_instants: float = 1.0


def point_scatter(
    rough: PointResidual,
    base: ParameterSets,
    candidates: tuple[Candidate, ...],
    repeats: RepeatedPoints | None,
    has_baseline: bool,
) -> PointScatter:
    """Of points whose residual [m] is `rough`.

    Args: candidates: effects whose mixtures explain what is not noise; repeats: what repeats of one command show;
          has_baseline: whether the machine file says how these points scatter about their model.
    """
    found = _at_rest(rough, base, candidates, has_baseline)
    if not has_baseline and rough.encoder_paths:
        found = _in_motion(rough, base, found, repeats)
    return (
        replace(found, point_sigma_m=np.hypot(found.point_sigma_m, _stairs_m(rough, base)))
        if found.is_measured
        else found
    )


def _at_rest(
    rough: PointResidual, base: ParameterSets, candidates: tuple[Candidate, ...], has_baseline: bool
) -> PointScatter:
    again = measured_again(rough, base)
    if again is not None and has_baseline:
        return PointScatter(again.sigma_m, 0.0, True, again.pointwise_dof, again.loose_target_text)
    if again is not None:
        return PointScatter(again.own_offset, again.common_m, True, again.sigma_dof, again.loose_target_text)
    sensors = rough.nominal_machine.sensor_accuracy
    stated = sensors.tracker_m if rough.encoder_paths else sensors.static_m or sensors.tracker_m
    if stated is not None:
        return PointScatter(np.full(3, stated), 0.0, True)
    by_instant = 3 * np.repeat(rough.noise.instant_index, 3) + np.tile(np.arange(3), len(rough.measured_points.xyz))
    taken = numbers_fitted(rough.nominal_machine, rough.measured_points)
    own, common_m = saturated_noise(rough, base, candidates, by_instant, taken)
    return PointScatter(np.full(3, own), common_m, False)


def _in_motion(
    rough: PointResidual, base: ParameterSets, found: PointScatter, repeats: RepeatedPoints | None
) -> PointScatter:
    """By repeats, where they differ by a tracker's scatter and drift; all repeats may be off by what one of them is.

    What comes back to a pose by another way differs by more, stairs of encoders say, which repeats have alike.
    """
    noise_m = float(np.sqrt(np.mean(found.point_sigma_m**2) + found.common_m**2))
    if (
        repeats is None
        or not repeats.scatters
        or np.sqrt(np.mean(repeats.point_sigma_m**2)) > REPEAT_SCATTER_RATIO_MAX * noise_m
    ):
        return replace(found, correlated_instants=_alike_in_time(rough, base, noise_m))
    drifts = float((repeats.drift_m**2).sum() / (repeats.point_sigma_m**2).sum())
    alike = 1.0 + drifts * (int(rough.noise.instant_index.max()) + 1)
    own = (
        np.maximum(repeats.point_sigma_m, np.hypot(found.point_sigma_m, found.common_m))
        if found.is_measured
        else repeats.point_sigma_m
    )
    return PointScatter(own, 0.0, True, repeats.sigma_dof, found.loose_target_text, alike)


def noise_by_repeats(
    nominal: Nominal, data: PointData, paths: tuple[Path, ...], base: ParameterSets, stretches: tuple[Stretch, ...]
) -> RepeatedPoints | None:
    """What repeats of one command say of tracked points; None where there are none, or a baseline knows better."""
    groups = [
        group for group in repeat_groups(stretches).values() if reference_spread(group) <= REFERENCE_SPREAD_MAX_RAD
    ]
    at = path_index(paths, data.time_or_pose_index)
    if not groups or (at < 0).all() or nominal.baseline_remainder("structure", on="tracker") is not None:
        return None
    rough = unweighted_residual(nominal, data, paths, at)
    runs = tuple(tuple((run.t_segment_s, float(run.t_s[0]), float(run.t_s[-1])) for run in group) for group in groups)
    return repeated_points(
        rough(base)[0].reshape(-1, 3), rough.measured_points.point_index, rough.measured_points.time_or_pose_index, runs
    )


def _stairs_m(rough: PointResidual, base: ParameterSets) -> Array:
    """RMS (3,) [m] of what coarse encoders leave of their stairs, radial, tangential and up."""
    steps = largest_encoder_steps(rough.encoder_paths, rough.nominal_machine.n)
    if not steps.any():
        return np.zeros(3)
    of_a_step = rough.moved_by_each(base) * RAMP_ERROR_RMS_STEP_FRAC * steps[:, None, None]
    return np.sqrt((of_a_step**2).mean(axis=1).sum(axis=0))


def _alike_in_time(rough: PointResidual, base: ParameterSets, noise_m: float) -> float:
    """For how many instants one speaks, where what is measured drifts: 1 where they differ by chance.

    Model: variance of the means of tenths of the recording, over that of means of as many independent instants. What
           is several times larger than the noise is not a tracker's drift.
    Why:   a tracker drifts by a tenth of a millimetre in a minute, and a length that is 0.08 mm off follows the drift.
           What an effect does goes with the motion, which tenths of a recording have alike.
    """
    instants = rough.noise.instant_index
    residual = rough(base)[0].reshape(-1, 3)
    count = np.bincount(instants)
    mean = np.stack([np.bincount(instants, weights=axis) / count for axis in residual.T], axis=1)
    size = len(mean) // TENTHS
    if size < 2:
        return 1.0
    if float(np.sqrt(np.mean(residual**2))) > DRIFT_TO_SCATTER_RATIO_MAX * noise_m:
        return 1.0
    mean -= mean.mean(axis=0)
    tenths = mean[: size * TENTHS].reshape(TENTHS, size, 3).mean(axis=1)
    alike = size * float((tenths**2).sum()) / (TENTHS - 1) / max(float((mean**2).sum()) / len(mean), 1e-30)
    return alike if alike > ALIKE_LEAST else 1.0
