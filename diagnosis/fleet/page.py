"""The fleet's report: one page without scripts."""

from html import escape

from diagnosis.fleet.summary import EffectDrift, Fleet, SharedEffect
from diagnosis.report.html import html_document, html_section, html_table

WORDS = {"none": "✓ none", "effects": "! effects", "outside": "✗ outside", "undecided": "? undecided"}


def fleet_page(fleet: Fleet, name: str) -> str:
    """Shared effects first, then drift, then machine by machine."""
    total = sum(len(verdicts) for verdicts in fleet.verdicts.values())
    facts = f"{len(fleet.machines)} machines, {total} recordings diagnosed, {len(fleet.unusable)} not usable"
    if fleet.no_serial:
        facts += f". {fleet.no_serial} state no serial: those of one folder count as one machine's; {SERIAL}"
    body = [
        f"<h1>Sim-to-real gap of a fleet: {escape(name)}</h1><p>{escape(facts)}.</p>",
        _section("Effects that machines share", [_shared(effect) for effect in fleet.shared], SHARED),
        _section("Drift", [_drift(drift) for drift in fleet.drifts], DRIFT),
        _section("Machine by machine", [(m, _verdicts(fleet.verdicts[m])) for m in fleet.machines], MACHINES),
        _section("Every size found", [_found(fleet, k) for k in range(len(fleet.found))], FOUND),
        _section("Not usable", list(fleet.unusable), ("recording", "why")),
    ]
    return html_document(name, "".join(body))


SERIAL = "set serial in [machine] of each machine file"
SHARED = ("effect", "joint", "machines that have it", "looked for and not found on")
DRIFT = ("machine", "effect", "joint", "change per day", "90 %", "recordings", "")
MACHINES = ("machine", "verdicts in the order of time")
FOUND = ("machine", "recording", "effect", "joint", "size", "90 %", "unit")


def _shared(shared: SharedEffect) -> tuple[str, ...]:
    return (
        shared.name,
        _joint(shared.joint),
        f"{len(shared.machines)}: {', '.join(shared.machines)}",
        ", ".join(shared.without),
    )


def _drift(drift: EffectDrift) -> tuple[str, ...]:
    limits = f"{drift.low:.3g} to {drift.high:.3g}"
    word = "drifts" if drift.drifts else "no drift found"
    return (
        drift.machine,
        drift.name,
        _joint(drift.joint),
        f"{drift.per_day:.3g} {drift.unit}",
        limits,
        str(drift.n),
        word,
    )


def _verdicts(verdicts: tuple[tuple[str, str], ...]) -> str:
    return ", ".join(f"{WORDS[word]} ({name})" for name, word in verdicts)


def _found(fleet: Fleet, k: int) -> tuple[str, ...]:
    finding = fleet.found[k]
    limits = f"{finding.low:.4g} to {finding.high:.4g}"
    return (
        finding.machine,
        finding.recording,
        finding.name,
        _joint(finding.joint),
        f"{finding.value:.4g}",
        limits,
        finding.unit,
    )


def _joint(joint: int | None) -> str:
    return "" if joint is None else str(joint)


def _section(title: str, rows: list[tuple[str, ...]], columns: tuple[str, ...]) -> str:
    return html_section(title, html_table(columns, rows))
