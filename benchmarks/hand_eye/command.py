"""`longreach bench hand-eye`."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track as progress_over
from rich.table import Table

from benchmarks.hand_eye.kinhec_tracks import (
    TRACKS,
    SequenceResult,
    TrackResult,
    generate,
    kinhec_available,
    run_track,
)
from benchmarks.hand_eye.real_pairs import Alignment, PairResiduals, align_trajectories, hand_eye_residuals
from benchmarks.hand_eye.streams import HAND_EYE_FILES, TRAJECTORY_FILES

console = Console(width=170)


def hand_eye(
    data: Annotated[Path, typer.Option(help="folder with hand_eye/ and trajectories/")] = Path("../shared/data"),
    tier: Annotated[str, typer.Option(help="kinhec's tier: smoke or small")] = "smoke",
    folder: Annotated[Path, typer.Option(help="where sequences and the result are kept")] = Path("runs/bench-hand-eye"),
) -> None:
    """A X = Y B on real and simulated arms, trajectories beside evo, and kinhec's tracks beside its own solvers."""
    folder.mkdir(parents=True, exist_ok=True)
    report: dict[str, object] = {}
    if (data / "hand_eye").is_dir():
        pairs = {name: hand_eye_residuals(data / "hand_eye", name) for name in progress_over(HAND_EYE_FILES, "arms")}
        console.print(_pairs(pairs))
        report["arms"] = {name: _figures(one) for name, one in pairs.items()}
    else:
        console.print(f"no {data / 'hand_eye'}: the real arms are skipped")
    if (data / "trajectories").is_dir():
        aligned = {name: align_trajectories(data / "trajectories", name) for name in TRAJECTORY_FILES}
        console.print(_alignments(aligned))
        report["trajectories"] = {name: asdict(one) for name, one in aligned.items()}
    else:
        console.print(f"no {data / 'trajectories'}: the alignment beside evo is skipped")
    if kinhec_available():
        generate(folder / tier, tier)
        found = [run_track(folder / tier, name) for name in progress_over(TRACKS, "kinhec")]
        console.print(_tracks([one for one, _ in found], [each for _, sequences in found for each in sequences]))
        report["kinhec"] = [asdict(one) | {"sequences": [asdict(each) for each in several]} for one, several in found]
    else:
        console.print("kinhec is not installed: its tracks are skipped")
    (folder / "hand_eye.json").write_text(json.dumps(report, indent=1), encoding="utf-8")


def _figures(one: PairResiduals) -> dict[str, float]:
    figures = {key: value for key, value in asdict(one).items() if key != "estimate"}
    return figures | {
        "offset_ms": 1e3 * one.estimate.time_offset_s,
        "offset_sigma_ms": 1e3 * one.estimate.time_offset_sigma_s,
    }


def _pairs(found: dict[str, PairResiduals]) -> Table:
    table = Table(title="A X = Y B on robot arms: residuals over all samples", title_justify="left")
    for heading in (
        "arm",
        "N",
        "median deg",
        "p90",
        "median mm in camera",
        "median mm in base",
        "p90",
        "offset 0: mm in base",
    ):
        table.add_column(heading)
    table.add_column("clock offset ms")
    for name, one in found.items():
        offset = f"{1e3 * one.estimate.time_offset_s:.1f} +- {1e3 * one.estimate.time_offset_sigma_s:.1f} of 250"
        figures = (one.median_deg, one.p90_deg, one.camera_median_mm, one.base_median_mm, one.base_p90_mm)
        table.add_row(name, str(one.n), *(f"{x:.2f}" for x in figures), f"{one.base_median_mm_no_offset:.2f}", offset)
    return table


def _alignments(found: dict[str, Alignment]) -> Table:
    table = Table(title="trajectories: absolute error after alignment, mm", title_justify="left")
    for heading in ("trajectory", "N", "scale", "our least squares", "evo", "our chords", "chords turned by deg"):
        table.add_column(heading)
    for name, one in found.items():
        for scale, ours, evo, chords in (
            ("free", one.ate_m, one.evo_ate_m, f"{1e3 * one.chords_ate_m:.3f}"),
            ("1", one.rigid_ate_m, one.evo_rigid_ate_m, ""),
        ):
            theirs = "not installed" if evo is None else f"{1e3 * evo:.3f}"
            turned = f"{one.chords_turned_deg:.3f}" if chords else ""
            table.add_row(name, str(one.n), scale, f"{1e3 * ours:.3f}", theirs, chords, turned)
    return table


def _tracks(found: list[TrackResult], sequences: list[SequenceResult]) -> Table:
    table = Table(title="kinhec: median errors of X against exact truth", title_justify="left")
    for heading in ("track", "N", "refused", "ours deg", "its best deg", "ours mm", "its best mm", "held in 95 %"):
        table.add_column(heading)
    for one in found:
        chi2 = [each.chi2 for each in sequences if each.track == one.track and each.chi2 is not None]
        table.add_row(
            one.track,
            str(one.n),
            str(one.refused),
            f"{one.rotation_deg:.3f}",
            f"{one.best_rotation[1]:.3f} ({one.best_rotation[0]})",
            f"{one.translation_mm:.2f}",
            f"{one.best_translation[1]:.2f} ({one.best_translation[0]})",
            f"{sum(value < 12.59 for value in chi2)} of {len(chi2)}",
        )
    worst = max((abs(each.offset_error_ms) for each in sequences if each.track == "temporal"), default=float("nan"))
    table.caption = f"temporal: clock offset found within {worst:.1f} ms; its best: least median over its 11 solvers"
    return table
