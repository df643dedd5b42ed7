"""How many recordings a baseline takes until it can refuse what no effect of the catalogue explains."""

FITTED_MOST = 3  # more hardly move what is fitted, and what a rare motion leaves is seen by those that judge
JUDGED_ENOUGH = 10  # from so many on, each joint has its own usual tests, and the most that is ever left is known
RECORDINGS_ENOUGH = FITTED_MOST + JUDGED_ENOUGH
