"""Are these images what a working stereo camera gives? Anything else forbids their use in a look."""

from dataclasses import replace

from machine.description import StereoCamera
from server.camera.contracts import StereoFrame
from server.camera.health.blur import BlurMonitor
from server.camera.health.exposure import ExposureMonitor
from server.camera.health.findings import FaultCode, Finding
from server.camera.health.frozen import FrozenMonitor
from server.camera.health.garbage import GarbageMonitor, wrong_size
from server.camera.health.jump import JumpMonitor
from server.camera.health.latch import Latch
from server.camera.health.light import LightMonitor
from server.camera.health.markers import MarkerMonitor
from server.camera.health.pair import Monitor, Pair
from server.camera.health.rig import RigMonitor
from server.camera.health.spot import SpotMonitor
from server.camera.health.stamps import StampMonitor
from server.camera.health.thumbnail import EyeMemory
from server.vision.contracts import PairObservation

USELESS = frozenset(
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
        """What stamps and images tell by themselves, before anybody works on them. Once per pair, in order."""
        sick = wrong_size(frame, self._camera)
        if sick:
            self._stamps.short_ns = 0  # judged with the next pair of the right size
            self._pair, self._shape = None, ()
            return self._images.hold(sick)
        pair = self._pair = self._seen(frame)
        findings = [*self._stamps.check(pair)]
        for monitor in self._first:
            findings += monitor.check(pair)
        if not any(finding.code in USELESS for finding in findings):
            for monitor in self._then:
                findings += monitor.check(pair)
        if not any(finding.forbids_look for finding in findings):
            self._garbage.take()
        return self._images.hold(tuple(findings))

    def after_markers(self, observation: PairObservation | None) -> tuple[Finding, ...]:
        """What the markers found in the same pair add; to be called after `before_use`, None when there are none."""
        if self._pair is None or observation is None:
            return self._marked.hold(())
        pair = replace(self._pair, observation=observation)
        return self._marked.hold((*self._blur.at_markers(pair), *self._markers.check(pair), *self._jump.check(pair)))

    def _seen(self, frame: StereoFrame) -> Pair:
        known, same_shape = self._connection == frame.connection, self._shape == frame.left.shape
        if not known:
            self._images.clear()
            self._marked.clear()
        self._connection, self._shape = frame.connection, frame.left.shape
        left, right = self._left.look(frame.left), self._right.look(frame.right)
        return Pair(
            frame, left, right, self._left.step, first=not (known and same_shape), resumed=same_shape and not known
        )
