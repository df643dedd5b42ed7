"""Jobs: plans as generators of small requests, run by one engine."""
