"""What keeps a child process to one thread: a child each is the parallelism, and sums do not depend on how many."""

ONE_THREAD = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
