"""Measures targets in pairs that were kept, in a thread of its own, so that the stream goes on meanwhile."""

from collections import deque
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np

from machine.description import StereoCamera
from server.camera.contracts import (
    FindMarksCommand,
    MarksFound,
    MeasureTargetCommand,
    StereoFrame,
    TargetAnswer,
    TargetCommand,
    TargetMeasured,
    TeachViewCommand,
    UseTargetCommand,
    ViewTaught,
)
from server.targets.anchor import anchor_target
from server.targets.contracts import AnchoredTarget, PatchStatus, SurfacePatch, TargetSettings, refused_patch
from server.targets.round_marks import find_round_marks
from server.targets.source import TargetPoseSource
from server.targets.surface import measure_patch, with_roll
from server.targets.taught import ObjectBox, TaughtView, teach_view
from server.targets.tool_mask import blown_up
from server.vision.contracts import Array, Image, PairObservation

MARKER_PRINT_SCALE = 1.5  # a marker's quiet zone, and the edge of its plate
PAIR_BUFFER_SIZE = 40  # pairs with a preview: 4 s at 10 a second, 74 MB at 720p


@dataclass(frozen=True, slots=True)
class KeptPair:
    """A raw grey pair (h, w), the own tool's polygons in it, and what the markers showed."""

    sequence: int
    left: Image
    right: Image
    masks_px: tuple[Sequence[Array], Sequence[Array]]
    marker_observation: PairObservation | None


class TargetMeasurementWorker:
    """Keeps the pairs that were shown and measures in them on request."""

    def __init__(self, camera: StereoCamera, source: TargetPoseSource, settings: TargetSettings | None = None) -> None:
        self._camera, self._source, self._settings = camera, source, settings or TargetSettings()
        self._kept: deque[KeptPair] = deque(maxlen=PAIR_BUFFER_SIZE)
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="target")
        self._running: deque[Future[TargetAnswer]] = deque()

    def keep_shown_pair(self, frame: StereoFrame) -> None:
        """Keep a pair that is shown to the operator, with the own tool's polygons in it."""
        source = self._source
        self._kept.append(
            KeptPair(frame.sequence, frame.left.copy(), frame.right.copy(), source.masks_px, source.markers)
        )

    def execute_command(self, command: TargetCommand) -> None:
        """Serve a target from the next pair on, or begin to measure one; `take_finished` gives the answer."""
        if isinstance(command, UseTargetCommand):
            return self._source.use_target(command.target)
        kept = tuple(self._kept)
        if isinstance(command, FindMarksCommand):
            self._running.append(self._thread.submit(self._answer_find_marks, command, kept))
        elif isinstance(command, TeachViewCommand):
            self._running.append(self._thread.submit(self._answer_teach_view, command, kept))
        else:
            self._running.append(self._thread.submit(self._answer_measure_target, command, kept))
        return None

    def take_finished(self) -> list[TargetAnswer]:
        """Answers finished since the last call; each is returned once only."""
        ready = []
        while self._running and self._running[0].done():
            ready.append(self._running.popleft().result())
        return ready

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown(cancel_futures=True)

    def _answer_teach_view(self, command: TeachViewCommand, kept: tuple[KeptPair, ...]) -> ViewTaught:
        pair = next((held for held in reversed(kept) if held.sequence == command.pair_sequence), None)
        if pair is None or pair.marker_observation is None:
            reason = f"Image {command.pair_sequence} is not kept any more; take the view in a newer image"
            return ViewTaught(command.request_id, reason)
        found = view_by_markers(pair, pair.marker_observation, self._camera, command.object_box, self._settings)
        return ViewTaught(command.request_id, found)

    def _answer_measure_target(self, command: MeasureTargetCommand, kept: tuple[KeptPair, ...]) -> TargetMeasured:
        return TargetMeasured(
            command.request_id, self._measure_and_anchor(command, _pair_of(kept, command.pair_sequence))
        )

    def _measure_and_anchor(self, command: MeasureTargetCommand, pair: KeptPair | str) -> AnchoredTarget | SurfacePatch:
        if isinstance(pair, str):
            return refused_patch(PatchStatus.OUTSIDE_IMAGE, pair, command.pixel)
        if _is_masked(pair.masks_px[0], command.pixel):
            reason = "The own tool is at this pixel; choose a place next to it"
            return refused_patch(PatchStatus.OUTSIDE_IMAGE, reason, command.pixel)
        camera, settings = self._camera, self._settings
        patch = measure_patch(pair.left, pair.right, camera, command.pixel, settings)
        if not patch.ok:
            return patch
        patch = with_roll(patch, command.roll_rad)
        return anchor_target(command.request_id, patch, pair.left, pair.right, camera, settings, pair.masks_px)

    def _answer_find_marks(self, command: FindMarksCommand, kept: tuple[KeptPair, ...]) -> MarksFound:
        """All marks of a pair, each anchored now: the pair will not be kept until one is chosen."""
        pair = _pair_of(kept, command.pair_sequence)
        if isinstance(pair, str):
            return MarksFound(command.request_id, (), pair)
        camera, settings = self._camera, self._settings
        found = find_round_marks(pair.left, pair.right, camera, command.diameters_m, settings, pair.masks_px)
        marks = []
        for number, mark in enumerate(found.marks, command.request_id):
            target = anchor_target(number, mark.patch, pair.left, pair.right, camera, settings, pair.masks_px)
            if isinstance(target, AnchoredTarget):  # one copy of the pair for all
                target = replace(target, reference_left=pair.left, reference_right=pair.right)
            marks.append((mark, target))
        return MarksFound(command.request_id, tuple(marks), found.reason)


def _pair_of(kept: tuple[KeptPair, ...], sequence: int) -> KeptPair | str:
    """The kept pair of that number, or why there is none."""
    pair = next((pair for pair in reversed(kept) if pair.sequence == sequence), None)
    if pair is not None:
        return pair
    numbers = f"{kept[0].sequence} to {kept[-1].sequence}" if kept else "none"
    return f"Image {sequence} is not kept any more (kept: {numbers}); choose in a newer image"


def view_by_markers(
    pair: KeptPair, markers: PairObservation, camera: StereoCamera, box: ObjectBox, settings: TargetSettings
) -> TaughtView | str:
    """One view of an object whose frame the OOI's markers in the picture give, or why it cannot be used."""
    ooi = markers.ooi
    if ooi.T_cam_object is None or ooi.covariance is None:
        return f"the object's markers are not seen ({ooi.reason}); put them next to the object, into both eyes' view"
    left = (*pair.masks_px[0], *_marker_print_polygons(view.corners_left_px for view in markers.marker_views))
    right = (*pair.masks_px[1], *_marker_print_polygons(view.corners_right_px for view in markers.marker_views))
    return teach_view(pair.left, pair.right, camera, ooi.T_cam_object, ooi.covariance, box, (left, right), settings)


def _marker_print_polygons(corners_px: Iterable[Array | None]) -> list[Array]:
    """Polygons (4, 2) [px] over the whole prints of markers."""
    return [blown_up(corners, MARKER_PRINT_SCALE) for corners in corners_px if corners is not None]


def _is_masked(polygons: Sequence[Array], pixel: tuple[float, float]) -> bool:
    contours = [np.asarray(polygon, dtype=np.float32).reshape(-1, 1, 2) for polygon in polygons]
    return any(cv2.pointPolygonTest(contour, pixel, False) >= 0 for contour in contours)
