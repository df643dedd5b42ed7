"""`longreach bench vision-soak`: the vision pipeline fed from memory for very long; does its memory grow?

Every sample is saved, so that a run can be cut and gone on with. A new process starts with a memory of its own, so a
slope is fitted within one process' samples only (a segment), after its warm-up.
"""

import gc
import itertools
import json
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from scipy.stats import theilslopes

from benchmarks.link.load.rendered_pairs import render_pairs
from benchmarks.link.load.replay_camera import to_and_fro
from benchmarks.same_options import require_same_options, text_mark
from benchmarks.saved_lines import every_line
from machine.description import Machine, parse_machine_toml
from recording.files import write_durably
from server.camera.contracts import StereoFrame, VisionSettings
from server.camera.pipeline import VisionPipeline
from server.camera.process import build_pipeline
from server.camera.sources.settings import HttpSource
from server.camera.sources.side_by_side import decode_side_by_side
from server.settings import read_machine_text
from server.vision.contracts import OdometryStatus

FILE = "samples.jsonl"
FOLDER = Path("runs/bench-soak")
DISTINCT_PAIRS = 200
RATE_HZ = 60.0  # of the stamps; the pairs themselves come as fast as they are worked on
SAMPLE_EVERY = 500
SAVE_EVERY = 5_000
WARM_UP_PAIRS = 5_000  # compiled code, thread pools, the odometry's map, the allocator's arenas
WARM_UP_FRAC_MAX = 0.3  # of a short run
SAMPLES_MIN = 5
SLOPE_MAX_MIB_H = 2.0
KIB, MIB = 1024.0, 1024.0**2


@dataclass(frozen=True, slots=True)
class Sample:
    """Memory after `pairs` pairs in all; `segment` counts processes, `segment_pairs` and `t_s` count within one.

    `objects`: what Python's collector follows, after a collection; -1 where it was not counted.
    """

    segment: int
    pairs: int
    segment_pairs: int
    t_s: float
    rss_bytes: int
    objects: int
    usable: int
    odometry_ok: int


@dataclass(frozen=True, slots=True)
class Slope:
    """Growth within one segment after its warm-up, median of all pairwise slopes, with its 95 % interval."""

    segment: int
    pairs: int
    n_samples: int
    mib_h: float
    mib_h_low: float
    mib_h_high: float
    kib_per_1000: float
    mib_h_at_rate: float  # the same growth per pair at 60 pairs a second
    objects_per_1000: float
    pairs_per_s: float


def vision_soak(
    pairs: Annotated[int, typer.Option(min=SAMPLE_EVERY, help="pairs in all")] = 200_000,
    seed: Annotated[int, typer.Option(help="seed of the simulated machine")] = 1,
    machine: Annotated[str, typer.Option(help="machine file or name")] = "hiab033",
    folder: Annotated[Path, typer.Option(help="where samples are saved; a second run resumes")] = FOLDER,
) -> None:
    """Markers, odometry and preview on pairs looped from memory: growth of memory per hour and per pair."""
    console, text = Console(width=200), read_machine_text(machine)
    require_same_options(folder, machine=text_mark(text))
    samples = bench(parse_machine_toml(text), pairs, seed, folder, console)
    slopes = slopes_of(samples)
    console.print(table_of(slopes))
    reached = samples[-1].pairs if samples else 0
    worst = max((max(slope.mib_h, slope.mib_h_at_rate) for slope in slopes), default=float("nan"))
    (folder / f"result-{seed}.json").write_text(json.dumps([asdict(slope) for slope in slopes], indent=1))
    console.print(
        f"worst slope {worst:.2f} MiB/h, as run or at 60 pairs/s (limit {SLOPE_MAX_MIB_H:g}); N reached {reached} of "
        f"{pairs} pairs, seed {seed}"
    )
    if reached < pairs or not worst <= SLOPE_MAX_MIB_H:
        raise typer.Exit(1)


def bench(machine: Machine, pairs: int, seed: int, folder: Path, console: Console) -> list[Sample]:
    """Run or resume until `pairs` pairs in all; Ctrl-C ends it early."""
    cv2.setNumThreads(1)
    path = folder / f"{seed}-{FILE}"
    folder.mkdir(parents=True, exist_ok=True)
    before = read_samples(path)
    done = before[-1].pairs if before else 0
    if done >= pairs:
        return before
    files = render_pairs(machine, folder / f"pairs-{seed}", DISTINCT_PAIRS, seed)
    images = [decode_side_by_side(file.read_bytes()) for file in files]
    segment = before[-1].segment + 1 if before else 1
    new: list[Sample] = []
    columns = (
        TextColumn("pairs"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[rss]}"),
    )
    pipeline = build_pipeline(VisionSettings(HttpSource("http://unused/")), machine)
    pipeline.switch_odometry(True)
    try:
        with Progress(*columns, console=console) as progress:
            task = progress.add_task("pairs", total=pairs, completed=done, rss="")
            for sample in soak(pipeline, images, pairs - done, segment, done):
                new.append(sample)
                progress.update(task, completed=sample.pairs, rss=f"{sample.rss_bytes / MIB:.1f} MiB")
                if sample.segment_pairs % SAVE_EVERY == 0 or sample.pairs >= pairs:
                    save_samples(path, [*before, *new])
    except KeyboardInterrupt:
        console.print("ended early; the next run goes on from here")
    finally:
        pipeline.close()
    save_samples(path, [*before, *new])
    return [*before, *new]


def soak(
    pipeline: VisionPipeline,
    images: Sequence[tuple[np.ndarray, np.ndarray]],
    pairs: int,
    segment: int = 1,
    done: int = 0,
) -> Iterator[Sample]:
    """`pairs` pairs through a pipeline, there and back; a sample every 500, objects counted every 5,000."""
    started_s = time.perf_counter()
    usable = odometry_ok = 0
    for number, index in enumerate(itertools.islice(to_and_fro(len(images)), pairs), start=1):
        t_ns = round(number * 1e9 / RATE_HZ)
        report = pipeline.process(StereoFrame(*images[index], t_ns, t_ns + 40_000_000, number), skipped=0)
        usable += report.fit_for_look
        odometry_ok += report.odometry is not None and report.odometry.status is not OdometryStatus.LOST
        if number % SAMPLE_EVERY and number != pairs:
            continue
        objects = count_objects() if number % SAVE_EVERY == 0 or number == pairs else -1
        elapsed_s = time.perf_counter() - started_s
        yield Sample(segment, done + number, number, elapsed_s, rss_bytes(), objects, usable, odometry_ok)


def rss_bytes() -> int:
    """Resident memory of this process (Linux: /proc/self/statm, which psutil reads as well)."""
    fields = Path("/proc/self/statm").read_text(encoding="ascii").split()
    return int(fields[1]) * os.sysconf("SC_PAGE_SIZE")


def count_objects() -> int:
    """Objects that the collector follows, rubbish removed first."""
    gc.collect()
    return len(gc.get_objects())


def save_samples(path: Path, samples: Sequence[Sample]) -> None:
    """All samples, in one step: a cut leaves the file of before."""
    write_durably(path, "".join(json.dumps(asdict(sample)) + "\n" for sample in samples))


def read_samples(path: Path) -> list[Sample]:
    """The samples saved so far."""
    return every_line(path, lambda text: Sample(**json.loads(text)))


def slopes_of(samples: Sequence[Sample]) -> list[Slope]:
    """One slope per segment that is long enough."""
    groups = itertools.groupby(samples, key=lambda sample: sample.segment)
    found = [_slope(list(group)) for _, group in groups]
    return [slope for slope in found if slope is not None]


def _slope(segment: list[Sample]) -> Slope | None:
    """Theil-Sen: median of all pairwise slopes; a single step of the allocator does not make it."""
    last = segment[-1]
    warm_up = min(WARM_UP_PAIRS, WARM_UP_FRAC_MAX * last.segment_pairs)
    kept = [sample for sample in segment if sample.segment_pairs > warm_up]
    if len(kept) < SAMPLES_MIN:
        return None
    hours = np.array([sample.t_s for sample in kept]) / 3600.0
    numbers = np.array([sample.segment_pairs for sample in kept], float)
    rss = np.array([sample.rss_bytes for sample in kept], float)
    mib_h, _, low, high = (float(value) for value in np.asarray(theilslopes(rss / MIB, hours, 0.95)))
    kib_per_1000 = float(np.asarray(theilslopes(rss / KIB, numbers / 1000.0))[0])
    counted = [sample for sample in kept if sample.objects >= 0]
    grown = counted[-1].objects - counted[0].objects if len(counted) > 1 else 0
    span = counted[-1].segment_pairs - counted[0].segment_pairs if len(counted) > 1 else 0
    return Slope(
        segment=last.segment,
        pairs=last.segment_pairs,
        n_samples=len(kept),
        mib_h=mib_h,
        mib_h_low=low,
        mib_h_high=high,
        kib_per_1000=kib_per_1000,
        mib_h_at_rate=kib_per_1000 * RATE_HZ * 3.6 / 1024.0,
        objects_per_1000=1000.0 * grown / span if span else float("nan"),
        pairs_per_s=last.segment_pairs / last.t_s,
    )


def table_of(slopes: Sequence[Slope]) -> Table:
    """One row per segment."""
    table = Table(title="growth of memory after warm-up, per process", title_justify="left")
    for heading in (
        "segment",
        "pairs",
        "samples",
        "MiB/h",
        "95 %",
        "KiB per 1000 pairs",
        "MiB/h at 60/s",
        "objects per 1000",
        "pairs/s",
    ):
        table.add_column(heading, justify="right")
    for slope in slopes:
        table.add_row(
            str(slope.segment),
            str(slope.pairs),
            str(slope.n_samples),
            f"{slope.mib_h:.2f}",
            f"{slope.mib_h_low:.2f} to {slope.mib_h_high:.2f}",
            f"{slope.kib_per_1000:.2f}",
            f"{slope.mib_h_at_rate:.2f}",
            f"{slope.objects_per_1000:.2f}",
            f"{slope.pairs_per_s:.1f}",
        )
    return table
