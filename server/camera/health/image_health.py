"""Are these images what a working stereo camera gives? Anything else forbids their use in a look."""

from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from machine.description import StereoCamera
from server.camera.contracts import StereoFrame
from server.camera.health.blur import BlurMonitor
from server.camera.health.findings import FaultCode, Finding, Monitor, Pair
from server.camera.health.frozen import FrozenMonitor
from server.camera.health.garbage import GarbageMonitor, wrong_size
from server.camera.health.light import ExposureMonitor, LightMonitor
from server.camera.health.markers import MarkerMonitor
from server.camera.health.rig import RigMonitor
from server.camera.health.spot import SpotMonitor
from server.camera.health.stamps import StampMonitor
from server.camera.health.thumbnail import EyeMemory
from server.vision.contracts import Array, PairObservation

UNUSABLE_IMAGE_FAULTS = frozenset(
    {
        FaultCode.BLACK,
        FaultCode.EYE_GONE,
        FaultCode.SATURATED,
        FaultCode.NO_CONTRAST,
        FaultCode.EYE_COPIED,
        FaultCode.GARBAGE,
        FaultCode.FROZEN,
    }
)  # where one of these is found, what the pictures show means nothing to the slower monitors


# Once found, a fault stands until enough good pairs have come: one good picture in between proves nothing.

RECOVERY_PAIRS = 5
RECOVERY_PAIRS_BY_FAULT = {  # where more must be seen
    FaultCode.STAMP_BACKWARDS: 10,  # the clock's map needs 8 pairs to find itself
    FaultCode.STAMP_JUMPED: 10,
    FaultCode.STAMP_STANDS: 10,
    FaultCode.LATE: 10,
    FaultCode.STARTING: 0,  # counts by itself
}


class Latch:
    """Holds findings by their code."""

    def __init__(self) -> None:
        self._held: dict[FaultCode, tuple[Finding, int]] = {}

    def hold_findings(self, findings: tuple[Finding, ...]) -> tuple[Finding, ...]:
        """These findings, and those of before that have not been absent for long enough."""
        lingering: list[Finding] = []
        now = {finding.code: finding for finding in reversed(findings)}
        for code, (finding, left) in tuple(self._held.items()):
            if code in now:
                continue
            if left == 0:
                del self._held[code]
                continue
            self._held[code] = finding, left - 1
            lingering.append(replace(finding, text=f"{finding.text} (over; {left} more good pairs wanted)"))
        for code, finding in now.items():
            self._held[code] = finding, RECOVERY_PAIRS_BY_FAULT.get(code, RECOVERY_PAIRS)
        return (*findings, *lingering)

    def clear(self) -> None:
        """Forget all."""
        self._held.clear()


# A marker that jumps: from one pair to the next further than a machine can accelerate a camera.
#
# A damaged picture may be shifted by whole blocks of its JPEG, in both eyes alike: every marker in it then fits a pose,
# and only the pairs before it say that this is not where the marker was about to be.

MARKER_JUMP_MIN_PX = 4.0  # half of the smallest block of a JPEG
EYE_JUMP_DIFFERENCE_MAX_PX = 0.5  # between the eyes: blocks shift both by the same, a step in depth does not
# Of a 10 Hz camera; 4 px in it from rest, at 1 m with 700 px: 0.8 m/s^2, cranes have 0.5. The limit of a longer
# interval grows as the way of that acceleration does.
REFERENCE_INTERVAL_S = 0.12
INTERVAL_MAX_S = 1.0  # a limit of 280 px: beyond, nothing can be said


@dataclass(frozen=True, slots=True, eq=False)
class _MarkerSighting:
    """Corners (n, 2) of a marker in one eye, and their common speed [px/ns]; None at the first sighting."""

    corners_px: Array
    speed_px_ns: Array | None = None


class JumpMonitor:
    """Compares each marker with where the speed of its last step would have taken it."""

    def __init__(self) -> None:
        self._t_ns, self._interval_ns = 0, 0
        self._seen: dict[tuple[int, str], _MarkerSighting] = {}

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """The marker that is furthest off, where any is too far; its first two sightings are not judged."""
        if pair.observation is None:
            return ()
        interval_ns = pair.frame.t_exposure_ns - self._t_ns
        comparable = not pair.is_first and 0 < interval_ns <= INTERVAL_MAX_S * 1e9
        before = self._seen if comparable else {}
        # Errors of the predicted place: by the acceleration over this interval, and over the one that gave the speed.
        way_ns2 = 0.5 * interval_ns * (interval_ns + self._interval_ns)
        limit_px = MARKER_JUMP_MIN_PX * max(1.0, way_ns2 / (REFERENCE_INTERVAL_S * 1e9) ** 2)
        self._t_ns, self._interval_ns, self._seen = pair.frame.t_exposure_ns, interval_ns, {}
        worst_px, worst = 0.0, ""
        for view in pair.observation.marker_views:
            offs_px: list[Array] = []
            for eye, corners in (("left", view.corners_left_px), ("right", view.corners_right_px)):
                if not view.used or corners is None:
                    continue
                key, found = (view.marker_id, eye), np.ascontiguousarray(corners, dtype=np.float64)
                if key not in before:
                    self._seen[key] = _MarkerSighting(found)
                    continue
                speed = before[key].speed_px_ns
                off_px = _median_corner_offset(
                    found, before[key].corners_px + (0.0 if speed is None else speed * interval_ns)
                )
                self._seen[key] = _MarkerSighting(found, off_px / interval_ns + (0.0 if speed is None else speed))
                if speed is not None:
                    offs_px.append(off_px)
            alike = bool(offs_px) and float(np.linalg.norm(offs_px[0] - offs_px[-1])) < EYE_JUMP_DIFFERENCE_MAX_PX
            size_px = float(np.linalg.norm(offs_px[0])) if alike else 0.0  # of one eye the residual says more
            if size_px > worst_px:
                worst_px, worst = size_px, f"marker {view.marker_id} jumped by {size_px:.1f} px"
        if worst_px <= limit_px:
            return ()
        text = (
            f"{worst} from one pair to the next (limit {limit_px:.3g} px): the picture is damaged, or something was "
            "struck; check cable, network and the camera's encoder"
        )
        return (Finding(FaultCode.JUMPED, text, forbids_odometry=False),)


@njit(cache=True, nogil=True)
def _median_corner_offset(found: Array, predicted: Array) -> Array:
    """From the predicted corners to the nearest found ones (2,) [px], the median: a board's sets may differ."""
    between = np.empty((2, len(found)))
    for i in range(len(found)):
        nearest = np.inf
        for k in range(len(predicted)):
            dx, dy = found[i, 0] - predicted[k, 0], found[i, 1] - predicted[k, 1]
            square = dx * dx + dy * dy
            if square < nearest or k == 0:
                nearest, between[0, i], between[1, i] = square, dx, dy
    return np.array([np.median(between[0]), np.median(between[1])])


class ImageHealth:
    """All monitors, one pair at a time. Without the camera the size and the rig are not judged."""

    def __init__(self, camera: StereoCamera | None = None) -> None:
        self._camera = camera
        self._left, self._right = EyeMemory(), EyeMemory()
        self._connection: int | None = None
        self._shape: tuple[int, ...] = ()
        self._pair: Pair | None = None
        self._images, self._marked = Latch(), Latch()
        self._stamps, self._blur, self._markers = StampMonitor(), BlurMonitor(), MarkerMonitor(camera)
        self._garbage, self._jump = GarbageMonitor(), JumpMonitor()
        self._first: tuple[Monitor, ...] = (ExposureMonitor(), FrozenMonitor(), self._garbage)
        self._then: tuple[Monitor, ...] = (LightMonitor(), RigMonitor(camera), SpotMonitor(), self._blur)

    @property
    def stamp_short_ns(self) -> int:
        """By how much the last pair's stamp came too soon after the one before [ns]."""
        return self._stamps.short_ns

    def check(self, frame: StereoFrame) -> tuple[str, ...]:
        """Warnings about this pair by its images and stamps; empty when it is fit for use."""
        return tuple(finding.text for finding in self.inspect(frame) if finding.forbids_look)

    def inspect(self, frame: StereoFrame, observation: PairObservation | None = None) -> tuple[Finding, ...]:
        """All that is wrong with this pair, and what was wrong until just now: `before_use` and `after_markers`."""
        return (*self.before_use(frame), *self.after_markers(observation))

    def before_use(self, frame: StereoFrame) -> tuple[Finding, ...]:
        """What stamps and images show by themselves, before they are processed. Once per pair, in order."""
        sick = wrong_size(frame, self._camera)
        if sick:
            self._stamps.short_ns = 0  # judged with the next pair of the right size
            self._pair, self._shape = None, ()
            return self._images.hold_findings(sick)
        pair = self._pair = self._seen(frame)
        findings = [*self._stamps.check(pair)]
        for monitor in self._first:
            findings += monitor.check(pair)
        if not any(finding.code in UNUSABLE_IMAGE_FAULTS for finding in findings):
            for monitor in self._then:
                findings += monitor.check(pair)
        if not any(finding.forbids_look for finding in findings):
            self._garbage.keep_as_reference()
        return self._images.hold_findings(tuple(findings))

    def after_markers(self, observation: PairObservation | None) -> tuple[Finding, ...]:
        """What the markers found in the same pair add; to be called after `before_use`, None when there are none."""
        if self._pair is None or observation is None:
            return self._marked.hold_findings(())
        pair = replace(self._pair, observation=observation)
        return self._marked.hold_findings(
            (*self._blur.at_markers(pair), *self._markers.check(pair), *self._jump.check(pair))
        )

    def _seen(self, frame: StereoFrame) -> Pair:
        known, same_shape = self._connection == frame.connection_number, self._shape == frame.left.shape
        if not known:
            self._images.clear()
            self._marked.clear()
        self._connection, self._shape = frame.connection_number, frame.left.shape
        left, right = self._left.look(frame.left), self._right.look(frame.right)
        return Pair(
            frame,
            left,
            right,
            self._left.thumbnail_step_px,
            is_first=not (known and same_shape),
            is_resumed=same_shape and not known,
        )
