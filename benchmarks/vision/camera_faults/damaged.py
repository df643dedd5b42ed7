"""Pictures whose data are damaged on their way: which are refused, and does any look that ends OK show a wrong pose?"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import count

import cv2
import numpy as np

from benchmarks.vision.camera_faults.camera import CAMERA_EPOCH_NS, LATENCY_S, PC_EPOCH_NS
from benchmarks.vision.camera_faults.looks import Looks
from benchmarks.vision.camera_faults.pictures import RATE_HZ, Pictures
from machine.description import Machine
from machine.rotations import Array
from server.camera.contracts import FrameReport, StereoFrame, VisionSettings
from server.camera.errors import StreamError
from server.camera.pipeline import VisionPipeline
from server.camera.process import build_pipeline
from server.camera.sources.settings import HttpSource
from server.camera.sources.side_by_side import decode_side_by_side
from sim_plc.camera.faults import FaultKind, with_flipped_bits

QUALITIES = (95, 75, 50)
DAMAGED_FRAC = 0.2  # of the pictures of a stream: most looks meet one
WRONG_MM, WRONG_SIGMAS = 0.5, 4.0  # a pose is wrong beyond both
SWAPPED = "intervals swapped"
INTERVAL_UNITS = 320  # a row of blocks of both eyes


def _cut(jpeg: bytes, rng: np.random.Generator) -> bytes:
    return jpeg[: int(rng.integers(len(jpeg) // 10, len(jpeg) - 2))]


def _lost(jpeg: bytes, rng: np.random.Generator) -> bytes:
    start = int(rng.integers(len(jpeg) // 10, len(jpeg) - 3000))
    return jpeg[:start] + jpeg[start + int(rng.integers(1, 3000)) :]


def _swapped(jpeg: bytes, rng: np.random.Generator) -> bytes:
    """Two restart intervals in each other's place; their markers stay in turn."""
    data = np.frombuffer(jpeg, np.uint8)
    markers = np.flatnonzero((data[:-1] == 0xFF) & ((data[1:] & 0xF8) == 0xD0))
    first, second = sorted(rng.choice(len(markers) - 1, 2, replace=False))
    a, b, c, d = (int(markers[first]) + 2, int(markers[first + 1]), int(markers[second]) + 2, int(markers[second + 1]))
    return jpeg[:a] + jpeg[c:d] + jpeg[b:c] + jpeg[a:b] + jpeg[d:]


DAMAGES: dict[str, Callable[[bytes, np.random.Generator], bytes]] = {
    "1 bit flipped": lambda jpeg, rng: with_flipped_bits(jpeg, 1, rng),
    "2 bits flipped": lambda jpeg, rng: with_flipped_bits(jpeg, 2, rng),
    "3 bits flipped": lambda jpeg, rng: with_flipped_bits(jpeg, 3, rng),
    "cut": _cut,
    "bytes lost": _lost,
    SWAPPED: _swapped,
}


@dataclass(frozen=True, slots=True)
class DamagedCase:
    """What came of one kind of damage at one quality.

    `refused`: damaged pictures that never became a pair; `held`: pairs of such that health kept from looks.
    `wrong_used`: damaged pairs with a wrong pose that a look could use; `wrong_looks`: looks that ended OK with a wrong
    pose, of `looks`. `sound_refused`: undamaged pictures that were refused, of `sound`.
    """

    kind: str
    quality: int
    seed: int
    damaged: int
    refused: int
    held: int
    wrong_used: int
    looks: int
    wrong_looks: int
    sound: int
    sound_refused: int


Poses = tuple[Array | None, Array | None]


def run_damaged(machine: Machine, pictures: Pictures, kind: str, quality: int, seed: int, n: int) -> DamagedCase:
    """A stream at rest of which every fifth picture is damaged, until `n` are."""
    rng = np.random.default_rng([seed, quality, list(DAMAGES).index(kind)])
    pipeline, looks = build_pipeline(VisionSettings(HttpSource("http://unused/")), machine), Looks()
    interval = INTERVAL_UNITS if kind == SWAPPED else 0
    sent = [_encoded(np.hstack(pair), quality, interval) for pair in pictures.at_rest[FaultKind.NONE]]
    truth = _poses([_processed(pipeline, decode_side_by_side(jpeg), k) for k, jpeg in enumerate(sent)])
    damaged = refused = held = wrong_used = sound = sound_refused = 0
    for number in count(len(sent)):
        if damaged == n:
            break
        is_damaged = bool(rng.random() < DAMAGED_FRAC)
        jpeg = sent[number % len(sent)]
        damaged, sound = damaged + is_damaged, sound + (not is_damaged)
        try:
            eyes = decode_side_by_side(DAMAGES[kind](jpeg, rng) if is_damaged else jpeg)
        except StreamError:
            refused, sound_refused = refused + is_damaged, sound_refused + (not is_damaged)
            continue
        report = _processed(pipeline, eyes, number)
        looks.add(number, report)
        held += is_damaged and not report.fit_for_look
        wrong_used += is_damaged and report.fit_for_look and _is_wrong(report, truth)
    pipeline.close()
    wrong = sum(
        _off(look.T_cam_tool, look.tool_covariance, truth[0]) or _off(look.T_cam_ooi, look.ooi_covariance, truth[1])
        for look in looks.ended_ok
    )
    counts = (damaged, refused, held, wrong_used, len(looks.ended_ok), wrong, sound, sound_refused)
    return DamagedCase(kind, quality, seed, *counts)


def _encoded(picture: np.ndarray, quality: int, interval: int) -> bytes:
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_RST_INTERVAL, interval]
    return cv2.imencode(".jpg", picture, options)[1].tobytes()


def _processed(pipeline: VisionPipeline, eyes: tuple[np.ndarray, np.ndarray], number: int) -> FrameReport:
    t_ns = round((number + 1) * 1e9 / RATE_HZ)
    t_receive_ns = PC_EPOCH_NS + t_ns + round(1e9 * LATENCY_S)
    return pipeline.process(StereoFrame(*eyes, CAMERA_EPOCH_NS + t_ns, t_receive_ns, number), 0)


def _poses(reports: list[FrameReport]) -> Poses:
    """Of tool and OOI, the medians over undamaged pairs at rest; rotations as the first pair has them."""
    found = []
    for name in ("tool", "ooi"):
        Ts = [getattr(report.observation, name).T_cam_object for report in reports]
        seen = [T for T in Ts if T is not None]
        T = None if not seen else seen[0].copy()
        if T is not None:
            T[:3, 3] = np.median([one[:3, 3] for one in seen], axis=0)
        found.append(T)
    return found[0], found[1]


def _is_wrong(report: FrameReport, truth: Poses) -> bool:
    pairs = zip((report.observation.tool, report.observation.ooi), truth, strict=True)
    return any(_off(found.T_cam_object, found.covariance, T) for found, T in pairs)


def _off(T: Array | None, covariance: Array | None, T_true: Array | None) -> bool:
    """Whether a position is further off than both limits."""
    if T is None or covariance is None or T_true is None:
        return False
    off_mm = 1e3 * float(np.linalg.norm(T[:3, 3] - T_true[:3, 3]))
    return off_mm > max(WRONG_MM, WRONG_SIGMAS * 1e3 * float(np.sqrt(np.trace(covariance[3:, 3:]))))
