"""The catalogue of effects: what each stage of a machine may do that its nominal model does not."""

from typing import get_args

from machine.effects.registry import effects_of
from machine.effects.spec import Stage

for stage in get_args(Stage):
    print(f"{stage}:")
    for effect in effects_of(stage):
        sizes = ", ".join(f"{one.name} [{one.unit}]" for one in effect.parameters if one.role == "size")
        print(f"  {effect.name:26s} {sizes:28s} {effect.looks_like[:70]}")
