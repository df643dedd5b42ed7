"""Looks without images: exact corners of the drawn world plus fitted noise, then the server's own pose estimation."""

from dataclasses import replace
from typing import Literal

import numpy as np

from benchmarks.reproduce.noise_model import CornerNoise, LookNoise, NoiseModel
from benchmarks.reproduce.true_corners import EYES, EyeName, SeenMarker, TrueView
from machine.rotations import Array
from server.vision.aruco_source import ArucoSettings, MonoArucoPoseSource, markers_by_object, sightings_of
from server.vision.contracts import Look, MarkerView, ObjectPose, PairObservation
from server.vision.look import average_look
from server.vision.object_pose import ObjectName, estimate_object_pose, not_seen
from sim_plc.world import World, rng_for

Source = Literal["stereo", "mono"]


Lasting = dict[tuple[int, EyeName], Array]


class FastCamera:
    """Takes looks and single pairs at true tool poses."""

    def __init__(self, world: World, noise: NoiseModel, rng: np.random.Generator) -> None:
        self._noise, self._rng = noise, rng
        self._view = TrueView(world)
        machine = world.nominal
        self._camera = machine.camera
        self._markers = markers_by_object(machine)
        self._settings = ArucoSettings().pose_estimation
        self._mono = MonoArucoPoseSource(machine)
        own = rng_for(world.seed, "tool corner bias")
        self._bias: Lasting = {
            (marker.marker_id, eye): own.standard_normal((4, 2)) for marker in self._markers["tool"] for eye in EYES
        }

    def look(self, T_base_tcp: Array, pairs: int, source: Source, spread_max_mm: float) -> Look:
        """A look at rest: one pair whose frame noise is that of the mean, counted `pairs` times."""
        one = self.pair(T_base_tcp, source, 0, 1.0 / np.sqrt(pairs))
        return average_look([one] * pairs, spread_max_mm)

    def pair(self, T_base_tcp: Array, source: Source, t_exposure_ns: int, frame_share: float = 1.0) -> PairObservation:
        """One pair; `frame_share` scales what changes from frame to frame."""
        return replace(self.pairs(T_base_tcp, source, 1, frame_share)[0], t_exposure_ns=t_exposure_ns)

    def pairs(self, T_base_tcp: Array, source: Source, n: int, frame_share: float = 1.0) -> list[PairObservation]:
        """n pairs at rest: what lasts for a look is the same in all of them."""
        noise = self._noise.stereo if source == "stereo" else self._noise.mono
        seen = self._view.corners(T_base_tcp)
        lasting: Lasting = {(one.marker_id, eye): self._lasting(one, eye, noise) for one in seen for eye in EYES}
        return [self._observed(seen, lasting, noise, frame_share, source) for _ in range(n)]

    def _lasting(self, one: SeenMarker, eye: EyeName, noise: LookNoise) -> Array:
        """Corner errors (4, 2) [px] that stay: of the tool for good, of the OOI for a look."""
        if one.on == "tool":
            return noise.tool.look_px * self._bias[(one.marker_id, eye)]
        return noise.ooi.look_px * self._rng.standard_normal((4, 2))

    def _observed(
        self, seen: tuple[SeenMarker, ...], lasting: Lasting, noise: LookNoise, share: float, source: Source
    ) -> PairObservation:
        corners: dict[EyeName, dict[int, Array]] = {"left": {}, "right": {}}
        for one in seen:
            own = noise.tool if one.on == "tool" else noise.ooi
            for eye in EYES:
                exact = one.left_px if eye == "left" else one.right_px
                if exact is not None:
                    fleeting = share * own.frame_px * self._rng.standard_normal((4, 2))
                    corners[eye][one.marker_id] = biased(exact, own) + lasting[(one.marker_id, eye)] + fleeting
        tool, tool_views = self._pose("tool", corners["left"], corners["right"], source)
        ooi, ooi_views = self._pose("ooi", corners["left"], corners["right"], source)
        return PairObservation(0, tool, ooi, (*tool_views, *ooi_views), ())

    def _pose(
        self, name: ObjectName, left: dict[int, Array], right: dict[int, Array], source: Source
    ) -> tuple[ObjectPose, tuple[MarkerView, ...]]:
        if source == "mono":
            return self._mono._pose(name, left), ()  # the same estimate without its image search
        sightings = sightings_of(self._markers[name], left, right)
        if not sightings:
            return not_seen(name, f"no marker of the {name} in either eye"), ()
        return estimate_object_pose(name, sightings, self._camera, self._settings)


def biased(corners_px: Array, noise: CornerNoise) -> Array:
    """Corners (4, 2) moved by what is the same every time: outwards, and aside."""
    from_middle = corners_px - corners_px.mean(axis=0)
    outward = from_middle / np.linalg.norm(from_middle, axis=1, keepdims=True)
    return corners_px + noise.outward_px * np.sqrt(2.0) * outward + np.array([noise.shift_x_px, noise.shift_y_px])
