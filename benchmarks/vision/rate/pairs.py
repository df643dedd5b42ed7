"""Stereo pairs in memory: one round of a circle at the camera's own rate, replayed to and fro so that nothing jumps."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.link.load.rendered_pairs import render_pairs
from benchmarks.link.load.replay_camera import to_and_fro
from machine.description import Machine
from server.camera.contracts import StereoFrame
from server.camera.sources.side_by_side import decode_side_by_side
from server.vision.contracts import Image

RATE_HZ = 60.0


@dataclass(frozen=True, slots=True)
class PairsInMemory:
    """Decoded pairs, each eye (h, w) contiguous."""

    pairs: tuple[tuple[Image, Image], ...]

    def frames(self) -> Iterator[StereoFrame]:
        """For ever, at 60 Hz of the camera's clock; receive time = exposure."""
        for number, index in enumerate(to_and_fro(len(self.pairs))):
            t_ns = round(number * 1e9 / RATE_HZ)
            yield StereoFrame(*self.pairs[index], t_exposure_ns=t_ns, t_receive_mono_ns=t_ns, sequence=number)


def load_pairs(machine: Machine, folder: Path, n: int, seed: int) -> PairsInMemory:
    """Rendered once into `folder` (preset realistic, JPEG as the simulated camera sends it), then read from there."""
    files = render_pairs(machine, folder / f"pairs-{seed}-{n}", n, seed, rate_hz=RATE_HZ)
    eyes = (decode_side_by_side(file.read_bytes()) for file in files)
    return PairsInMemory(tuple((np.ascontiguousarray(left), np.ascontiguousarray(right)) for left, right in eyes))
