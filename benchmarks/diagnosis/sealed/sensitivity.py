"""The scorer's own whitened sensitivity: how far an effect moves what was measured, in units of the floor.

Each stage is run with the same measured input with and without the effect, by the plant itself. The floor is the noise
that the generator draws, and what the machine file's baseline says it leaves and its numbers wander by ([[remainder]]);
nothing of the tool.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.diagnosis.sealed import behind, own_plant
from benchmarks.diagnosis.sealed import faults as f
from benchmarks.diagnosis.sealed import nominal_own as own
from benchmarks.diagnosis.sealed.faults import Faults, Injected, faults_of
from benchmarks.diagnosis.sealed.filters import filtered_by, whitened_by
from benchmarks.diagnosis.sealed.link import received
from benchmarks.diagnosis.sealed.plants import Arm, Plant
from benchmarks.diagnosis.sealed.recorded import CAMERA_S, STATIC, TRACKER_S, Made, Noise, streams
from benchmarks.diagnosis.sealed.scales import BY_NAME, Kind
from benchmarks.diagnosis.sealed.whitening import beside, covariance_of, filtered, process
from machine.remainder import Remainder
from machine.rotations import Array

BLOCK = round(0.05 / own.CYCLE_S)
LEAST = {"link": 2e-5, "controller": 2e-4, "actuator": 2e-6}  # smaller moves the tip by less than 0.1 mm
FOUND = 24.7  # |s|^2 that is found with 90 % at 2 % false alarms
OF_PLANT = ("payload_error",)  # the plant itself has to be run again
Signature = dict[str, Array]  # by cell (N,); (2, N) where two draws of the disturbance tell what it does beside chance


@dataclass
class Scene:
    """What one recording without faults looked like, to be disturbed."""

    made: Made
    noise: Noise
    seed: int
    remainders: tuple[Remainder, ...]
    shock: Array  # the disturbance as it was drawn: the same commands and shocks give the same motion again
    again: tuple[Array, own_plant.Course] | None = None  # `again_of` once it was asked for
    speed_noise: Array | None = None  # `speed_noise_of` once it was asked for
    plain: dict[str, Array] = field(default_factory=dict)  # what is measured behind the joints, noise-free
    place: list[Array] = field(default_factory=list)  # change of the corners with the object's place
    wander: dict[tuple[str, int], Array] = field(default_factory=dict)  # `wander_of` once it was asked for

    def record(self, stage: str, joint: int | None = None, on: str = "") -> Remainder:
        """What the baseline leaves there; nothing where the file has no record."""
        found = [one for one in self.remainders if (one.stage, one.joint, one.on) == (stage, joint, on)]
        return found[0] if found else Remainder(stage, joint, on, 0.0, 0.0)

    def by_axis(self, stage: str, on: str, axes: int) -> Array:
        """What the baseline leaves of points or corners along each axis (axes,)."""
        found = self.record(stage, None, on)
        return np.array(found.by_axis if len(found.by_axis) == axes else [found.sigma] * axes)


def scene_of(made: Made, noise: Noise, seed: int, remainders: tuple[Remainder, ...]) -> Scene:
    """A recording without faults, with its floor."""
    shock = streams(seed)["plant"].normal(0.0, noise.speed, made.ref.shape)
    return Scene(made, noise, seed, remainders, shock)


def speed_noise_of(scene: Scene) -> Array:
    """Autocovariance (ORDER + 1, joints) of the encoders' increments by disturbance: a second run with another."""
    if scene.speed_noise is None:
        apart = (again_of(scene)[1].enc - scene.made.course.enc) / np.sqrt(2.0)
        steps = np.diff(_means(apart), axis=0)
        scene.speed_noise = np.stack([covariance_of(column) for column in steps.T], axis=1)
    return scene.speed_noise


def again_of(scene: Scene) -> tuple[Array, own_plant.Course]:
    """Another disturbance's innovations (m, n), and the same commands with it."""
    if scene.again is None:
        made = scene.made
        shock = np.random.default_rng([scene.seed, 99]).normal(0.0, scene.noise.speed, made.ref.shape)
        scene.again = shock, made.plant.run(faults_of((), own.N), made.ref, shock, made.course.u)
    return scene.again


def _means(values: Array) -> Array:
    rows = len(values) // BLOCK * BLOCK
    return values[:rows].reshape(-1, BLOCK, values.shape[1]).mean(axis=1)


def signature(scene: Scene, one: Injected) -> Signature:
    """Change of every cell's residual by one effect, in floors."""
    stage = BY_NAME[one.name].stage if one.name in BY_NAME else "actuator"
    faults = faults_of((one,), own.N)
    if one.name in OF_PLANT:
        return _by_plant(scene, faults)
    if stage == "link":
        return _link(scene, faults)
    if stage == "controller":
        return _controller(scene, faults)
    if stage == "actuator":
        return _actuator(scene, faults)
    return _behind(scene, faults)


def size2(found: Signature) -> float:
    """|s|^2 over all cells."""
    return max(0.0, sum(_product(part, part) for part in found.values()))


def separation(a: Signature, b: Signature) -> float:
    """T: least |a - k b|^2 over the size k."""
    aa, bb = size2(a), size2(b)
    ab = sum(_product(a[name], b[name]) for name in set(a) & set(b))
    return aa if bb == 0.0 else max(0.0, aa - ab * ab / bb)


def _product(a: Array, b: Array) -> float:
    """a b, of two draws each by the other's: an effect also shifts when the oil swings, which only somebody who knows
    the disturbance could foretell. What is so by chance has no part in the product of two draws.
    """
    return float(a @ b) if a.ndim == 1 else 0.5 * float(a[0] @ b[1] + a[1] @ b[0])


def sized(kind: Kind, shaped: Injected, size: float) -> Injected:
    """The same effect at another size, its sign kept."""
    sign = -1.0 if shaped.size < 0.0 else 1.0
    return replace(shaped, values={**shaped.values, kind.parameter: sign * size})


def _link(scene: Scene, faults: Faults) -> Signature:
    sides = []
    for one in (faults_of((), own.N), faults):
        rng = streams(scene.seed)["link"]
        sides.append(received(one, scene.made.sent, scene.made.t_sent_s, scene.made.t_s, 0.0, rng)[0])
    jittered = received(
        faults_of((), own.N), scene.made.sent, scene.made.t_sent_s, scene.made.t_s, scene.noise.jitter_s,
        streams(scene.seed)["link"],
    )[0]  # fmt: skip
    noise = np.std(np.diff(_means(jittered - sides[0]), axis=0), axis=0)
    steps = np.diff(_means(sides[1] - sides[0]), axis=0) / np.hypot(noise, LEAST["link"])
    return {"link": steps.T.ravel()}


def _controller(scene: Scene, faults: Faults) -> Signature:
    ref, enc = scene.made.ref, scene.made.course.enc
    out: Signature = {}
    commands = [_commands(scene.made.plant, one, ref, enc) for one in (faults_of((), own.N), faults)]
    steps = np.diff(_means(commands[1] - commands[0]), axis=0)
    for j in range(own.N):
        record = scene.record("controller", j + 1)
        out[f"controller {j + 1}"] = whitened_by(np.array(record.ar), steps[:, j]) / np.hypot(
            LEAST["controller"], record.sigma
        )
    return out


def _commands(plant: Plant, faults: Faults, ref: Array, enc: Array) -> Array:
    out = np.zeros_like(ref)
    for j, joint in enumerate(plant.joints):
        wanted = joint.kp_frac_per_rad * (1.0 + faults.joint[j, f.KP_GAIN]) * (ref[:, j] - enc[:, j])
        tau = joint.pt1_tau_s * (1.0 + faults.joint[j, f.KP_LAG])
        share = 1.0 - np.exp(-own.CYCLE_S / tau) if tau > 0.0 else 1.0
        lagged = filtered_by(np.array([share]), np.array([1.0, share - 1.0]), wanted)
        most = faults.joint[j, f.U_LIMIT]
        out[:, j] = np.clip(lagged, -most, most)
    return out


def _actuator(scene: Scene, faults: Faults) -> Signature:
    return encoder_signature(scene, changes(scene, driven(scene, faults)))


def _draws(scene: Scene) -> tuple[tuple[Array, own_plant.Course], tuple[Array, own_plant.Course]]:
    """Two disturbances, each with what the machine without faults did in it."""
    return (scene.shock, scene.made.course), again_of(scene)


def driven(scene: Scene, faults: Faults) -> tuple[own_plant.Course, own_plant.Course]:
    """The same commands, with each of two disturbances, through a plant with faults that stays where it was."""
    made = scene.made
    first, second = (
        made.plant.run(faults, made.ref, shock, made.course.u, plain.smooth) for shock, plain in _draws(scene)
    )
    return first, second


def changes(scene: Scene, moved: tuple[own_plant.Course, own_plant.Course]) -> Array:
    """How the encoders (2, m, n) are changed."""
    return np.stack([one.smooth - plain.smooth for one, (_, plain) in zip(moved, _draws(scene), strict=True)])


def encoder_signature(scene: Scene, change: Array) -> Signature:
    """A change of the encoders (2, m, n) under the same commands, in floors."""
    draws, days = [np.diff(_means(one), axis=0) for one in change], wander_of(scene)
    out: Signature = {}
    for j in range(own.N):
        record = scene.record("actuator", j + 1)
        both = process(record.ar, record.sigma) + speed_noise_of(scene)[:, j]
        seen = (*(one[:, j] for one in draws), *(days[name, j + 1] for name, _ in record.wander))
        first, second, *columns = (filtered(one, both, LEAST["actuator"]) for one in seen)
        out[f"actuator {j + 1}"] = np.stack([beside(row, columns) for row in (first, second)])
    return out


def wander_of(scene: Scene) -> dict[tuple[str, int], Array]:
    """Change of a joint's increments (m,) by what a number of it is off by from day to day, by name and joint.

    The first name of every joint in one run, then the second ones: each is felt by its own encoder.
    """
    if not scene.wander:
        off = {one.joint: one.wander for one in scene.remainders if one.stage == "actuator" and one.joint is not None}
        for turn in range(max(map(len, off.values()), default=0)):
            now = {joint: names[turn] for joint, names in off.items() if turn < len(names)}
            faults = faults_of(
                tuple(
                    Injected(name, j, {BY_NAME[name].parameter: size})
                    for j, (name, size) in now.items()
                    if name in BY_NAME
                ),
                own.N,
            )
            steps = np.diff(_means(changes(scene, driven(scene, faults)).mean(axis=0)), axis=0)
            scene.wander |= {(name, joint): steps[:, joint - 1] for joint, (name, _) in now.items()}
    return scene.wander


def _moved(scene: Scene, faults: Faults) -> Array:
    """True angles of the tree (m, k) with the same encoder readings, through other encoders and wider play."""
    q, plant = scene.made.course.tree_q.copy(), scene.made.plant
    encoder = own_plant.encoder_rows(faults, own.N)
    enc = scene.made.course.enc
    if encoder[:, :3].any():
        true = enc.copy()
        for _ in range(20):
            wave = encoder[:, 2] * np.sin(encoder[:, 3] * true + encoder[:, 4])
            true = (enc - encoder[:, 0] - wave) / (1.0 + encoder[:, 1])
        q[:, list(plant.motors)] += true - enc
    for one in faults.injected:
        if one.name == "backlash" and one.joint is not None:
            i, width = plant.motors[one.joint - 1], one.size + plant.play_rad[one.joint - 1]
            q[:, i] = _play(enc[:, one.joint - 1], 0.5 * width)
    return behind.swung(faults, q, plant.motors)


def _play(x: Array, half: float) -> Array:
    y = np.empty_like(x)
    at = x[0]
    for k, value in enumerate(x):
        at = min(max(at, value - half), value + half)
        y[k] = at
    return y


def _behind(scene: Scene, faults: Faults) -> Signature:
    return _in_floors(scene, _plain(scene), _measured(scene, faults, _moved(scene, faults)))


def _plain(scene: Scene) -> dict[str, Array]:
    if not scene.plain:
        scene.plain = _measured(scene, faults_of((), own.N), scene.made.course.tree_q)
    return scene.plain


def _by_plant(scene: Scene, faults: Faults) -> Signature:
    moved = driven(scene, faults)
    bent = scene.made.course.tree_q.copy()  # the same encoder readings: where the joints went is theirs to tell
    springs = list(scene.made.plant.springs)
    bent[:, springs] = moved[0].tree_q[:, springs]
    second = _measured(scene, faults, bent)
    driven_too = encoder_signature(scene, changes(scene, moved))
    return {**_in_floors(scene, _plain(scene), second), **driven_too}


def _measured(scene: Scene, faults: Faults, tree_q: Array) -> dict[str, Array]:
    """Noise-free tracker, poses at rest and corners."""
    made, plant = scene.made, scene.made.plant
    arm, sight = plant.arm(faults), behind.sight_of(faults)
    when = np.arange(0.5, made.t_s[-1] - 0.5, TRACKER_S)
    tracker = [list(arm.points(q).values()) for q in behind.at_times(made.t_s, tree_q, when)]
    _, trees = plant.rest_poses(faults, streams(scene.seed)["static"], STATIC)
    static = [list(arm.points(q).values()) for q in trees]
    stamps = np.arange(0.6, made.t_s[-1] - 0.6, CAMERA_S)
    seen = (stamps - sight.late_s) / (1.0 + sight.rate)  # the same stamps show another moment
    ooi = [
        _corners(arm, plant.T_base_ooi(), sight, q, later)
        for q, later in zip(
            behind.at_times(made.t_s, tree_q, seen), behind.at_times(made.t_s, tree_q, seen + 0.01), strict=True
        )
    ]
    T_tool = np.linalg.inv(sight.T_tcp_cam) @ own.T_tcp_marker_tool()
    tool = behind.corners(sight, np.eye(4), T_tool, own.TOOL_SIDE_M, np.zeros(3))
    return {"tracker": np.array(tracker), "static": np.array(static), "ooi": np.array(ooi), "tool": tool[None]}


def _corners(arm: Arm, T_ooi: Array, sight: behind.Sight, q: Array, later: Array) -> Array:
    sides = []
    for one in (q, later) if sight.readout_s else (q,):
        T = arm.tcp(one) @ sight.T_tcp_cam
        places = [behind.corners(sight, T, T_ooi, own.SIDE_M, np.array(xyz)) for _, *xyz in own.PLACES]
        sides.append(np.array(places))
    if not sight.readout_s:
        return sides[0]
    row = sides[0][..., 1:] / (sight.camera.height_px - 1.0) - 0.5
    return sides[0] + (sides[1] - sides[0]) / 0.01 * row * sight.readout_s


def _in_floors(scene: Scene, first: dict[str, Array], second: dict[str, Array]) -> Signature:
    out: Signature = {}
    for on in ("tracker", "static"):
        sigma = np.hypot(scene.noise.tracker_m, scene.by_axis("structure", on, 3))
        change = _about_upright(second[on] - first[on], first[on]) / sigma
        out[on] = _less_swing(change, first[on], scene.record("structure", None, on).oscillation_rad / sigma[1]).ravel()
    out["ooi"] = _without_place(scene, first["ooi"], second["ooi"] - first["ooi"])
    frames = len(first["ooi"])  # the tool is seen in each of them
    out["tool"] = (_white(scene, "tool", second["tool"] - first["tool"]) * np.sqrt(frames)).ravel()
    return {name: np.nan_to_num(part) for name, part in out.items()}


def _less_swing(change: Array, at: Array, swing: float) -> Array:
    """Changes (instants, points, 3) in floors: what an instant's points go across together counts beside the swing that
    they share.
    """
    rho = np.hypot(at[..., 0], at[..., 1])
    size2 = (rho**2).sum(axis=1, keepdims=True)
    along = (rho * change[..., 1]).sum(axis=1, keepdims=True) / size2
    out = change.copy()
    out[..., 1] -= (1.0 - 1.0 / np.sqrt(1.0 + swing**2 * size2)) * along * rho
    return out


def _about_upright(change: Array, at: Array) -> Array:
    """Changes (..., 3) of points `at` (..., 3) as radial, tangential, up: the remainder differs along them."""
    r = np.hypot(at[..., 0], at[..., 1])
    c, s = at[..., 0] / r, at[..., 1] / r
    x, y, z = np.moveaxis(change, -1, 0)
    return np.stack([c * x + s * y, c * y - s * x, z], axis=-1)


def _white(scene: Scene, on: str, corners: Array) -> Array:
    """Corners (frames, ..., 2) in floors: each has its own noise, and all of a frame share what the arm is off by."""
    record = scene.record("camera", None, on)
    own = np.hypot(scene.noise.corner_px, record.sigma)
    shared = np.array(record.by_axis) if record.by_axis else np.zeros(2)
    some = np.isfinite(corners)
    axes = tuple(range(1, corners.ndim - 1))
    count = some.sum(axis=axes, keepdims=True)
    mean = np.nan_to_num(corners).sum(axis=axes, keepdims=True) / np.maximum(count, 1)
    return np.nan_to_num((corners - (1.0 - own / np.sqrt(own**2 + count * shared**2)) * mean) / own)


def _without_place(scene: Scene, corners: Array, change: Array) -> Array:
    """A change of the corners, in floors, less what another place of the object gives: nobody knows where it stands."""
    if not scene.place:
        scene.place = [_place_columns(scene, corners)]
    columns = [_white(scene, "ooi", column.reshape(change.shape)) for column in scene.place[0].T]
    A, b = np.array([column.ravel() for column in columns]).T, _white(scene, "ooi", change).ravel()
    return b - A @ np.linalg.lstsq(A, b, rcond=None)[0]


def _place_columns(scene: Scene, corners: Array) -> Array:
    """Change of the corners (N, 6) per m and rad of the object's place."""
    plant = scene.made.plant
    sight, arm, T_ooi = behind.sight_of(faults_of((), own.N)), plant.arm(faults_of((), own.N)), plant.T_base_ooi()
    stamps = np.arange(0.6, scene.made.t_s[-1] - 0.6, CAMERA_S)
    trees = behind.at_times(scene.made.t_s, scene.made.course.tree_q, stamps)
    cameras = [arm.tcp(q) @ sight.T_tcp_cam for q in trees]
    columns = []
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-4
        moved = T_ooi @ _small(step)
        pixels = [
            [behind.corners(sight, T, moved, own.SIDE_M, np.array(xyz)) for _, *xyz in own.PLACES] for T in cameras
        ]
        columns.append(((np.array(pixels) - corners) / 1e-4).ravel())
    return np.nan_to_num(np.array(columns).T)


def _small(x: Array) -> Array:
    T = np.eye(4)
    T[:3, :3] = behind.rotation_from_rotvec(x[3:])
    T[:3, 3] = x[:3]
    return T
