"""The catalogue in its order: stages from the clock to the camera."""

from machine.effects.catalogue import camera, drives, joint, structure, timing
from machine.effects.spec import Effect, Stage
from machine.errors import MachineError

EFFECTS: tuple[Effect, ...] = (*timing.EFFECTS, *drives.EFFECTS, *joint.EFFECTS, *structure.EFFECTS, *camera.EFFECTS)
_BY_NAME = {effect.name: effect for effect in EFFECTS}
NAMES: tuple[str, ...] = tuple(_BY_NAME)


def effect_named(name: str) -> Effect | None:
    """The effect of this name; None if the catalogue has none."""
    return _BY_NAME.get(name)


def effect_of(name: str) -> Effect:
    """The effect of a name that the catalogue is known to have. Raises: MachineError: it has none."""
    effect = effect_named(name)
    if effect is None:
        raise MachineError(f"effect {name!r} is not in the catalogue; see machine/effects/registry.py")
    return effect


def effects_of(stage: Stage) -> tuple[Effect, ...]:
    """The effects of one stage, in the catalogue's order."""
    return tuple(effect for effect in EFFECTS if effect.stage == stage)
