"""What outlives a crash: jobs, fencing, audit, idempotency, plans, calibrations, in one SQLite file."""
