"""lens_distortion: straight lines bend outward or inward beyond the nominal lens."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="lens_distortion",
    stage="camera",
    scope="machine",
    parameters=(
        Parameter(
            name="k1",
            unit="1",
            low=-0.4,
            high=0.4,
            start=0.02,
            prior=Prior("normal", 0.02),
            meaning="radial coefficient beyond the nominal lens",
        ),
    ),
    looks_like="errors along the radius, growing with its third power, none in the middle",
    distinguished_by="focal_length_error grows in proportion to the radius",
    source="Brown 1966; 0.002 left after a good calibration",
)
