"""Whether repeats of one command are repeats, and whether there are enough of them."""

from itertools import pairwise

import numpy as np

from diagnosis.log.findings import Finding
from diagnosis.replay.stretches import Stretch, repeat_groups
from machine.rotations import Array

REPEATS_RECOMMENDED_MIN = 4
REPEAT_OVERLAP_MAX_FRAC = 0.1  # of the shorter one's length
REFERENCE_SPREAD_MAX_RAD = 1e-3  # between the references of two repeats, once they are laid over each other


def repeat_findings(stretches: tuple[Stretch, ...]) -> list[Finding]:
    """No repeats, few repeats, repeats that were driven by different commands."""
    if not stretches:
        return []
    groups = repeat_groups(stretches)
    if not groups:
        claimed = any(stretch.repeat_of for stretch in stretches)
        why = "repeats are named, but none is one unbroken stretch" if claimed else "no command was repeated"
        text = f"{why}: the noise floor is not known, and every probability is widened"
        return [
            Finding(
                "no_repeats",
                "problem",
                "segments",
                f"{text}; repeat one command at least {REPEATS_RECOMMENDED_MIN} times",
            )
        ]
    findings = []
    for name, members in groups.items():
        if len(members) < REPEATS_RECOMMENDED_MIN:
            text = f"{name!r} has {len(members)} runs; {REPEATS_RECOMMENDED_MIN} or more make a sound noise floor"
            findings.append(Finding("few_repeats", "note", "segments", text))
        findings += _overlap_findings(name, members)
        apart = reference_spread(members)
        if apart > REFERENCE_SPREAD_MAX_RAD:
            text = f"repeats of {name!r} differ by up to {apart:.3g} rad in their reference; they give no noise floor"
            findings.append(Finding("repeats_differ", "problem", "segments", text))
    return findings


def _overlap_findings(name: str, members: tuple[Stretch, ...]) -> list[Finding]:
    """Repeats that are the same rows to a tenth or more: their noise would be none, and all else a gap."""
    inside = sorted(members, key=lambda run: float(run.t_s[0]))
    for run, following in pairwise(inside):
        shared_s = float(min(run.t_s[-1], following.t_s[-1]) - following.t_s[0])
        if shared_s > REPEAT_OVERLAP_MAX_FRAC * min(run.duration_s, following.duration_s):
            text = f"{run.name!r} and {following.name!r} of {name!r} share {shared_s:.3g} s of rows"
            text += ": that is not a second measurement; correct the times in run.toml"
            return [Finding("segments_overlap", "fatal", "segments", text)]
    return []


def laid_over(members: tuple[Stretch, ...], name: str) -> Array | None:
    """One signal of all repeats on one time since their segments' starts, (repeats, m, n); None if one has none."""
    signals = [getattr(run, name) for run in members]
    if any(signal is None for signal in signals):
        return None
    return align_repeats(members, signals)


def align_repeats(members: tuple[Stretch, ...], signals: list[Array]) -> Array:
    """Rows (m, n) of each repeat, brought onto one time since its segment's start by whole steps, cut alike."""
    dt = members[0].dt_s
    starts = [round((run.t_s[0] - run.t_segment_s) / dt) for run in members]
    first = max(starts)
    cut = [signal[first - start :] for start, signal in zip(starts, signals, strict=True)]
    rows = min(len(signal) for signal in cut)
    return np.stack([signal[:rows] for signal in cut])


def reference_spread(members: tuple[Stretch, ...]) -> float:
    """Largest median difference of the repeats' references from their mean [rad]; 0 without references."""
    refs = laid_over(members, "ref")
    if refs is None or refs.shape[1] == 0:
        return 0.0
    apart = np.median(np.abs(refs - refs.mean(axis=0)), axis=1)
    return float(apart[np.isfinite(apart)].max(initial=0.0))
