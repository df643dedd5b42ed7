"""joint_axis_tilt: a joint axis deviates from the drawing."""

from machine.effects.spec import Choice, Effect, Parameter, Prior

EFFECT = Effect(
    name="joint_axis_tilt",
    stage="structure",
    scope="joint",
    parameters=(
        Parameter(
            name="tilt_rad",
            unit="rad",
            low=-0.1,
            high=0.1,
            start=0.005,
            prior=Prior("normal", 0.005),
            meaning="of the joint's axis about x or y of its frame",
        ),
    ),
    choice=Choice("about", ("x", "y"), "which axis of the joint's own frame, before its motion"),
    looks_like="the tip moves on a tilted circle when this joint turns",
    distinguished_by="base_tilt is the same for all joints; encoder_bias stays in the joint's plane",
    source="Hayati 1983 for near-parallel axes",
    prevalence=0.15,
)
