"""One film through the odometry, judged."""

import time
from dataclasses import asdict, dataclass
from typing import Any

from benchmarks.vision.odometry.disturbances import Disturbance, Showing
from benchmarks.vision.odometry.film import Film, FilmCase, nominal_machine
from benchmarks.vision.odometry.judged import figures_of, judge
from server.vision.odometry import OdometrySettings, StereoOdometry


@dataclass(frozen=True, slots=True)
class Run:
    """A film, what is done to it, and what the odometry is told of the camera."""

    film: FilmCase
    disturbance: Disturbance = "none"
    readout_known: bool = True

    @property
    def name(self) -> str:
        """One word, good as a file name."""
        extra = "" if self.disturbance == "none" else "-" + self.disturbance.replace(" ", "")
        return f"{self.film.name}{extra}{'' if self.readout_known else '-noreadout'}"


def run_film(run: Run, film: Film) -> dict[str, Any]:
    """Figures of one run, as JSON. The calibration is exact, so no scale error is allowed for, unless it is biased."""
    scale = OdometrySettings().sigma_scale_frac if run.film.disparity_bias_px else 0.0
    settings = OdometrySettings(sigma_scale_frac=scale, readout_s=film.readout_s if run.readout_known else None)
    odometry = StereoOdometry(nominal_machine().camera, settings)
    showing = Showing(film, run.disturbance)
    poses, ms = [], []
    for number in showing.numbers:
        left, right = showing.pair(number)
        started = time.thread_time()
        poses.append(
            odometry.process(left, right, film.t_exposure_ns[number], [film.tool_left_px], [film.tool_right_px])
        )
        ms.append(1e3 * (time.thread_time() - started))
    Ts_true = film.Ts_vo_cam[list(showing.numbers)]
    figures = figures_of(judge(poses, Ts_true, ms, len(odometry.keyframes)), Ts_true)
    return {"name": run.name, **asdict(run), "figures": asdict(figures)}
