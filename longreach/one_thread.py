"""Limit a child process to one thread: parallelism comes from processes, and results do not depend on their number."""

ONE_THREAD = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
