"""Taught objects in rendered pairs of drawn worlds: taught beside the markers, recognised elsewhere without them."""

from dataclasses import asdict, dataclass, replace

import numpy as np

from benchmarks.reproduce.fast_cell import context_of
from benchmarks.simulator.demo_scene import demo_tcp_pose
from benchmarks.targets.rendered import NOT_CHOSEN, PRESET, UNREACHABLE, PointCase
from benchmarks.targets.scene import left_eye
from benchmarks.targets.virtual_jobs import tool_mask, virtual_bench
from machine.description import Machine
from machine.poses import inverse_pose, pose
from machine.rotations import Array, geodesic_angle, rotation_about, rotation_from_rotvec, rotvec_from_rotation
from server.camera.target_measuring import KeptPair, view_by_markers
from server.jobs.context import PlanContext
from server.jobs.plans.seeing import common_of
from server.targets.contracts import TargetFix, TargetSettings
from server.targets.source import TargetPoseSource
from server.targets.taught import ObjectBox, TaughtObject, TaughtView, teach_object
from server.targets.taught_tracking import TaughtTracker
from server.vision.aruco_source import ArucoPoseSource
from server.vision.contracts import Image, PairObservation
from sim_plc.camera.fixtures import BOLT_PLATE_SIZE_M
from sim_plc.camera.renderer import StereoRenderer
from sim_plc.draw_scene import with_bare_rock
from sim_plc.draw_world import draw_world
from sim_plc.presets import PresetError
from sim_plc.world import FixtureTruth, World

CENTRE_M = (0.55, 0.1, 0.0)  # of the plate against the markers, while it is taught
BOX_M = (BOLT_PLATE_SIZE_M[0] + 0.02, BOLT_PLATE_SIZE_M[1] + 0.02, 0.14)
TEACH_FROM_M = ((0.0, 0.0), (0.2, -0.15), (0.3, -0.1), (0.1, -0.25))  # of the tool, across the markers
COVER_FRAC = 0.3
LIGHT_FRAC, GRADIENT_FRAC = (0.5, 1.4), 0.4  # of the light while teaching; darker to one side of the image
APART_M = 0.6  # of twins: the plate's width and a gap
PLACES = 6  # of the fixture, until one is reachable
KINDS = ("light", "light, 30 % covered", "another plate", "3 % larger", "a row moved 15 mm", "twins in view")
GENUINE = KINDS[:2]


@dataclass(frozen=True, slots=True)
class TaughtCase:
    """One look. chi2: of the error against the stated covariance, position and rotation, 3 degrees of freedom each."""

    seed: int
    kind: str
    served: bool
    reason: str
    distance_m: float
    position_mm: float
    rotation_deg: float
    chi2_position: float
    chi2_rotation: float

    @property
    def taken(self) -> bool:
        """Whether a look-alike was served as the object."""
        return self.served and self.kind not in GENUINE


class _Stage:
    """The camera of one drawn world before its wall, at any place."""

    def __init__(self, world: World) -> None:
        machine = world.nominal
        self.world = world
        self._renderer = StereoRenderer(world)
        self._source = TargetPoseSource(ArucoPoseSource(machine), machine.camera, tool_mask(machine))

    def show(
        self, T_ooi_tcp: Array, fixtures: tuple[FixtureTruth, ...], rng: np.random.Generator, relit: bool
    ) -> tuple[KeptPair, PairObservation, Array]:
        """A pair, and the true T_ooi_cam of the left eye."""
        T_base_tcp = self.world.scene.T_base_ooi @ T_ooi_tcp
        self._renderer.show_fixtures(fixtures)
        left, right = self._renderer.render_static(T_base_tcp, rng)
        if relit:
            left, right = _relit(left, right, rng)
        seen = self._source.observe(left, right, 0)
        masks = self._source.masks_px
        pair = KeptPair(0, left, right, (tuple(masks[0]), tuple(masks[1])), seen)
        return pair, seen, left_eye(self._renderer, T_base_tcp)


def taught_cases(machine: Machine, seed: int) -> list[TaughtCase]:
    """One object, taught by four views of a drawn world, and one look of each kind."""
    try:
        drawn = draw_world(machine, PRESET, seed)
    except PresetError:
        return []
    rng, settings = np.random.default_rng([seed, 0x746175676874]), TargetSettings()
    taught = teach(drawn, seed, rng, settings)
    if isinstance(taught, str):
        return [TaughtCase(seed, kind, False, f"not taught: {taught}", *[np.nan] * 5) for kind in GENUINE]
    stage, ctx = _Stage(with_bare_rock(drawn)), context_of(drawn, "ours")
    ctx.knowledge.target = taught
    return [_look(stage, ctx, taught, kind, seed, rng, settings) for kind in KINDS]


def teach(world: World, seed: int, rng: np.random.Generator, settings: TargetSettings) -> TaughtObject | str:
    """The plate beside the markers, taught by a few views."""
    machine, stage = world.nominal, _Stage(world)
    box = ObjectBox(np.array(CENTRE_M), np.array(BOX_M))
    fixture = FixtureTruth(seed, pose(np.eye(3), box.centre_m))
    views: list[TaughtView] = []
    reasons: list[str] = []
    for across in TEACH_FROM_M:
        tilt = pose(rotation_from_rotvec(np.deg2rad(rng.uniform(-8.0, 8.0, 3))), np.zeros(3))
        shown, seen, _ = stage.show(
            demo_tcp_pose(machine, rng.uniform(0.3, 0.5), across) @ tilt, (fixture,), rng, False
        )
        view = view_by_markers(shown, seen, machine.camera, box, settings)
        if isinstance(view, str):
            reasons.append(view)
        else:
            views.append(view)
    found = teach_object(f"plate {seed}", views, box, machine.camera, settings)
    return f"{found}; views refused: {reasons}" if isinstance(found, str) else found


def _look(
    stage: _Stage,
    ctx: PlanContext,
    taught: TaughtObject,
    kind: str,
    seed: int,
    rng: np.random.Generator,
    settings: TargetSettings,
) -> TaughtCase:
    """The object, or what looks like it, somewhere on the wall, from somewhere before it, in another light."""
    T_ooi_fixture = _place(rng, 0.2)
    machine = ctx.machine
    distance, tilt = (
        float(rng.uniform(0.2, 0.6)),
        pose(rotation_from_rotvec(np.deg2rad(rng.uniform(-8, 8, 3))), np.zeros(3)),
    )
    across = (
        float(T_ooi_fixture[0, 3] + rng.uniform(-0.15, 0.15)),
        float(T_ooi_fixture[1, 3] + rng.uniform(-0.15, 0.05)),
    )
    fixtures = _fixtures(kind, seed, T_ooi_fixture)
    shown, seen, T_ooi_cam = stage.show(demo_tcp_pose(machine, distance, across) @ tilt, fixtures, rng, True)
    fix = TaughtTracker(taught, machine.camera, settings).find_target(shown.left, shown.right, shown.masks_px)
    return _judged(ctx, seed, kind, fix, inverse_pose(T_ooi_cam) @ T_ooi_fixture, seen)


def _fixtures(kind: str, seed: int, T_ooi_fixture: Array) -> tuple[FixtureTruth, ...]:
    genuine = FixtureTruth(seed, T_ooi_fixture)
    beside = T_ooi_fixture @ pose(np.eye(3), np.array([-APART_M, 0.0, 0.0]))
    return {
        KINDS[0]: (genuine,),
        KINDS[1]: (replace(genuine, cover_frac=COVER_FRAC),),
        KINDS[2]: (replace(genuine, variant="other"),),
        KINDS[3]: (replace(genuine, variant="scaled"),),
        KINDS[4]: (replace(genuine, variant="row"),),
        KINDS[5]: (genuine, replace(genuine, T_ooi_fixture=beside)),
    }[kind]


def _place(rng: np.random.Generator, across_m: float) -> Array:
    """T_ooi_fixture: on the wall, turned and tilted."""
    turn = rotation_about("z", np.deg2rad(rng.uniform(-25.0, 25.0)))
    tilt = rotation_from_rotvec(np.deg2rad(rng.uniform(-6.0, 6.0, 3)))
    return pose(turn @ tilt, np.array([*rng.uniform(-across_m, across_m, 2), 0.0]))


def _relit(left: Image, right: Image, rng: np.random.Generator) -> tuple[Image, Image]:
    """Both images under another light, from one side."""
    angle, gain = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*LIGHT_FRAC)
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, left.shape[1]), np.linspace(-1.0, 1.0, left.shape[0]))
    light = gain * (1.0 + GRADIENT_FRAC * (np.cos(angle) * x + np.sin(angle) * y))
    relit = [np.clip(light * image, 0, 255).astype(np.uint8) for image in (left, right)]
    return relit[0], relit[1]


def _judged(ctx: PlanContext, seed: int, kind: str, fix: TargetFix, truth: Array, seen: PairObservation) -> TaughtCase:
    distance = float(np.linalg.norm(truth[:3, 3]))
    T_cam_tool = seen.tool.T_cam_object
    if fix.T_cam_target is None or fix.covariance is None or T_cam_tool is None:
        return TaughtCase(seed, kind, False, fix.reason or seen.tool.reason, distance, *[np.nan] * 4)
    T = fix.T_cam_target
    C = fix.covariance + common_of(ctx, T_cam_tool, T)[6:, 6:]
    shift, turn = T[:3, 3] - truth[:3, 3], rotvec_from_rotation(T[:3, :3] @ truth[:3, :3].T)
    return TaughtCase(
        seed,
        kind,
        True,
        "",
        distance,
        float(1e3 * np.linalg.norm(shift)),
        float(np.rad2deg(geodesic_angle(T[:3, :3], truth[:3, :3]))),
        float(shift @ np.linalg.solve(C[3:, 3:], shift)),
        float(turn @ np.linalg.solve(C[:3, :3], turn)),
    )


def taught_job(machine: Machine, seed: int) -> list[PointCase]:
    """The positioning job in virtual time on a taught object, at a place that the reach preview accepts."""
    try:
        drawn = draw_world(machine, PRESET, seed)
    except PresetError:
        return []
    rng, settings = np.random.default_rng([seed, 0x6A6F62]), TargetSettings()
    none = PointCase(seed, NOT_CHOSEN, "", 0, 0, np.nan, np.nan, (), (), (), False, 0.0)
    taught = teach(drawn, seed, rng, settings)
    if isinstance(taught, str):
        return [replace(none, reason=f"not taught: {taught}")]
    bench = virtual_bench(with_bare_rock(drawn))
    refused: list[str] = []
    for _ in range(PLACES):
        T_ooi_fixture = _place(rng, 0.1)
        bench.camera.renderer.show_fixtures((FixtureTruth(seed, T_ooi_fixture),))
        bench.camera.source.use_target(taught)
        seen, _, _ = bench.pair()
        at = seen.ooi.T_cam_object
        if at is None:
            refused.append(seen.ooi.reason)
        elif bench.reach(seen, taught, at).status == "reachable":
            bench.ctx.knowledge.target = taught
            truth = inverse_pose(bench.T_ooi_cam) @ T_ooi_fixture
            done = bench.positioned(T_ooi_fixture)
            apart_mm = float(1e3 * np.linalg.norm(at[:3, 3] - truth[:3, 3]))
            lost = len(refused) - refused.count(UNREACHABLE)
            counted = replace(none, refused_clicks=lost, unreachable_clicks=refused.count(UNREACHABLE))
            return [replace(counted, **asdict(done), place_mm=apart_mm, seconds=bench.cell.machine.t_s)]
        else:
            refused.append(UNREACHABLE)
    return [replace(none, reason=f"no place was accepted: {refused}")]
