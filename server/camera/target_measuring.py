"""Measures targets in pairs that were kept, in a thread of its own, so that the stream goes on meanwhile."""

from collections import deque
from collections.abc import Sequence
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
    TargetCommand,
    TargetMeasured,
    UseTargetCommand,
)
from server.targets.anchor import anchor_target
from server.targets.contracts import AnchoredTarget, PatchStatus, TargetSettings, refused_patch
from server.targets.round_marks import find_round_marks
from server.targets.source import TargetPoseSource
from server.targets.surface import measure_patch, with_roll
from server.vision.contracts import Array, Image

KEPT = 40  # pairs with a preview: 4 s at 10 a second, 74 MB at 720p


@dataclass(frozen=True, slots=True)
class _Kept:
    sequence: int
    left: Image
    right: Image
    masks_px: tuple[Sequence[Array], Sequence[Array]]


class TargetMeasuring:
    """Keeps the pairs that were shown and measures in them on request."""

    def __init__(self, camera: StereoCamera, source: TargetPoseSource, settings: TargetSettings | None = None) -> None:
        self._camera, self._source, self._settings = camera, source, settings or TargetSettings()
        self._kept: deque[_Kept] = deque(maxlen=KEPT)
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="target")
        self._running: deque[Future[TargetMeasured | MarksFound]] = deque()

    def keep(self, frame: StereoFrame) -> None:
        """Keep a pair that is shown to the operator, with the own tool's polygons in it."""
        self._kept.append(_Kept(frame.sequence, frame.left.copy(), frame.right.copy(), self._source.masks_px))

    def obey(self, command: TargetCommand) -> None:
        """Serve a target from the next pair on, or begin to measure one; `finished` gives the answer."""
        if isinstance(command, UseTargetCommand):
            return self._source.use(command.target)
        if isinstance(command, FindMarksCommand):
            self._running.append(self._thread.submit(self._marks, command, tuple(self._kept)))
        else:
            self._running.append(self._thread.submit(self._measured, command, tuple(self._kept)))
        return None

    def finished(self) -> list[TargetMeasured | MarksFound]:
        """Answers that are ready, each once."""
        ready = []
        while self._running and self._running[0].done():
            ready.append(self._running.popleft().result())
        return ready

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown(cancel_futures=True)

    def _measured(self, command: MeasureTargetCommand, kept: tuple[_Kept, ...]) -> TargetMeasured:
        pair = _pair_of(kept, command.sequence)
        if isinstance(pair, str):
            reason = pair
            return TargetMeasured(command.request, refused_patch(PatchStatus.OUTSIDE_IMAGE, reason, command.pixel))
        if _is_masked(pair.masks_px[0], command.pixel):
            reason = "The own tool is at this pixel; choose a place beside it"
            return TargetMeasured(command.request, refused_patch(PatchStatus.OUTSIDE_IMAGE, reason, command.pixel))
        patch = measure_patch(pair.left, pair.right, self._camera, command.pixel, self._settings)
        if not patch.ok:
            return TargetMeasured(command.request, patch)
        patch = with_roll(patch, command.roll_rad)
        found = anchor_target(
            command.request, patch, pair.left, pair.right, self._camera, self._settings, pair.masks_px
        )
        return TargetMeasured(command.request, found)

    def _marks(self, command: FindMarksCommand, kept: tuple[_Kept, ...]) -> MarksFound:
        """All marks of a pair, each anchored now: the pair will not be kept until one is chosen."""
        pair = _pair_of(kept, command.sequence)
        if isinstance(pair, str):
            return MarksFound(command.request, (), pair)
        camera, settings = self._camera, self._settings
        found = find_round_marks(pair.left, pair.right, camera, command.diameters_m, settings, pair.masks_px)
        marks = []
        for number, mark in enumerate(found.marks, command.request):
            target = anchor_target(number, mark.patch, pair.left, pair.right, camera, settings, pair.masks_px)
            if isinstance(target, AnchoredTarget):  # one copy of the pair for all
                target = replace(target, reference_left=pair.left, reference_right=pair.right)
            marks.append((mark, target))
        return MarksFound(command.request, tuple(marks), found.reason)


def _pair_of(kept: tuple[_Kept, ...], sequence: int) -> _Kept | str:
    """The kept pair of that number, or why there is none."""
    pair = next((pair for pair in reversed(kept) if pair.sequence == sequence), None)
    if pair is not None:
        return pair
    numbers = f"{kept[0].sequence} to {kept[-1].sequence}" if kept else "none"
    return f"Image {sequence} is not kept any more (kept: {numbers}); choose in a newer image"


def _is_masked(polygons: Sequence[Array], pixel: tuple[float, float]) -> bool:
    return any(
        cv2.pointPolygonTest(np.asarray(one, dtype=np.float32).reshape(-1, 1, 2), pixel, False) >= 0 for one in polygons
    )
