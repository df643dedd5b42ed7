"""camera_latency: images are stamped later than exposed."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="camera_latency",
    stage="camera",
    scope="machine",
    parameters=(
        Parameter(
            name="latency_s",
            unit="s",
            low=-0.2,
            high=0.5,
            start=0.04,
            prior=Prior("normal", 0.05),
            meaning="stamp minus exposure, beyond what is known",
        ),
    ),
    looks_like="while moving, the seen pose trails the encoders; nothing at rest",
    distinguished_by="the same as clock_offset unless the clocks are tied by a round trip",
    source="40 to 80 ms of USB stereo cameras",
    prevalence=0.3,
)
