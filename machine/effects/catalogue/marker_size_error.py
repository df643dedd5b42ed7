"""marker_size_error: the print is larger or smaller than stated."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="marker_size_error",
    stage="camera",
    scope="machine",
    parameters=(
        Parameter(
            name="scale_frac",
            unit="1",
            low=-0.2,
            high=0.2,
            start=0.01,
            prior=Prior("normal", 0.01),
            meaning="true printed side over the nominal one, less 1",
        ),
    ),
    looks_like="marker distances are off by one factor, though the bearing is right",
    distinguished_by="focal_length_error also scales bearings; stereo distinguishes them by its baseline",
    source="printer scaling: 0.1 mm of 150",
)
