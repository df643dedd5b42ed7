"""The camera check: from stamps, some pairs and what vision saw in them to one line each. Pure."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from machine.description import Machine
from server.camera.check_findings import CheckFinding, Level
from server.camera.check_markers import check_markers, tally_markers
from server.camera.check_picture import check_exposure, check_sharpness
from server.camera.check_rig import check_rig, match_eyes
from server.camera.check_scale import Tape, check_focal, check_scale, side_ratios
from server.camera.check_stream import StreamTimes, check_stream
from server.camera.contracts import StereoFrame
from server.camera.own_structure import Masks, check_own_structure
from server.vision.contracts import Image, PairObservation

MATCHED_PAIRS_MAX = 6  # more add little: a still scene shows the same spots again

Observe = Callable[[Image, Image, int], PairObservation]

RATE_WINDOW_PAIRS = 30


@dataclass(frozen=True, slots=True, eq=False)
class CheckSample:
    """What the check was given: the times of all pairs, and some pairs (left, right, stamp [ns])."""

    stream_times: StreamTimes
    image_pairs: tuple[tuple[Image, Image, int], ...]


def check_camera(
    gathered: CheckSample,
    machine: Machine,
    observe: Observe,
    rng: np.random.Generator,
    on_step: Callable[[], None] = lambda: None,
    tape: Tape | None = None,
    masks: Masks = ((), ()),
) -> list[CheckFinding]:
    """All lines, in the order of the way of the light: stream, pictures, rig, markers.

    Args:    machine: its camera is what the pictures are said to be. observe: the marker pose source. on_step: called
             after each pair and each part, `progress_steps(gathered)` times. tape: a taped distance between tool and
             OOI. masks: of the settings, left and right eye.
    """
    findings = check_stream(gathered.stream_times)
    wrong = _wrong_size(gathered, machine)
    if wrong is not None or not gathered.image_pairs:
        return [*findings, wrong] if wrong is not None else findings
    eyes = [(left, right) for left, right, _ in gathered.image_pairs]
    findings += [check_sharpness(eyes), check_exposure(eyes)]
    on_step()
    spots = []
    for left, right in _evenly_spaced_pairs(eyes, MATCHED_PAIRS_MAX):
        spots.append(match_eyes(left, right))
        on_step()
    rig = check_rig(machine.camera, spots, rng)
    seen = []
    for left, right, t_ns in gathered.image_pairs:
        seen.append(observe(left, right, t_ns))
        on_step()
    markers = {marker.marker_id: marker for marker in machine.markers}
    rig.append(check_scale(side_ratios(machine.camera, markers, seen)))
    if all(finding.level is Level.OK for finding in rig):  # a turned eye looks like another focal length too
        rig.append(check_focal(machine, seen, tape))
    sound = all(finding.level is not Level.FAIL for finding in rig)
    return [
        *findings,
        *rig,
        *check_markers(tally_markers(machine, eyes, seen), sound),
        check_own_structure(eyes, masks),
    ]


def progress_steps(gathered: CheckSample) -> int:
    """How often `check_camera` calls `on_step`."""
    return 1 + min(len(gathered.image_pairs), MATCHED_PAIRS_MAX) + len(gathered.image_pairs)


def _evenly_spaced_pairs(pairs: Sequence[tuple[Image, Image]], n: int) -> list[tuple[Image, Image]]:
    indices = np.unique(np.linspace(0, len(pairs) - 1, min(n, len(pairs))).astype(int))
    return [pairs[index] for index in indices]


def _wrong_size(gathered: CheckSample, machine: Machine) -> CheckFinding | None:
    wanted = (machine.camera.height_px, machine.camera.width_px)
    shapes = {image.shape for left, right, _ in gathered.image_pairs for image in (left, right)}
    odd = [shape for shape in shapes if shape != wanted]
    if not odd:
        return None
    text = f"pictures are {odd[0][1]} x {odd[0][0]} px an eye, the camera's file says {wanted[1]} x {wanted[0]}"
    return CheckFinding("size", Level.FAIL, text, "set the camera to that size, or give the file of this one")


@dataclass(slots=True)
class CheckSampler:
    """Takes pairs as they come. Of the pairs themselves only `pairs_max` are copied, at least
    `duration_s` / `pairs_max` apart."""

    pairs_max: int
    duration_s: float
    pair_times: list[tuple[int, int, int, int]] = field(default_factory=list)
    image_pairs: list[tuple[Image, Image, int]] = field(default_factory=list)
    _kept_ns: int = -(1 << 62)

    @property
    def n(self) -> int:
        """Pairs so far."""
        return len(self.pair_times)

    @property
    def rate_hz(self) -> float:
        """Of the last pairs, by their arrival."""
        recent = self.pair_times[-RATE_WINDOW_PAIRS:]
        span_ns = recent[-1][1] - recent[0][1] if recent else 0
        return (len(recent) - 1) * 1e9 / span_ns if span_ns > 0 else 0.0

    @property
    def missing_count(self) -> int:
        """Sequence numbers that never came."""
        steps = ((before, after) for before, after in pairwise(self.pair_times) if before[3] == after[3])
        return sum(max(0, after[2] - before[2] - 1) for before, after in steps)

    def add(self, frame: StereoFrame) -> None:
        """The next pair."""
        self.pair_times.append((frame.t_exposure_ns, frame.t_receive_mono_ns, frame.sequence, frame.connection_number))
        every_ns = self.duration_s * 1e9 / self.pairs_max
        if len(self.image_pairs) < self.pairs_max and frame.t_receive_mono_ns - self._kept_ns >= every_ns:
            self._kept_ns = frame.t_receive_mono_ns
            self.image_pairs.append((np.array(frame.left), np.array(frame.right), frame.t_exposure_ns))

    def sample(
        self, skipped: int, own_clock: bool = False, wanted_hz: float | None = None, stored: bool = False
    ) -> CheckSample:
        """What was taken so far, for `check_camera`."""
        columns = np.array(self.pair_times, dtype=np.int64).reshape(-1, 4).T
        times = StreamTimes(*columns, n_skipped=skipped, own_clock=own_clock, wanted_hz=wanted_hz, is_recorded=stored)
        return CheckSample(times, tuple(self.image_pairs))
