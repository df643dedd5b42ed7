"""clock_offset: the camera's stamps are a constant off the PLC's clock."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="clock_offset",
    stage="time",
    scope="machine",
    parameters=(
        Parameter(
            name="offset_s",
            unit="s",
            low=-0.5,
            high=0.5,
            start=0.05,
            prior=Prior("normal", 0.1),
            meaning="t_camera = t_true + offset",
        ),
    ),
    looks_like="while moving, the seen pose trails or leads the encoders by speed times offset; nothing at rest",
    distinguished_by=(
        "the same as camera_latency unless one of the two is known by a round trip or a flash; clock_drift grows with"
        " time; link delays show between sent and received reference"
    ),
    source="Kalibr's and OpenVINS' time offset calibration; clock offset U(0,150) ms of the plant's presets",
    prevalence=0.1,
)
