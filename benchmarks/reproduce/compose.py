"""From saved cases and one example run to pictures and the page."""

import json
from dataclasses import dataclass
from pathlib import Path

from benchmarks.reproduce.cases import Case, FastRun, fast_line_run, fast_matching_run
from benchmarks.reproduce.fast_tables import LINE_VARIANTS, TABLE_4_FILE, case_of, table_2_file
from benchmarks.reproduce.noise_command import AGREEMENT_FILE
from benchmarks.reproduce.noise_model import NoiseModel
from benchmarks.reproduce.pictures import (
    agreement_picture,
    figure_5,
    figure_6,
    figure_7,
    figure_8,
    figure_9,
    save,
    spread_of_table_2,
    spread_of_table_4,
)
from benchmarks.reproduce.rendered_tables import saved_rendered
from benchmarks.reproduce.report import Picture, Section, defects_view, page
from benchmarks.reproduce.report_tables import (
    TableView,
    checks,
    refusals_view,
    table_2_view,
    table_3_view,
    table_4_view,
)
from benchmarks.reproduce.report_words import LEAD, MISMATCH, NOISE_WORDS, SET_UP, figure_title
from benchmarks.saved_lines import Line, read_lines
from machine.description import Machine

EXAMPLES_TRIED = 20  # seeds, until one runs through


@dataclass(frozen=True, slots=True)
class Saved:
    """Every case that is there."""

    table_2: dict[str, list[Case]]
    table_4: list[Case]
    rendered: dict[str, list[Case]]


def saved_cases(folder: Path) -> Saved:
    """What is under an output folder."""
    fast = folder / "fast"
    table_2 = {variant: _cases(fast / table_2_file(variant)) for variant in LINE_VARIANTS}
    return Saved(table_2, _cases(fast / TABLE_4_FILE), saved_rendered(folder / "rendered"))


def _cases(path: Path) -> list[Case]:
    return [case_of(line) for line in read_lines(path).values()]


def printed_tables(folder: Path) -> list[TableView]:
    """The tables for the console: what was asked of the figures, Tables 2 to 4, refusals, agreement of the noise."""
    saved = saved_cases(folder)
    rows = tuple(
        (
            one.name,
            f"{one.value:.1f} {one.unit}",
            f"{one.low:g} to {one.high:g}",
            str(one.n),
            "yes" if one.met else "NO",
        )
        for one in checks(saved.table_2, saved.table_4)
    )
    found = [
        table_2_view(saved.table_2, {kind: saved.rendered[kind] for kind in ("paper servo", "fit")}),
        table_3_view(saved.table_4),
        table_4_view(saved.table_4, saved.rendered["matching"]),
        refusals_view(_all_kinds(saved)),
        TableView(
            "Fast world, image-based, against what was expected", ("figure", "ours", "expected", "N", "inside"), rows
        ),
    ]
    path = folder / "noise" / AGREEMENT_FILE
    if path.exists():
        found.append(agreement_view(json.loads(path.read_text(encoding="utf-8"))["rows"]))
    return found


def write_report(folder: Path, machine: Machine, noise: NoiseModel, seed: int) -> Path:
    """Pictures (PNG, SVG) and report.html from what is saved, the figures of the paper from one example run."""
    saved, pictures = saved_cases(folder), folder / "pictures"
    rendered_2 = {kind: saved.rendered[kind] for kind in ("paper servo", "fit")}
    sections = [
        Section("Set-up", tables=(SET_UP,)),
        Section("Table 2: the line equation", tables=(table_2_view(saved.table_2, rendered_2),),
                pictures=(_spread_2(saved, pictures),)),
        Section("Table 3: trajectory matching, the match itself", tables=(table_3_view(saved.table_4),)),
        Section("Table 4: trajectory matching, the moves",
                tables=(table_4_view(saved.table_4, saved.rendered["matching"]),),
                pictures=(_spread_4(saved, pictures),)),
        Section("Figures 5 to 9", pictures=example_pictures(machine, noise, seed, pictures)),
        Section("Runs that gave no figure", tables=(refusals_view(_all_kinds(saved)),)),
        Section("What does not match, and why", tables=(MISMATCH, defects_view())),
        *_noise_section(folder / "noise", pictures, noise),
    ]  # fmt: skip
    text = page("The paper, reproduced", LEAD, checks(saved.table_2, saved.table_4), sections)
    path = folder / "report.html"
    path.write_text(text, encoding="utf-8")
    return path


def _all_kinds(saved: Saved) -> dict[str, list[Case]]:
    fast = {f"fast: Table 2, {kind}": cases for kind, cases in saved.table_2.items()}
    rendered = {f"rendered: {kind}": cases for kind, cases in saved.rendered.items() if cases}
    return {**fast, "fast: Tables 3 and 4": saved.table_4, **rendered}


def _spread_2(saved: Saved, pictures: Path) -> Picture:
    path = save(spread_of_table_2(saved.table_2), pictures, "table2")
    return Picture(path, "Where the one move of the line equation ends.", "Each dot is one machine, image-based.")


def _spread_4(saved: Saved, pictures: Path) -> Picture:
    path = save(spread_of_table_4(saved.table_4), pictures, "table4")
    return Picture(path, "Errors after both inputs of the trajectory matching.", "Image-based, camera axes.")


def example_pictures(machine: Machine, noise: NoiseModel, seed: int, pictures: Path) -> tuple[Picture, ...]:
    """Figures 5 to 9, from the first seeds from `seed` on that run through."""
    line, matching = _first_done(machine, noise, seed)
    drawn = {
        5: (figure_5(matching), matching),
        6: (figure_6(line), line),
        7: (figure_7(line), line),
        8: (figure_8(matching), matching),
        9: (figure_9(matching), matching),
    }
    found = []
    for number, (figure, run) in drawn.items():
        title, shows = figure_title(number)
        caption = f"Ours: preset paper, seed {run.case.seed}, fast. {shows}"
        found.append(Picture(save(figure, pictures, f"figure{number}"), title, caption))
    return tuple(found)


def _first_done(machine: Machine, noise: NoiseModel, seed: int) -> tuple[FastRun, FastRun]:
    for one in range(seed, seed + EXAMPLES_TRIED):
        line, matching = fast_line_run(machine, one, noise, "paper"), fast_matching_run(machine, one, noise)
        if line.case.state == matching.case.state == "done":
            return line, matching
    raise RuntimeError(f"none of the seeds {seed} to {seed + EXAMPLES_TRIED - 1} runs through; give another --seed")


def _noise_section(folder: Path, pictures: Path, noise: NoiseModel) -> list[Section]:
    words = (f"The model in use: {noise.source}.", *NOISE_WORDS)
    path = folder / AGREEMENT_FILE
    if not path.exists():
        return [Section("Noise of the fast world", (*words, "Run `longreach reproduce noise` for its agreement."))]
    data = json.loads(path.read_text(encoding="utf-8"))
    picture = Picture(save(agreement_picture(data["distributions"]), pictures, "noise"), "Rendered against fast.", "")
    return [Section("Noise of the fast world", words, (agreement_view(data["rows"]),), (picture,))]


def agreement_view(rows: list[Line]) -> TableView:
    """The table of agreement."""
    headings = (
        "quantity",
        "axis",
        "n",
        "sd rendered",
        "sd fast / rendered",
        "median rendered",
        "median fast",
        "KS",
        "p",
    )
    cells = tuple(
        (row["name"], row["axis"], str(row["n"]), f"{row['sd_rendered']:.3f} {row['unit']}", f"{row['sd_ratio']:.2f}",
         f"{row['mean_rendered']:+.3f}", f"{row['mean_fast']:+.3f}", f"{row['ks']:.2f}", f"{row['p']:.3f}")
        for row in rows
    )  # fmt: skip
    return TableView("Agreement of the noise model with rendered images", headings, cells)
