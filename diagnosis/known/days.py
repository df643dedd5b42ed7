"""How many recordings a baseline takes until it can refuse what no effect of the catalogue explains."""

FITTED_RECORDINGS_MAX = 3  # more hardly move what is fitted, and what a rare motion leaves is seen by those that judge
# From so many on, each joint has its own usual tests, and the most that is ever left is known
JUDGING_RECORDINGS_TARGET = 10
BASELINE_RECORDINGS_TARGET = FITTED_RECORDINGS_MAX + JUDGING_RECORDINGS_TARGET
