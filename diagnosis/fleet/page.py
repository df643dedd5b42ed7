"""The fleet's report: one page without scripts."""

from html import escape

from diagnosis.fleet.summary import EffectDrift, Fleet, SharedEffect
from diagnosis.report.html import html_document, html_section, html_table

VERDICT_LABELS = {"none": "✓ none", "effects": "! effects", "outside": "✗ outside", "undecided": "? undecided"}


def fleet_page(fleet: Fleet, name: str) -> str:
    """Shared effects first, then drift, then machine by machine."""
    total = sum(len(verdicts) for verdicts in fleet.verdicts_by_machine.values())
    facts = f"{len(fleet.machines)} machines, {total} recordings diagnosed, {len(fleet.unusable_recordings)} not usable"
    if fleet.no_serial:
        facts += (
            f". {fleet.no_serial} state no serial: those of one folder count as one machine's; {SERIAL_NUMBER_ADVICE}"
        )
    body = [
        f"<h1>Sim-to-real gap of a fleet: {escape(name)}</h1><p>{escape(facts)}.</p>",
        _table_section(
            "Effects that machines share",
            [_shared_effect_row(effect) for effect in fleet.shared_effects],
            SHARED_EFFECT_TABLE_HEADERS,
        ),
        _table_section("Drift", [_drift_row(drift) for drift in fleet.effect_drifts], DRIFT_TABLE_HEADERS),
        _table_section(
            "Machine by machine",
            [(m, _verdicts_text(fleet.verdicts_by_machine[m])) for m in fleet.machines],
            MACHINE_TABLE_HEADERS,
        ),
        _table_section(
            "Every size found",
            [_finding_row(fleet, k) for k in range(len(fleet.found_effects))],
            FOUND_EFFECT_TABLE_HEADERS,
        ),
        _table_section("Not usable", list(fleet.unusable_recordings), ("recording", "why")),
    ]
    return html_document(name, "".join(body))


SERIAL_NUMBER_ADVICE = "set serial in [machine] of each machine file"
SHARED_EFFECT_TABLE_HEADERS = ("effect", "joint", "machines that have it", "looked for and not found on")
DRIFT_TABLE_HEADERS = ("machine", "effect", "joint", "change per day", "90 %", "recordings", "")
MACHINE_TABLE_HEADERS = ("machine", "verdicts in the order of time")
FOUND_EFFECT_TABLE_HEADERS = ("machine", "recording", "effect", "joint", "size", "90 %", "unit")


def _shared_effect_row(shared: SharedEffect) -> tuple[str, ...]:
    return (
        shared.name,
        _joint_text(shared.joint),
        f"{len(shared.machines_with)}: {', '.join(shared.machines_with)}",
        ", ".join(shared.machines_without),
    )


def _drift_row(drift: EffectDrift) -> tuple[str, ...]:
    limits = f"{drift.lower_90:.3g} to {drift.upper_90:.3g}"
    word = "drifts" if drift.is_drifting else "no drift found"
    return (
        drift.machine,
        drift.name,
        _joint_text(drift.joint),
        f"{drift.per_day:.3g} {drift.unit}",
        limits,
        str(drift.recording_count),
        word,
    )


def _verdicts_text(verdicts: tuple[tuple[str, str], ...]) -> str:
    return ", ".join(f"{VERDICT_LABELS[word]} ({name})" for name, word in verdicts)


def _finding_row(fleet: Fleet, k: int) -> tuple[str, ...]:
    finding = fleet.found_effects[k]
    limits = f"{finding.lower_90:.4g} to {finding.upper_90:.4g}"
    return (
        finding.machine,
        finding.recording,
        finding.name,
        _joint_text(finding.joint),
        f"{finding.value:.4g}",
        limits,
        finding.unit,
    )


def _joint_text(joint: int | None) -> str:
    return "" if joint is None else str(joint)


def _table_section(title: str, rows: list[tuple[str, ...]], columns: tuple[str, ...]) -> str:
    return html_section(title, html_table(columns, rows))
