"""`[[remainder]]` of a machine file: what a fitted baseline cannot explain, as an addition to the noise."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from machine.effects.registry import effect_named
from machine.errors import MachineFileError

if TYPE_CHECKING:
    from machine.effects.entries import EffectEntry

RENAMED_KEYS = {"swing_rad": "oscillation_rad"}  # old name, read for one release
REMAINDER_STAGES = ("link", "controller", "actuator", "structure", "camera")
ABSOLUTE_VALUE_MAX = 1e12  # of any number here: squares and sums of more leave what a float holds
# fmt: off
REMAINDER_TABLE_KEYS = {
    "stage", "joint", "on", "sigma", "rms", "ar", "usual", "by_axis", "oscillation_rad", "form", "form_most", "wander",
    "level",
}
# fmt: on
Form = tuple[tuple[str, tuple[float, ...]], ...]


@dataclass(frozen=True, slots=True)
class Remainder:
    """What the baseline does not explain of one stage's residual, on recordings that it was not fitted to.

    `sigma`: innovation of the 20 Hz increments (link [rad], controller [1], actuator [rad]) or of points [m], corners
    [px], without the noise; `rms`: the same before whitening; `ar`: the increments' autoregression. `on`: static,
    tracker, ooi or tool.
    `by_axis`: of points, sigma radial, tangential, up about the base's upright; of corners, what u and v of all corners
    of a frame share, besides each own `sigma`. `oscillation_rad`: slew oscillation shared by the points of an instant.
    `usual`: what each effect gains at most on baseline recordings [nats]. `form`: what the model
    itself is wrong by there, as a function of what drives it (actuator [rad], points [m]): families and the numbers of
    each; `form_most`: the most that it gave for a baseline recording, mean square in floors, 0 where that does not
    matter. `wander`: how far numbers of effects are off from one day to the next, in each one's own unit.
    `level`: mean square, in floors, that one more healthy recording stays below (99.9 % prediction limit).
    """

    stage: str
    joint: int | None
    on: str
    sigma: float
    rms: float
    ar: tuple[float, ...] = ()
    usual: tuple[tuple[str, float], ...] = ()
    by_axis: tuple[float, ...] = ()
    oscillation_rad: float = 0.0
    form: Form = ()
    form_most: float = 0.0
    wander: tuple[tuple[str, float], ...] = ()
    level: float = 1.0


def parse_baseline(tables: object, n_joints: int) -> "tuple[EffectEntry, ...]":
    """The effects of a machine file's `effect` list; the compiled kernel behind its reader only where there is one.

    Raises: MachineFileError: see `machine.effects.entries.parse_entries`.
    """
    if tables is None:
        return ()
    from machine.effects.entries import parse_entries

    return parse_entries(tables, n_joints)


def parse_remainders(tables: object) -> tuple[Remainder, ...]:
    """The remainders of a machine file's `remainder` list, as `tomllib` gives it (None: no list).

    Raises: MachineFileError: naming entry, field and value.
    """
    if tables is None:
        return ()
    if not isinstance(tables, list):
        raise MachineFileError(f"remainder = {tables!r} is not a list; write each as its own [[remainder]] table")
    return tuple(
        _parse_remainder(_rename_old_keys(table), f"remainder {number}") for number, table in enumerate(tables, start=1)
    )


def _rename_old_keys(table: object) -> object:
    return {RENAMED_KEYS.get(key, key): value for key, value in table.items()} if isinstance(table, dict) else table


def _parse_remainder(table: object, where: str) -> Remainder:
    if not isinstance(table, dict):
        raise MachineFileError(f"{where} is not a table; write [[remainder]] with stage, joint, sigma and rms")
    unknown = sorted(set(table) - REMAINDER_TABLE_KEYS)
    if unknown:
        raise MachineFileError(
            f"{where}: unknown key {unknown[0]!r}; it has {', '.join(sorted(REMAINDER_TABLE_KEYS))}. A baseline of an "
            "older version has to be fitted again (`longreach diagnose --fit-baseline`)"
        )
    stage, joint, on, ar, by_axis = (table.get(key) for key in ("stage", "joint", "on", "ar", "by_axis"))
    if stage not in REMAINDER_STAGES:
        raise MachineFileError(f"{where}: stage = {stage!r}; give one of {', '.join(REMAINDER_STAGES)}")
    if joint is not None and (isinstance(joint, bool) or not isinstance(joint, int) or joint < 1):
        raise MachineFileError(f"{where}: joint = {joint!r}; give a whole number from 1, or leave it out")
    return Remainder(
        stage,
        joint,
        str(on or ""),
        _number_at_least(table, "sigma", 0.0, where),
        _number_at_least(table, "rms", 0.0, where),
        _parse_numbers(ar, f"{where}: ar"),
        _parse_named_sizes(table.get("usual", {}), f"{where}: usual"),
        _parse_numbers(by_axis, f"{where}: by_axis"),
        _number_at_least(table, "oscillation_rad", 0.0, where),
        _parse_form(table.get("form", {}), where),
        _number_at_least(table, "form_most", 0.0, where),
        _parse_wander(table.get("wander", {}), f"{where}: wander"),
        _number_at_least({"level": 1.0, **table}, "level", 1.0, where),
    )


def _parse_form(value: object, where: str) -> Form:
    if not isinstance(value, dict):
        raise MachineFileError(f"{where}: form = {value!r} is not a table of families and their numbers")
    return tuple((str(name), _parse_numbers(row, f"{where}: form.{name}")) for name, row in value.items())


def _parse_wander(value: object, subject: str) -> tuple[tuple[str, float], ...]:
    sizes = _parse_named_sizes(value, subject)
    for name, _ in sizes:
        effect = effect_named(name)
        if effect is None or effect.scope != "joint":
            raise MachineFileError(f"{subject}.{name}: the catalogue has no effect of a joint of that name")
    return sizes


def _parse_named_sizes(value: object, subject: str) -> tuple[tuple[str, float], ...]:
    if not isinstance(value, dict):
        raise MachineFileError(f"{subject} = {value!r} is not a table of names and sizes")
    return tuple((str(name), _finite_number(size, f"{subject}.{name}")) for name, size in value.items())


def _parse_numbers(value: object, subject: str) -> tuple[float, ...]:
    if value is None:
        return ()
    if not isinstance(value, list):
        raise MachineFileError(f"{subject} = {value!r} is not a list of numbers")
    return tuple(_finite_number(number, subject) for number in value)


def _number_at_least(table: dict[str, object], key: str, least: float, where: str) -> float:
    value = _finite_number(table.get(key, least), f"{where}: {key}")
    if value < least:
        raise MachineFileError(f"{where}: {key} = {value:g} is below {least:g}")
    return value


def _finite_number(value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= ABSOLUTE_VALUE_MAX:
        raise MachineFileError(f"{where} = {repr(value)[:60]} is not a finite number up to {ABSOLUTE_VALUE_MAX:g}")
    return float(value)


def remainders_to_toml(remainders: Iterable[Remainder]) -> str:
    """`[[remainder]]` tables that `parse_remainders` reads back to the same numbers."""
    return "".join(_remainder_to_toml(remainder) for remainder in remainders)


def _remainder_to_toml(one: Remainder) -> str:
    joint = f"joint = {one.joint}\n" if one.joint is not None else ""
    on = f'on = "{one.on}"\n' if one.on else ""
    more = _inline_toml_table("usual", one.usual)
    if one.by_axis:
        more += f"by_axis = [{', '.join(map(repr, one.by_axis))}]\n"
    if one.oscillation_rad:
        more += f"oscillation_rad = {one.oscillation_rad!r}\n"
    if one.form:
        families = ", ".join(f"{json.dumps(name)} = [{', '.join(map(repr, row))}]" for name, row in one.form)
        more += f"form = {{ {families} }}\nform_most = {one.form_most!r}\n"
    more += _inline_toml_table("wander", one.wander)
    more += f"level = {one.level!r}\n" if one.level != 1.0 else ""
    numbers = f"sigma = {one.sigma!r}\nrms = {one.rms!r}\n"
    return f'\n[[remainder]]\nstage = "{one.stage}"\n{joint}{on}{numbers}ar = [{", ".join(map(repr, one.ar))}]\n{more}'


def _inline_toml_table(key: str, sizes: tuple[tuple[str, float], ...]) -> str:
    pairs = ", ".join(f"{json.dumps(name)} = {size!r}" for name, size in sizes)
    return f"{key} = {{ {pairs} }}\n" if pairs else ""
