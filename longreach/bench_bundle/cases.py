"""One case of the bench: a data set, a loss and a start, given to every solver and judged by the one cost."""

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from longreach.bench_bundle.solvers import Solved, solve_gtsam, solve_ours, solve_scipy
from longreach.bench_bundle.stereo_data import StereoData, cost_of, squares_px
from machine.rotations import rotation_from_rotvec, rotvec_from_rotation
from recording.files import write_durably

HUBER_PX = 2.0
START_ROTATION_RAD, START_POSITION_M, START_DEPTH_FRAC = 0.01, 0.1, 0.1


@dataclass(frozen=True, slots=True)
class Judged:
    """One solver's result on one case; way is the largest difference to gtsam's poses [rad], [m]."""

    data: str
    loss: str
    start: int
    solver: str
    cost: float
    ratio_to_gtsam: float
    iterations: int
    cpu_ms: float
    way_rad: float
    way_m: float
    behind: int
    ending: str


def disturbed_start(data: StereoData, seed: int) -> StereoData:
    """Another start: poses but the first off by 0.01 rad and 0.1 m, landmarks by 10 % of their distance (sigmas)."""
    rng = np.random.default_rng(seed)
    Ts = data.Ts_vo_cam.copy()
    for T in Ts[1:]:
        T[:3, :3] = rotation_from_rotvec(START_ROTATION_RAD * rng.normal(size=3)) @ T[:3, :3]
        T[:3, 3] += START_POSITION_M * rng.normal(size=3)
    _, first = np.unique(data.points, return_index=True)
    eyes = data.Ts_vo_cam[data.frames[first], :3, 3]
    stretch = np.exp(START_DEPTH_FRAC * rng.normal(size=(len(eyes), 1)))
    return replace(data, Ts_vo_cam=Ts, points_vo=eyes + stretch * (data.points_vo - eyes))


def run_case(data: StereoData, name: str, loss: str, start: int, with_scipy: bool) -> list[Judged]:
    """Every solver on one start; start 0 is the files' own."""
    begun = data if start == 0 else disturbed_start(data, start)
    huber_px = HUBER_PX if loss == "huber" else None
    solved = [solve_gtsam(begun, huber_px), solve_ours(begun, huber_px)]
    if with_scipy and huber_px is None:
        solved.append(solve_scipy(begun))
    return [_judged(begun, name, loss, start, one, solved[0], huber_px) for one in solved]


def _judged(
    data: StereoData, name: str, loss: str, start: int, one: Solved, reference: Solved, huber_px: float | None
) -> Judged:
    squares = squares_px(data, one.Ts_vo_cam, one.points_vo)
    reference_cost = cost_of(squares_px(data, reference.Ts_vo_cam, reference.points_vo), huber_px)
    turned = [
        np.linalg.norm(rotvec_from_rotation(a[:3, :3] @ b[:3, :3].T))
        for a, b in zip(one.Ts_vo_cam, reference.Ts_vo_cam, strict=True)
    ]
    cost = cost_of(squares, huber_px)
    return Judged(
        data=name,
        loss=loss,
        start=start,
        solver=one.solver,
        cost=cost,
        ratio_to_gtsam=cost / reference_cost,
        iterations=one.iterations,
        cpu_ms=1e3 * one.cpu_s,
        way_rad=float(max(turned)),
        way_m=float(np.abs(one.Ts_vo_cam[:, :3, 3] - reference.Ts_vo_cam[:, :3, 3]).max()),
        behind=int(np.isnan(squares).sum()),
        ending=one.ending,
    )


def load_or_run(
    data: StereoData, name: str, loss: str, start: int, with_scipy: bool, folder: Path | None
) -> list[Judged]:
    """A case that is saved already is read, not run again."""
    if folder is None:
        return run_case(data, name, loss, start, with_scipy)
    file = folder / f"{name}-{loss}-{start}{'-scipy' if with_scipy else ''}.json"
    if file.is_file():
        return [Judged(**one) for one in json.loads(file.read_text(encoding="utf-8"))]
    judged = run_case(data, name, loss, start, with_scipy)
    folder.mkdir(parents=True, exist_ok=True)
    write_durably(file, json.dumps([asdict(one) for one in judged], indent=1))
    return judged
