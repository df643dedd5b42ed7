"""Does the fast world err as the rendered one does: errors of both, each half judged by the other half's fit."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from benchmarks.reproduce.fast_camera import FastCamera, Source
from benchmarks.reproduce.fast_odometry import odometry_path
from benchmarks.reproduce.noise_fit import Agreement, agreement, fit_corner_noise, pose_errors
from benchmarks.reproduce.noise_gather import preset_of
from benchmarks.reproduce.noise_model import CornerNoise, LookNoise, NoiseModel, OdometryNoise
from benchmarks.reproduce.odometry_fit import OdometryRunPair, fit_odometry_noise
from benchmarks.reproduce.rendered_looks import RenderedLook
from benchmarks.reproduce.rendered_paths import RenderedPath
from benchmarks.reproduce.true_corners import ObjectOn
from machine.description import Machine
from machine.rotations import Array, rotvec_from_rotation
from server.calibration.chords import arc_lengths
from sim_plc.draw_world import draw_world
from sim_plc.world import rng_for

DRAWS = 6  # fast errors for each rendered one
CHORD_M = 0.08  # over which the registration takes its vectors
SOURCES: tuple[Source, ...] = ("stereo", "mono")
OBJECTS: tuple[ObjectOn, ...] = ("tool", "ooi")


@dataclass(frozen=True, slots=True)
class Compared:
    """One quantity: rendered (n, 6), fast (m, 6) errors, (tilt, tilt, roll) [rad], (x, y, z) [m]; their likeness."""

    name: str
    rendered: Array
    fast: Array
    rows: tuple[Agreement, ...]


def fit_all(looks: Sequence[RenderedLook], paths: Sequence[RenderedPath], machine: Machine, source: str) -> NoiseModel:
    """The whole model.

    Raises: TooFewLooksError, TooFewRunsError.
    """

    def corner(name: Source, on: ObjectOn) -> CornerNoise:
        return fit_corner_noise([look for look in looks if look.source == name and look.on == on], machine)

    stereo, mono = (LookNoise(tool=corner(name, "tool"), ooi=corner(name, "ooi")) for name in SOURCES)
    return NoiseModel(stereo, mono, fit_odometry_noise([path.against_bent for path in paths]), source)


def compare(looks: Sequence[RenderedLook], paths: Sequence[RenderedPath], machine: Machine) -> list[Compared]:
    """Odd machines judged by the fit of the even ones and the other way round."""
    halves = []
    for odd in (False, True):
        mine = [look for look in looks if look.seed % 2 == odd]
        own = [path for path in paths if path.seed % 2 == odd]
        halves.append((mine, own))
    (looks_a, paths_a), (looks_b, paths_b) = halves
    model_a, model_b = (fit_all(mine, own, machine, "half") for mine, own in halves)
    pairs = [(looks_a, paths_a, model_b), (looks_b, paths_b, model_a)]
    found = []
    for name, on in product(SOURCES, OBJECTS):
        parts = [_look_errors(mine, name, on, model, machine) for mine, _, model in pairs]
        found.append(_compared(f"{name}, {on}", parts, len({look.seed for look in looks})))
    chords = [_chord_errors(own, model.odometry) for _, own, model in pairs]
    found.append(_compared("odometry, chord", chords, len(paths)))
    return found


def _compared(name: str, parts: Sequence[tuple[Array, Array]], n_machines: int) -> Compared:
    rendered, fast = (np.concatenate([part[k] for part in parts]) for k in range(2))
    return Compared(name, rendered, fast, agreement(rendered, fast, n_machines))


def _look_errors(
    looks: Sequence[RenderedLook], source: Source, on: ObjectOn, model: NoiseModel, machine: Machine
) -> tuple[Array, Array]:
    """Errors of one pair against exact corners: the first rendered one of each look, and `DRAWS` fast ones."""
    rendered, fast = [], []
    for look in looks:
        if look.source != source or look.on != on:
            continue
        rendered.append(pose_errors(look.Ts_cam_measured[0], look.T_cam_exact))
        fast += list(_fast_errors(look, model, machine))
    return np.array(rendered).reshape(-1, 6), np.array(fast).reshape(-1, 6)


def _fast_errors(look: RenderedLook, model: NoiseModel, machine: Machine) -> Iterator[Array]:
    world = draw_world(machine, preset_of(look.seed), look.seed)
    for draw in range(DRAWS):
        another = replace(world, seed=1_000_000 * (draw + 1) + world.seed)  # another tool print, the same truth
        camera = FastCamera(another, model, rng_for(look.seed, f"fast look {draw} {look.T_base_tcp[0, 3]}"))
        found = getattr(camera.pair(look.T_base_tcp, look.source, 0), look.on)
        if found.T_cam_object is not None:
            yield pose_errors(found.T_cam_object, look.T_cam_exact)


def _chord_errors(paths: Sequence[RenderedPath], noise: OdometryNoise) -> tuple[Array, Array]:
    rendered, fast = [], []
    for path in paths:
        run = path.against_bent
        rendered.append(chord_errors(run))
        for draw in range(DRAWS):
            Ts = odometry_path(run.Ts_true, noise, rng_for(path.seed, f"fast path {draw}"))
            fast.append(chord_errors(OdometryRunPair(Ts, run.Ts_true, run.rate_hz)))
    return np.concatenate(rendered), np.concatenate(fast)


def chord_errors(run: OdometryRunPair) -> Array:
    """Errors (n, 6) of chords of `CHORD_M` laid end to end: rotation [rad] and vector [m], vo axes."""
    arc = arc_lengths(run.Ts_true[:, :3, 3])
    ends = np.unique(np.searchsorted(arc, np.arange(0.0, arc[-1], CHORD_M)))
    found, true = run.Ts_vo_cam[ends], run.Ts_true[ends]
    vectors = np.diff(found[:, :3, 3], axis=0) - np.diff(true[:, :3, 3], axis=0)
    turns = np.array([rotvec_from_rotation(a[:3, :3] @ b[:3, :3].T) for a, b in zip(found, true, strict=True)])
    return np.hstack((np.diff(turns, axis=0), vectors))
