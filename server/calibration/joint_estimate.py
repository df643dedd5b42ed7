"""One estimate of everything that stands between the encoders and the tool in front of the OOI.

Mount of the camera, kinematic errors and sag around this posture, clocks, odometry's scale, and where the OOI is: one
maximum a posteriori fit to the odometry of the calibration paths and to all looks since, with one covariance. Every
executed move ends in a look, so every move improves the map; nothing else is needed to learn from it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from machine.chain import chain_of
from machine.description import Machine
from machine.kinematics import tcp_pose
from server.calibration.contracts import Array, CalibrationStatus
from server.calibration.joint_lens import (
    N_LENS,
    LensPrior,
    layout_covariance,
    look_sensitivity,
    odometry_sensitivity,
    shows_plane,
)
from server.calibration.joint_observations import (
    LookAt,
    NoiseModel,
    OdometryRun,
    RunSamples,
    Scatter,
    look_covariance,
    look_residual,
    run_covariance,
    run_residuals,
    thin_samples,
)
from server.calibration.joint_state import JointState, state_steps
from server.calibration.joint_verdict import (
    CAMERA_PARAMETERS_DOF,
    FitResiduals,
    covariance_widened_by_misfit,
    fit_verdict,
)
from server.calibration.kinematic_errors import ErrorModel, ErrorPrior, error_model
from server.calibration.lens_evidence import LensEvidence, mean_evidence

ITERATIONS_MAX = 8
CONVERGED_STEP_SIGMAS = 1e-3  # of a standard deviation
OUTLIER_SIGMAS = 2.5
SCATTER_ROUNDS_MAX, SCATTER_SAME = 3, 0.15
FITTED_DOF_PER_RUN = 20  # of a run's freedoms, about
PATH_LENGTH_MIN_M = 0.15
OOI_POSE_PRIOR_SIGMA = np.array([np.pi] * 3 + [10.0] * 3)


@dataclass(frozen=True, slots=True)
class JointPrior:
    """What is believed before anything was seen. Standard deviations."""

    kinematic_errors: ErrorPrior = field(default_factory=ErrorPrior)
    sigma_mount_rad: float = float(np.deg2rad(3.0))  # camera against the machine file, per axis
    sigma_mount_m: float = 0.010
    sigma_tool_marker_rad: float = float(np.deg2rad(1.0))
    sigma_tool_marker_m: float = 0.002
    sigma_scale_frac: float = 0.001  # of the odometry, beyond the lens
    sigma_time_s: float = 0.1
    lens: LensPrior = field(default_factory=LensPrior)


@dataclass(frozen=True, slots=True)
class JointEstimate:
    """The fit. `state` and `covariance` (p + 27, p + 27; order of `JointState.moved`) are None unless status is OK."""

    status: CalibrationStatus
    reason: str
    error_model: ErrorModel
    state: JointState | None
    covariance: Array | None
    residual_rms_mm: float  # of the odometry's positions
    residual_max_mm: float
    misfit: float  # worst mean square of whitened residuals, of looks and of any run; above 1 it widens the covariance
    n_samples: int
    n_looks: int
    path_length_m: float
    observability: float  # share of the prior's rotation variance of the mount that the data took away, 0..1
    noise_model: NoiseModel = field(default_factory=NoiseModel)  # that was taken for granted
    layout_covariance: Array | None = None  # (6, 6) of the OOI by its markers' layout, OOI axes; no data lessen it


@dataclass(slots=True)
class _Problem:
    error_model: ErrorModel
    noise_model: NoiseModel
    prior_state: JointState
    prior_sigma: Array
    odometry_runs: list[tuple[OdometryRun, RunSamples, Array]]
    position_scatters: list[Scatter]  # of each run
    looks: tuple[tuple[LookAt, Array, Array], ...]  # with weight (12, 12) and sensitivity to the lens (12, 7)
    odometry_lens_jacobian: Array
    weights: list[Array]
    lens_evidence: LensEvidence  # what the looks' corners say of lens and prints beyond their poses

    @property
    def mount(self) -> slice:
        """Of the camera's rotation among the unknowns."""
        return slice(self.error_model.n, self.error_model.n + 3)


def estimate_jointly(
    machine: Machine,
    runs: Sequence[OdometryRun],
    looks: Sequence[LookAt],
    prior: JointPrior | None = None,
    noise: NoiseModel | None = None,
) -> JointEstimate:
    """Fit everything to everything seen so far.

    Model:   min over x of |x - x_prior|^2 / P0 + sum over runs of r^T C^-1 r (positions with their correlated errors;
             rotations; outliers outweighed) + sum over looks of r^T C_look^-1 r; Gauss-Newton with numerical
             derivatives. Covariance: inverse of the normal matrix, times the misfit where that is above 1. Each look
             and each run is judged by itself (`joint_verdict.py`).
    Args:    runs: at least one, or none for an estimate from looks alone. looks: at least one; the last one is where
             the machine stands.
    Returns: JointEstimate; a status with a reason where the data do not carry one.
    """
    believed, accuracy = prior or JointPrior(), noise or NoiseModel()
    model = error_model(machine, believed.kinematic_errors)
    refusal = _input_refusal(runs, looks, model)
    if refusal:
        return _refused_estimate(model, *refusal, 0.0)
    thin = [(run, thin_samples(run, accuracy)) for run in runs if len(run.camera_track.t_s) >= 3]
    usable = [(run, samples) for run, samples in thin if len(samples.t_s) >= 3]  # of a camera that stood one is left
    length = float(sum(samples.length_m[-1] for _, samples in usable))
    if runs and length < PATH_LENGTH_MIN_M:
        reason = (
            f"camera moved {1e3 * length:.0f} mm in all (need {1e3 * PATH_LENGTH_MIN_M:.0f} mm); drive a longer path"
        )
        return _refused_estimate(model, CalibrationStatus.TOO_FEW, reason, length)
    if not shows_plane(machine.camera, looks[-1].T_cam_ooi):
        reason = "the object of interest is too near, edge-on or behind the camera: no wall to see about it; look again"
        return _refused_estimate(model, CalibrationStatus.DEGENERATE, reason, length)
    start = _start(machine, model, looks[-1])
    problem = _Problem(
        error_model=model,
        noise_model=accuracy,
        prior_state=_prior_mean(machine, start),
        prior_sigma=_prior_sigmas(model, believed),
        odometry_runs=[
            (run, samples, _inverse_matrix(run_covariance(samples, accuracy, Scatter(accuracy.sigma_position_m))))
            for run, samples in usable
        ],
        position_scatters=[Scatter(accuracy.sigma_position_m)] * len(usable),
        looks=tuple(
            (
                look,
                _inverse_matrix(look_covariance(model, start, look, accuracy)),
                look_sensitivity(machine, look.T_cam_tool, look.T_cam_ooi),
            )
            for look in looks
        ),
        odometry_lens_jacobian=odometry_sensitivity(machine.camera, looks[-1].T_cam_ooi),
        weights=[np.ones(len(samples.t_s) - 1) for _, samples in usable],
        lens_evidence=mean_evidence([look.lens_evidence for look in looks if look.lens_evidence is not None]),
    )
    state, information = _fit_until_scatter_settles(problem, start)
    if state is None:
        return _refused_estimate(model, CalibrationStatus.DEGENERATE, "the normal matrix is singular", length)
    layout = layout_covariance(machine, looks[-1].T_cam_ooi, believed.lens)
    return replace(_judge_estimate(problem, state, information, length), layout_covariance=layout)


def _input_refusal(
    runs: Sequence[OdometryRun], looks: Sequence[LookAt], model: ErrorModel
) -> tuple[CalibrationStatus, str] | None:
    if not looks:
        return CalibrationStatus.TOO_FEW, "no look: look at tool and OOI first"
    if any(look.q.shape != (model.n_joints,) or not np.isfinite(look.q).all() for look in looks):
        return CalibrationStatus.DEGENERATE, "a look's joints are not finite or not as many as the machine has"
    if not all(np.isfinite(T).all() for look in looks for T in (look.T_cam_tool, look.T_cam_ooi)):
        return CalibrationStatus.DEGENERATE, "a look's poses are not finite; look again"
    for run in runs:
        values = (run.camera_track.t_s, run.camera_track.Ts_vo_cam, run.joint_track.t_s, run.joint_track.qs)
        if not all(np.isfinite(value).all() for value in values):
            return CalibrationStatus.DEGENERATE, "a track holds values that are not finite"
        if (
            len(run.joint_track.t_s) < 2
            or np.any(np.diff(run.joint_track.t_s) <= 0.0)
            or np.any(np.diff(run.camera_track.t_s) <= 0.0)
        ):
            return CalibrationStatus.DEGENERATE, "a track's times do not rise; check the clocks"
    return None


def _start(machine: Machine, model: ErrorModel, look: LookAt) -> JointState:
    """The machine file's state; the camera turned so that the tool marker is seen where it is, the OOI where seen."""
    R_tcp_cam = machine.T_tcp_tool[:3, :3] @ look.T_cam_tool[:3, :3].T
    T_tcp_cam = machine.T_tcp_cam_left.copy()
    T_tcp_cam[:3, :3] = R_tcp_cam
    T_base_ooi = tcp_pose(chain_of(machine), look.q) @ T_tcp_cam @ look.T_cam_ooi
    return JointState(model.prior_mean.copy(), T_tcp_cam, machine.T_tcp_tool.copy(), T_base_ooi, 1.0, 0.0)


def _prior_mean(machine: Machine, start: JointState) -> JointState:
    """The mean of the prior: the machine file's mount, not the look's, which is an observation and counts once."""
    return replace(start, T_tcp_cam=machine.T_tcp_cam_left.copy())


def _inverse_matrix(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _prior_sigmas(model: ErrorModel, prior: JointPrior) -> Array:
    camera = [prior.sigma_mount_rad] * 3 + [prior.sigma_mount_m] * 3
    tool = [prior.sigma_tool_marker_rad] * 3 + [prior.sigma_tool_marker_m] * 3
    rest = [prior.sigma_scale_frac, prior.sigma_time_s]
    return np.concatenate([model.prior_sigma, camera, tool, OOI_POSE_PRIOR_SIGMA, rest, prior.lens.sigma])


def _run_and_look_residuals(problem: _Problem, state: JointState) -> tuple[list[tuple[Array, Array]], list[Array]]:
    runs = [
        run_residuals(problem.error_model, state, run, samples, problem.odometry_lens_jacobian)
        for run, samples, _ in problem.odometry_runs
    ]
    return runs, [look_residual(problem.error_model, state, look, S) for look, _, S in problem.looks]


def _fit_until_scatter_settles(problem: _Problem, start: JointState) -> tuple[JointState | None, Array]:
    """The fit with each run's scatter as the run itself shows it."""
    state, information = _gauss_newton_fit(problem, start)
    for _ in range(SCATTER_ROUNDS_MAX):
        if state is None or not _scatter_renewed(problem, state):
            break
        state, information = _gauss_newton_fit(problem, state)
    return state, information


def _scatter_renewed(problem: _Problem, state: JointState) -> bool:
    """Each run's scatter as its residuals show it; whether any changed enough to fit again.

    Model:   variance component: sigma^2 times the mean square of the run's whitened positions, which is 1 if the sigma
             was right; correlation of neighbours from the residuals themselves. How much the boom sways on the way is
             not known before, and decides what the path is worth.
    """
    low, high = problem.noise_model.sigma_position_range_m
    renewed = False
    for i, (run, samples, W) in enumerate(problem.odometry_runs):
        position, _ = run_residuals(problem.error_model, state, run, samples, problem.odometry_lens_jacobian)
        weighted = np.sqrt(problem.weights[i])[:, None] * position
        freedoms = max(position.size - FITTED_DOF_PER_RUN, 0.5 * position.size)
        ratio = float(np.einsum("ia,ij,ja->", weighted, W, weighted)) / freedoms
        alike = float(np.sum(weighted[1:] * weighted[:-1]) / max(np.sum(weighted**2), 1e-18))
        before = problem.position_scatters[i]
        after = Scatter(
            float(np.clip(before.sigma_m * np.sqrt(ratio), low, high)),
            float(np.clip(alike, *problem.noise_model.neighbours_range)),
        )
        changed = (
            abs(after.sigma_m / before.sigma_m - 1.0),
            abs(after.neighbour_correlation - before.neighbour_correlation),
        )
        if max(changed) > SCATTER_SAME:
            problem.position_scatters[i] = after
            problem.odometry_runs[i] = (
                run,
                samples,
                _inverse_matrix(run_covariance(samples, problem.noise_model, after)),
            )
            renewed = True
    return renewed


def _gauss_newton_fit(problem: _Problem, start: JointState) -> tuple[JointState | None, Array]:
    state = start
    information = np.eye(len(problem.prior_sigma))
    for _ in range(ITERATIONS_MAX):
        information, gradient = _normal_equations(problem, state, state.step_from(problem.prior_state))
        try:
            step: Array = np.asarray(-np.linalg.solve(information, gradient), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None, information
        if not np.isfinite(step).all():
            return None, information
        state = state.moved(step)
        if float(np.max(np.abs(step) / problem.prior_sigma)) < CONVERGED_STEP_SIGMAS:
            break
    return state, information


def _normal_equations(problem: _Problem, state: JointState, gone: Array) -> tuple[Array, Array]:
    """J^T W J and J^T W r, the prior included; the samples' weights are renewed on the way."""
    runs, looks = _run_and_look_residuals(problem, state)
    steps = state_steps(problem.error_model)
    shifted = [_run_and_look_residuals(problem, state.moved(step)) for step in np.diag(steps)]
    information, gradient = np.diag(problem.prior_sigma**-2.0), gone / problem.prior_sigma**2
    for i, (_, _, W) in enumerate(problem.odometry_runs):
        position, turn = runs[i]
        Jp = np.stack([(other[0][i][0] - position) / h for other, h in zip(shifted, steps, strict=True)], axis=-1)
        Jt = np.stack([(other[0][i][1] - turn) / h for other, h in zip(shifted, steps, strict=True)], axis=-1)
        problem.weights[i] = _robust_sample_weights(position, turn, problem.noise_model)
        root = np.sqrt(problem.weights[i])
        Wr = root[:, None] * W * root[None, :]
        information += np.einsum("iap,ij,jaq->pq", Jp, Wr, Jp, optimize=True)
        gradient += np.einsum("iap,ij,ja->p", Jp, Wr, position, optimize=True)
        wt = problem.weights[i] / problem.noise_model.sigma_turn_rad**2
        information += np.einsum("iap,i,iaq->pq", Jt, wt, Jt, optimize=True)
        gradient += np.einsum("iap,i,ia->p", Jt, wt, turn, optimize=True)
    for i, (_, W, _) in enumerate(problem.looks):
        J = np.column_stack([(other[1][i] - looks[i]) / h for other, h in zip(shifted, steps, strict=True)])
        information += J.T @ W @ J
        gradient += J.T @ W @ looks[i]
    information[-N_LENS:, -N_LENS:] += problem.lens_evidence.information
    gradient[-N_LENS:] += (
        problem.lens_evidence.information @ state.lens_corrections - problem.lens_evidence.information_vector
    )
    return information, gradient


def _robust_sample_weights(position: Array, turn: Array, noise: NoiseModel) -> Array:
    """Weight of each sample: 1 unless it lies off its neighbours by more than noise can put it.

    Model:   r^2 up to k, k^2 (1 + 2 log(r / k)) beyond, so the weight is (k / r)^2: a jump of centimetres, as odometry
             makes where something moves in the picture, would keep too much with Huber's k / r. The scale of r is the
             first guess of the scatter, not the run's own, which the jumps themselves would raise until they pass.
    """
    smooth = np.median(position, axis=0) if len(position) < 5 else _running_median(position)
    off = np.linalg.norm(position - smooth, axis=1) / (np.sqrt(3.0) * 1.5 * noise.sigma_position_m)
    turned = np.linalg.norm(turn, axis=1) / (np.sqrt(3.0) * 3.0 * noise.sigma_turn_rad)
    worst = np.maximum(off, turned)
    return np.where(worst > OUTLIER_SIGMAS, (OUTLIER_SIGMAS / np.maximum(worst, 1e-12)) ** 2, 1.0)


def _running_median(values: Array) -> Array:
    padded = np.pad(values, ((2, 2), (0, 0)), mode="edge")
    return np.median(np.stack([padded[k : k + len(values)] for k in range(5)]), axis=0)


def _judge_estimate(problem: _Problem, state: JointState, information: Array, length_m: float) -> JointEstimate:
    covariance = _inverse_matrix(information)
    fitted = _fit_residuals(problem, state)
    runs, _ = _run_and_look_residuals(problem, state)
    distances = np.concatenate([np.linalg.norm(position, axis=1) for position, _ in runs]) if runs else np.zeros(1)
    left = np.trace(covariance[problem.mount, problem.mount]) / float(np.sum(problem.prior_sigma[problem.mount] ** 2))
    status, reason = fit_verdict(fitted)
    good = status is CalibrationStatus.OK
    return JointEstimate(
        status=status,
        reason=reason,
        error_model=problem.error_model,
        state=state if good else None,
        covariance=covariance_widened_by_misfit(covariance, fitted.worst_mean_square) if good else None,
        residual_rms_mm=1e3 * float(np.sqrt(np.mean(distances**2))),
        residual_max_mm=1e3 * float(distances.max()),
        misfit=fitted.worst_mean_square,
        n_samples=int(sum(len(samples.t_s) for _, samples, _ in problem.odometry_runs)),
        n_looks=len(problem.looks),
        path_length_m=length_m,
        observability=float(np.clip(1.0 - left, 0.0, 1.0)),
        noise_model=problem.noise_model,
    )


def _fit_residuals(problem: _Problem, state: JointState) -> FitResiduals:
    runs, looks = _run_and_look_residuals(problem, state)
    positions, turns, spreads = [], [], []
    largest = problem.noise_model.sigma_position_range_m[1] ** 2
    for (position, turn), (_, _, W), weights in zip(runs, problem.odometry_runs, problem.weights, strict=True):
        weighted = np.sqrt(weights)[:, None] * position
        positions.append(float(np.einsum("ia,ij,ja->", weighted, W, weighted)) / position.size)
        spreads.append(float(np.mean(weighted**2)) / largest)
        turns.append(float(np.sum(weights[:, None] * turn**2)) / (turn.size * problem.noise_model.sigma_turn_rad**2))
    off = state.step_from(problem.prior_state)
    mount, seeing = off[problem.mount], (off / problem.prior_sigma)[-CAMERA_PARAMETERS_DOF:]
    return FitResiduals(
        look_chi2=[float(residual @ W @ residual) for residual, (_, W, _) in zip(looks, problem.looks, strict=True)],
        run_position=positions,
        run_turn=turns,
        run_spread=spreads,
        weights=problem.weights,
        mount_chi2=float(np.sum((mount / problem.prior_sigma[problem.mount]) ** 2)),
        mount_rad=float(np.linalg.norm(mount)),
        camera_parameter_chi2=float(seeing @ seeing),
    )


def _refused_estimate(model: ErrorModel, status: CalibrationStatus, reason: str, length_m: float) -> JointEstimate:
    nothing = float("nan")
    return JointEstimate(status, reason, model, None, None, nothing, nothing, nothing, 0, 0, length_m, 0.0)
