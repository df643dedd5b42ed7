"""`[[effect]]` entries of a machine file: read with clear errors, written back, and packed for the kernel."""

import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from machine.effects.kernel import FLEX_DAMPING, FLEX_GAIN, FLEX_HZ, KNOWN_DAMPING, KNOWN_GAIN, KNOWN_HZ
from machine.effects.layout import ParameterSets, column_of, neutral_sets
from machine.effects.registry import NAMES, effect_named
from machine.effects.spec import Effect, Parameter
from machine.errors import MachineFileError

OSCILLATION_EFFECT_NAME = "link_flexibility"
Vector = tuple[float, ...]


GAIN_FACTOR_EFFECT_NAMES = (  # sizes x of a factor 1 + x
    "flow_gain_error",
    "valve_asymmetry",
    "controller_gain_error",
    "controller_lag_error",
    "encoder_scale",
    "focal_length_error",
    "marker_size_error",
    "odometry_scale",
)
FRACTION_EFFECT_NAMES = ("valve_deadband", "packet_loss")
EFFECT_SIZE_SUM_MAX = 0.95


@dataclass(frozen=True, slots=True)
class EffectEntry:
    """One effect that is present: on joint `joint` (1-based) or, None, on the machine.

    `values`: parameter name and value, sizes and shapes. `option`: of the effect's choice. `direction`: unit vector.
    """

    name: str
    joint: int | None
    values: tuple[tuple[str, float], ...]
    option: str = ""
    direction: Vector = ()

    def value(self, name: str) -> float:
        """A parameter's value."""
        return dict(self.values)[name]


def parse_entries(tables: object, n_joints: int) -> tuple[EffectEntry, ...]:
    """The effects of a machine file's `effect` list, as `tomllib` gives it (None: no list).

    Raises: MachineFileError: unknown name (with the nearest ones), joint or parameter; value out of bounds; a joint's
        third oscillation.
    """
    if tables is None:
        return ()
    if not isinstance(tables, list):
        raise MachineFileError(f"effect = {tables!r} is not a list; write each effect as its own [[effect]] table")
    entries = tuple(_parse_entry(table, n_joints, f"effect {number}") for number, table in enumerate(tables, start=1))
    pack_effects(entries, n_joints)  # a third oscillation of a joint
    _require_sums(entries)
    return entries


def _require_sums(entries: tuple[EffectEntry, ...]) -> None:
    """That what adds up to a factor leaves one above zero, and what takes a share of the whole leaves some of it."""
    sums: dict[tuple[str, int | None], float] = {}
    for entry in entries:
        if entry.name in (*GAIN_FACTOR_EFFECT_NAMES, *FRACTION_EFFECT_NAMES):
            size = entry.value(_effect_of_entry(entry).size.name)
            sums[entry.name, entry.joint] = sums.get((entry.name, entry.joint), 0.0) + size
    for (name, joint), total in sums.items():
        if (name in GAIN_FACTOR_EFFECT_NAMES and total <= -EFFECT_SIZE_SUM_MAX) or (
            name in FRACTION_EFFECT_NAMES and total >= EFFECT_SIZE_SUM_MAX
        ):
            where = "" if joint is None else f", joint {joint}"
            limit = (
                f"above {-EFFECT_SIZE_SUM_MAX:g}"
                if name in GAIN_FACTOR_EFFECT_NAMES
                else f"below {EFFECT_SIZE_SUM_MAX:g}"
            )
            raise MachineFileError(
                f"effect {name}{where}: its entries add up to {total:g}; they must stay {limit}: leave one out"
            )


def _parse_entry(table: object, n_joints: int, where: str) -> EffectEntry:
    if not isinstance(table, dict):
        raise MachineFileError(f"{where} is not a table; write [[effect]] with name, joint and parameters")
    unknown = sorted(set(table) - {"name", "joint", "parameters"})
    if unknown:
        raise MachineFileError(f"{where}: unknown key {unknown[0]!r}; an effect has name, joint and parameters")
    name = table.get("name")
    effect = effect_named(name) if isinstance(name, str) else None
    if effect is None:
        raise MachineFileError(f"{where}: name = {name!r} is not in the catalogue{_nearest_names_text(name, NAMES)}")
    where = f"{where} ({effect.name})"
    joint = _checked_joint(effect, table.get("joint"), n_joints, where)
    parameters = table.get("parameters", {})
    if not isinstance(parameters, dict):
        raise MachineFileError(
            f"{where}: parameters = {parameters!r} is not a table; write {{ {effect.size.name} = ... }}"
        )
    return make_entry(effect, joint, parameters, where)


def _nearest_names_text(name: object, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(str(name), list(known), n=3, cutoff=0.4)
    return f"; nearest: {', '.join(close)}" if close else f"; it knows {', '.join(known)}"


def _checked_joint(effect: Effect, joint: object, n_joints: int, where: str) -> int | None:
    if effect.scope == "machine":
        if joint is not None:
            raise MachineFileError(f"{where}: joint = {joint!r}, but it belongs to the whole machine; leave joint out")
        return None
    if isinstance(joint, bool) or not isinstance(joint, int) or not 1 <= joint <= n_joints:
        raise MachineFileError(
            f"{where}: joint = {joint!r}; give a whole number 1 .. {n_joints}, counted from the base"
        )
    return joint


def make_entry(effect: Effect, joint: int | None, parameters: Mapping[str, object], where: str = "") -> EffectEntry:
    """An entry from parameters by name; shapes may be left out.

    Raises: MachineFileError: a parameter is unknown, missing, not a number or out of bounds.
    """
    where = where or effect.name
    words = [extra.name for extra in (effect.quantity_choice, effect.direction) if extra is not None]
    names = [parameter.name for parameter in effect.parameters]
    for given in parameters:
        if given not in names and given not in words:
            raise MachineFileError(f"{where}: unknown parameter {given!r}{_nearest_names_text(given, names + words)}")
    if effect.size.name not in parameters:
        raise MachineFileError(f"{where}: {effect.size.name} is missing [{effect.size.unit}]; it says how large it is")
    values = tuple(
        (
            parameter.name,
            _checked_parameter_value(parameter, parameters.get(parameter.name, parameter.neutral_value), where),
        )
        for parameter in effect.parameters
    )
    return EffectEntry(
        effect.name,
        joint,
        values,
        _chosen_option(effect, parameters, where),
        _unit_direction(effect, parameters, where),
    )


def _checked_parameter_value(parameter: Parameter, value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not _is_number(value):
        raise MachineFileError(f"{where}: {parameter.name} = {repr(value)[:60]} is not a number [{parameter.unit}]")
    if not parameter.in_bounds(float(value)):
        whole = "whole numbers " if parameter.is_integer else ""
        neutral = (
            f" (neutral {parameter.neutral_value:g})"
            if not parameter.plausible_min <= parameter.neutral_value <= parameter.plausible_max
            else ""
        )
        raise MachineFileError(
            f"{where}: {parameter.name} = {value:g} is outside {whole}{parameter.plausible_min:g} .. "
            f"{parameter.max_admitted:g}"
            f"{neutral} [{parameter.unit}]; {parameter.meaning}"
        )
    return float(value)


def _is_number(value: float) -> bool:
    """Whether a float holds it: TOML's whole numbers have no end."""
    try:
        return not math.isnan(value)
    except OverflowError:
        return False


def _chosen_option(effect: Effect, parameters: Mapping[str, object], where: str) -> str:
    if effect.quantity_choice is None:
        return ""
    given = parameters.get(effect.quantity_choice.name, effect.quantity_choice.options[0])
    if given not in effect.quantity_choice.options:
        options = " or ".join(repr(option) for option in effect.quantity_choice.options)
        raise MachineFileError(
            f"{where}: {effect.quantity_choice.name} = {given!r}; give {options}: {effect.quantity_choice.meaning}"
        )
    return str(given)


def _unit_direction(effect: Effect, parameters: Mapping[str, object], where: str) -> Vector:
    if effect.direction is None:
        return ()
    dims, name = len(effect.direction.default_vector), effect.direction.name
    given = parameters.get(name, effect.direction.default_vector)
    numbers = list(given) if isinstance(given, Sequence) and not isinstance(given, str) else []
    good = len(numbers) == dims and all(isinstance(x, int | float) and _is_number(x) for x in numbers)
    vector = np.array(numbers, dtype=float) if good else np.zeros(dims)
    length = float(np.linalg.norm(vector))
    if not (math.isfinite(length) and length > 1e-9):
        raise MachineFileError(
            f"{where}: {name} = {repr(given)[:60]}; give {dims} numbers, not all 0, in "
            f"{effect.direction.reference_frame} axes"
        )
    return tuple(float(x) for x in vector / length)


def entries_to_toml(entries: Iterable[EffectEntry]) -> str:
    """`[[effect]]` tables that `parse_entries` reads back to the same entries."""
    return "".join(_entry_to_toml(entry) for entry in entries)


def _entry_to_toml(entry: EffectEntry) -> str:
    effect = _effect_of_entry(entry)
    pairs = [f"{name} = {_toml_number(effect, name, value)}" for name, value in entry.values]
    if effect.quantity_choice is not None:
        pairs.append(f'{effect.quantity_choice.name} = "{entry.option or effect.quantity_choice.options[0]}"')
    if effect.direction is not None:
        pairs.append(f"{effect.direction.name} = [{', '.join(repr(x) for x in entry.direction)}]")
    joint = f"joint = {entry.joint}\n" if entry.joint is not None else ""
    return f'\n[[effect]]\nname = "{entry.name}"\n{joint}parameters = {{ {", ".join(pairs)} }}\n'


def _toml_number(effect: Effect, name: str, value: float) -> str:
    parameter = effect.parameter(name)
    return (
        str(int(value)) if parameter is not None and parameter.is_integer else repr(float(value))
    )  # inf is TOML's too


def _effect_of_entry(entry: EffectEntry) -> Effect:
    effect = effect_named(entry.name)
    if effect is None:
        raise MachineFileError(f"effect {entry.name!r} is not in the catalogue{_nearest_names_text(entry.name, NAMES)}")
    return effect


def pack_effects(entries: Iterable[EffectEntry], n_joints: int) -> ParameterSets:
    """One parameter set with these effects; several entries of one effect and joint add up.

    Model: sizes with neutral 0 add, limits (neutral 1 or inf) take the smaller one, shapes take the last one given. A
           second oscillation of a joint continues in addition to the first one, at its own frequency.

    Raises: MachineFileError: a joint has a third oscillation; a parameter that the effect does not have.
    """
    packed = neutral_sets(n_joints)
    for entry in entries:
        effect = _effect_of_entry(entry)
        if (
            entry.joint is not None
            and effect.name == OSCILLATION_EFFECT_NAME
            and packed.joint_parameters[0, entry.joint - 1, FLEX_GAIN] != 0.0
        ):
            _step_aside(packed, entry.joint)
        for name, value in entry.values:
            parameter = effect.parameter(name)
            if parameter is None:
                known = [parameter.name for parameter in effect.parameters]
                raise MachineFileError(
                    f"effect {entry.name!r}: unknown parameter {name!r}{_nearest_names_text(name, known)}"
                )
            _apply_parameter(packed, entry, effect, parameter, value)
    return packed


def pack_under(entries: Iterable[EffectEntry], n_joints: int) -> ParameterSets:
    """The same, to put a hypothesis on: the one oscillation of a joint makes room for a second one."""
    packed = pack_effects(entries, n_joints)
    for joint in range(1, n_joints + 1):
        row = packed.joint_parameters[0, joint - 1]
        if row[FLEX_GAIN] != 0.0 and row[KNOWN_GAIN] == 0.0:
            _step_aside(packed, joint)
    return packed


def _step_aside(packed: ParameterSets, joint: int) -> None:
    row = packed.joint_parameters[0, joint - 1]
    if row[KNOWN_GAIN] != 0.0:
        raise MachineFileError(
            f"effect {OSCILLATION_EFFECT_NAME}, joint {joint}: a third oscillation of one joint; two are modelled. "
            "Add the gains of those whose frequencies are alike, or leave the smallest one out"
        )
    row[[KNOWN_GAIN, KNOWN_HZ, KNOWN_DAMPING]] = row[[FLEX_GAIN, FLEX_HZ, FLEX_DAMPING]]
    row[[FLEX_GAIN, FLEX_HZ, FLEX_DAMPING]] = neutral_sets(joint).joint_parameters[
        0, 0, [FLEX_GAIN, FLEX_HZ, FLEX_DAMPING]
    ]


def _apply_parameter(
    packed: ParameterSets, entry: EffectEntry, effect: Effect, parameter: Parameter, value: float
) -> None:
    column = column_of(effect, parameter.name, entry.option)
    row = packed.machine_parameters[0] if entry.joint is None else packed.joint_parameters[0, entry.joint - 1]
    if effect.direction is not None:
        row[column : column + len(entry.direction)] += value * np.array(entry.direction)
    elif parameter.role == "shape":
        row[column] = value
    elif parameter.neutral_value == 0.0:
        row[column] += value
    else:
        row[column] = min(row[column], value)
