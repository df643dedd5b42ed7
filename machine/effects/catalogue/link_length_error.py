"""link_length_error: a link is longer or shorter than the drawing."""

from machine.effects.spec import Choice, Effect, Parameter, Prior

EFFECT = Effect(
    name="link_length_error",
    stage="structure",
    scope="joint",
    parameters=(
        Parameter(
            name="error_m",
            unit="m",
            low=-0.2,
            high=0.2,
            start=0.005,
            prior=Prior("normal", 0.005),
            meaning="added to the DH length a or d",
        ),
    ),
    choice=Choice("of", ("a", "d"), "which DH length"),
    looks_like="the tip errs by a constant along that link's direction",
    distinguished_by=(
        "encoder_bias errs across the link; a along x of one link and d along z of the next may be the same direction"
    ),
    source="welded booms: sd 3 to 4 mm",
    prevalence=0.3,
)
