"""`python -m benchmarks.diagnosis.sealed.judge --folder DIR --machine FILE [--plant own]`: an answer against its truth.

Opens the sealed truth, checks its hash, and writes DIR/score.json. Names count as one only where the scorer's own
separation T on that recording is below 9.
"""

import argparse
import hashlib
import json
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.diagnosis.sealed import nominal_own as own
from benchmarks.diagnosis.sealed.cases import recording_seed
from benchmarks.diagnosis.sealed.faults import Injected, faults_of
from benchmarks.diagnosis.sealed.plants import NAMES, OWN, Plant, plant_named
from benchmarks.diagnosis.sealed.recorded import NOISES, make
from benchmarks.diagnosis.sealed.scales import BY_NAME
from benchmarks.diagnosis.sealed.sensitivity import FOUND, Scene, Signature, scene_of, separation, signature, size2
from machine.effects.registry import effect_named
from machine.remainder import Remainder, parse_remainders
from recording.files import write_durably

SEPARATED = 9.0
IN_LOG = ("dropped_samples", "swapped_joints", "loose_marker")  # spoil what was written down, however strong
SPLIT_SHARES = (0.7, 1.4)  # of the named size, besides itself: thresholds bend
Key = tuple[str, int | None]
Separation = Callable[[Injected, dict[str, Any]], float]
SEEN_AS = {  # where a gap of a stage without rows of its own shows
    "joint": ("joint", "structure", "camera"),
    "time": ("time", "camera", "structure"),
}


UNREAD: dict[str, Any] = {  # the tool would not diagnose the recording at all
    "verdict": "undecided",
    "hypotheses": [],
    "outside_probability": 1.0,
    "indistinguishable": [],
    "credible_set_90": [],
    "localisation": [],
    "shrink": {},
    "detection_limits": [],
    "budget": {"effects": []},
}


class SealError(Exception):
    """A truth that is not the one that was sealed."""


def opened(folder: Path) -> dict[str, Any]:
    """The sealed truth, after its hash was compared with the recording's seal."""
    text = (folder / "sealed" / "truth.json").read_text(encoding="utf-8")
    seal = json.loads((folder / "recording" / "seal.json").read_text(encoding="utf-8"))["sha256"]
    if hashlib.sha256(text.encode()).hexdigest() != seal:
        raise SealError(f"{folder}: the truth's hash is not the seal's; the case is void")
    return json.loads(text)


def keys(effects: list[dict[str, Any]]) -> list[Key]:
    """Distinct names with joints, in order."""
    return list(dict.fromkeys((one["name"], one["joint"]) for one in effects))


class Equal:
    """Whether two names are one on this recording, by the scorer's own sensitivity; the scene is made when needed."""

    def __init__(self, truth: dict[str, Any], remainders: tuple[Remainder, ...], plant: Plant = OWN) -> None:
        self._truth, self._remainders, self._plant = truth, remainders, plant
        self._scene: Scene | None = None
        self._known: dict[tuple[Key, Key], float] = {}
        self._signatures: dict[str, Signature] = {}

    def separation(self, true: Injected, named: dict[str, Any]) -> float:
        """T between a true effect and a named one, at the named size and beside it."""
        if named["name"] not in BY_NAME:
            return float("inf")
        key = ((true.name, true.joint), (named["name"], named["joint"]))
        if key not in self._known:
            a = self._signature(true)
            rivals = [_injected(named, share) for share in (1.0, *SPLIT_SHARES)]
            self._known[key] = min(separation(a, self._signature(one)) for one in rivals)
        return self._known[key]

    def strength(self, true: Injected) -> float:
        """Size of a true effect over its detection limit on this very recording: |s| / |s| at the limit."""
        return float(np.sqrt(size2(self._signature(true)) / FOUND))

    def closed(self, true: list[Injected], named: list[dict[str, Any]]) -> float | None:
        """The share of the true effects' whitened gap that the named ones, at their fitted sizes, really close.

        None where they move nothing on this recording.
        """
        a, b = (_summed([self._signature(one) for one in side]) for side in (true, [_injected(n, 1.0) for n in named]))
        left = size2(_summed([a, {name: -part for name, part in b.items()}]))
        return 1.0 - left / size2(a) if size2(a) > 0.0 else None

    def _signature(self, one: Injected) -> Signature:
        if str(one) not in self._signatures:
            self._signatures[str(one)] = signature(self._made(), one)
        return self._signatures[str(one)]

    def _made(self) -> Scene:
        if self._scene is None:
            noise = NOISES[self._truth["noise"]]
            seed = recording_seed(self._truth["number"], self._truth["seed"])
            made = make(faults_of((), own.N), noise, seed, self._plant)
            self._scene = scene_of(made, noise, seed, self._remainders)
        return self._scene


def _summed(parts: list[Signature]) -> Signature:
    out: Signature = {}
    for one in parts:
        for name, part in one.items():
            out[name] = out[name] + part if name in out else part
    return out


def _injected(named: dict[str, Any], share: float) -> Injected:
    """A named effect of the answer as one to inject, at a share of its size."""
    effect = effect_named(named["name"])
    if effect is None:
        raise SealError(f"{named['name']} is no effect of the catalogue")
    values, option, direction = {}, "", ()
    for name, number in named["parameters"].items():
        if effect.quantity_choice is not None and name == effect.quantity_choice.name:
            option = number["value"]
        elif effect.direction is not None and name == effect.direction.name:
            direction = tuple(number["value"])
        else:
            values[name] = float(number["value"])
    size = effect.size.name
    out = Injected(named["name"], named["joint"], {size: values.pop(size), **values}, option, direction)
    return replace(out, values={**out.values, size: share * out.size})


def judged(
    truth: dict[str, Any], answer: dict[str, Any], remainders: tuple[Remainder, ...], plant: Plant = OWN
) -> dict[str, Any]:
    """Everything the tables count, of one case."""
    true = [Injected(**{**one["effect"], "direction": tuple(one["effect"]["direction"])}) for one in truth["effects"]]
    if "refused_to_read" in answer:
        answer = {**UNREAD, "why": answer["refused_to_read"]}
    catalogue = truth["mix"] in ("single", "double")
    equal = Equal(truth, remainders, plant)
    named = {(row["name"], row["joint"]): row for row in answer["budget"]["effects"] if row["status"] == "confirmed"}
    pairs = matched(true, list(named.values()), equal.separation) if catalogue else {}
    refused = answer["verdict"] in ("outside", "undecided")
    claimed = list(named)
    false = [key for key in claimed if key not in pairs.values()]
    exact_named = len(pairs) == len(true) == len(named)
    strengths = [equal.strength(one) if one.name not in IN_LOG else None for one in true]
    found = {
        "verdict": answer["verdict"],
        "why": answer["why"],
        "named": [list(key) for key in named],
        "true": [[one.name, one.joint] for one in true],
        "refused": refused,
        "exact": answer["verdict"] in ("effects", "partly") and exact_named,
        "exact_named": exact_named,
        "some": bool(pairs),
        "twin": _twin(true, claimed, named, equal.separation) if truth["mix"] == "lacking" else None,
        "false": [list(key) for key in false],
        "false_named": [list(key) for key in named if key not in pairs.values()],
        "none": not named and answer["verdict"] == "none",
        "probabilities": _probabilities(true, answer, equal.separation) if catalogue else [],
        "outside_probability": answer["outside_probability"],
        "first_stage": first_stage(answer),
        "stage_right": stage_right(truth, answer),
        "credible": _credible(true, answer, equal.separation, truth["mix"]),
        "credible_size": len(answer["credible_set_90"]),
        "classes": _class_sizes(answer, list(named)),
        "closed": (answer["shrink"].get("overall") or {}),
        "closed_true": equal.closed(true, list(named.values())) if exact_named and pairs else None,
        "strengths": strengths,
        "limits": _limits(true, strengths, answer),
        "values": _values(true, named),
    }
    kept = ("number", "seed", "mix", "noise", "effects", "lacking")
    return {**{name: truth[name] for name in kept}, **found}


def matched(true: list[Injected], named: list[dict[str, Any]], separation_of: Separation) -> dict[Key, Key]:
    """True effect -> the name that stands for it: its own, or one that T < 9 makes the same."""
    by_key = {(one["name"], one["joint"]): one for one in named}
    out = {(one.name, one.joint): (one.name, one.joint) for one in true if (one.name, one.joint) in by_key}
    for one in true:
        key = (one.name, one.joint)
        for other, effect in by_key.items():
            if key not in out and other not in out.values() and separation_of(one, effect) < SEPARATED:
                out[key] = other
    return out


def _twin(
    true: list[Injected], claimed: list[Key], named: dict[Key, dict[str, Any]], separation_of: Separation
) -> bool:
    """Whether what was claimed in place of a name that the tool lacks is its equal on this recording, by T < 9."""
    return bool(claimed) and len(matched(true, [named[key] for key in claimed], separation_of)) == len(claimed)


def _credible(true: list[Injected], answer: dict[str, Any], separation_of: Separation, mix: str) -> bool:
    """Whether the 90 % set holds the truth; outside counts where the tool gives it a probability of a tenth or more."""
    if mix in ("foreign", "lacking"):
        return answer["outside_probability"] >= 0.1
    wanted = {(one.name, one.joint) for one in true}
    by_key = {(e["name"], e["joint"]): e for h in answer["hypotheses"] for e in h["effects"]}
    for one in answer["credible_set_90"]:
        found = set(keys(one["effects"]))
        if found == wanted:
            return True
        known = [by_key[key] for key in found if key in by_key]
        if len(known) == len(found) == len(wanted) == len(matched(true, known, separation_of)):
            return True
    return False


def _class_sizes(answer: dict[str, Any], named: list[Key]) -> list[int]:
    """Of each named effect, how many it is told together with, itself counted: 1 where it is told apart from all."""
    classes = {(one[0]["name"], one[0]["joint"]): len(one) for one in answer["indistinguishable"]}
    return [classes.get(key, 1) for key in named]


def first_stage(answer: dict[str, Any]) -> str:
    """The stage with the largest share of the gap."""
    rows = [one for one in answer["localisation"] if one["regime"] == "all" or one["joint"] is None]
    totals: dict[str, float] = {}
    for one in rows:
        totals[one["stage"]] = max(totals.get(one["stage"], 0.0), one["share_frac"])
    return max(totals, key=lambda name: totals[name], default="")


def stage_right(truth: dict[str, Any], answer: dict[str, Any]) -> bool | None:
    """Whether the first stage is one where something is wrong; None without a fault."""
    if not truth["effects"]:
        return None
    allowed = {name for one in truth["effects"] for name in SEEN_AS.get(one["stage"], (one["stage"],))}
    return first_stage(answer) in allowed


def _limits(true: list[Injected], strengths: list[float | None], answer: dict[str, Any]) -> list[dict[str, Any]]:
    """The tool's detection limit beside the scorer's on the same recording, of each true effect in proportion to which
    a residual moves.
    """
    theirs = {(one["name"], one["joint"]): one["size"] for one in answer["detection_limits"]}
    return [
        {
            "name": one.name,
            "joint": one.joint,
            "scorer": abs(one.size) / times,
            "tool": theirs.get((one.name, one.joint)),
        }
        for one, times in zip(true, strengths, strict=True)
        if times and one.name in BY_NAME and not BY_NAME[one.name].limits
    ]


def _values(true: list[Injected], named: dict[Key, dict[str, Any]]) -> list[dict[str, Any]]:
    """Size and its 90 % limits of each effect that was named rightly."""
    out = []
    for one in true:
        found = named.get((one.name, one.joint))
        if found is not None:
            effect = effect_named(one.name)
            number = found["parameters"][effect.size.name if effect else ""]
            low, high = number["low"], number["high"]
            inside = low is not None and high is not None and low <= one.size <= high
            out.append({"name": one.name, "true": one.size, "value": number["value"], "inside": inside})
    return out


def _probabilities(true: list[Injected], answer: dict[str, Any], separation_of: Separation) -> list[tuple[float, bool]]:
    """Of each effect of the budget its probability, and whether it is there; equals count as there."""
    rows = answer["budget"]["effects"]
    there = set(matched(true, rows, separation_of).values())
    return [(row["probability"], (row["name"], row["joint"]) in there) for row in rows]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--machine", type=Path, required=True)
    parser.add_argument("--plant", choices=NAMES, default="own")
    given = parser.parse_args()
    truth = opened(given.folder)
    answer = json.loads((given.folder / "answer.json").read_text(encoding="utf-8"))
    machine = tomllib.loads(given.machine.read_text(encoding="utf-8"))
    score = judged(truth, answer, parse_remainders(machine.get("remainder")), plant_named(given.plant))
    write_durably(given.folder / "score.json", json.dumps(score))  # its presence says that the case is done


if __name__ == "__main__":
    main()
