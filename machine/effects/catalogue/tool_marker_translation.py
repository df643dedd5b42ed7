"""tool_marker_translation: the tool's marker is moved on the tool."""

from machine.effects.spec import Direction, Effect, Parameter, Prior

EFFECT = Effect(
    name="tool_marker_translation",
    stage="camera",
    scope="machine",
    parameters=(
        Parameter(
            name="distance_m",
            unit="m",
            low=0.0,
            high=0.05,
            start=0.003,
            prior=Prior("half_normal", 0.005),
            meaning="of the marker against the machine file's place on the tool, along the axis",
        ),
    ),
    direction=Direction("axis", (1.0, 0.0, 0.0), "tool"),
    looks_like="what the tool's marker shows of the tool's place is wrong by this, wherever the arm is",
    distinguished_by="hand_eye_translation moves what is seen of the object, too, once the wrist turns",
    source="a marker glued on by hand: 1 deg, millimetres",
    prevalence=0.5,
)
