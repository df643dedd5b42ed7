"""tool_marker_rotation: the tool's marker is turned on the tool."""

from machine.effects.spec import Direction, Effect, Parameter, Prior

EFFECT = Effect(
    name="tool_marker_rotation",
    stage="camera",
    scope="machine",
    parameters=(
        Parameter(
            name="angle_rad",
            unit="rad",
            low=0.0,
            high=0.3,
            start=0.01,
            prior=Prior("half_normal", 0.03),
            meaning="of the marker against the machine file's place on the tool, about the axis",
        ),
    ),
    direction=Direction("axis", (1.0, 0.0, 0.0), "tool"),
    looks_like="what the tool's marker shows of the tool's direction is wrong by this, wherever the arm is",
    distinguished_by="hand_eye_rotation turns what is seen of the object, too",
    source="a marker glued on by hand: 1 deg, millimetres",
    prevalence=0.5,
)
