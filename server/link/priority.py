"""Ask the system to run this process before others."""

import os

_FIFO_PRIORITY = 50
_NICE = -15


def raise_priority() -> str:
    """Real-time scheduling if allowed, else a better nice value; the text says what is missing, empty if nothing is."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_FIFO_PRIORITY))
    except (OSError, AttributeError):
        pass
    else:
        return ""
    try:
        os.setpriority(os.PRIO_PROCESS, 0, _NICE)
    except (OSError, AttributeError):
        return "link runs at normal priority (no SCHED_FIFO, no nice): under load sends may be late; grant CAP_SYS_NICE"
    return f"link runs at nice {_NICE} instead of SCHED_FIFO: under load sends may be late; grant rtprio"
