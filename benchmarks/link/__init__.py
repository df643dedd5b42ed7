"""Of the PLC link: real time, fuzzing of both ends, fault schedules."""
