"""The machine as a model: its file, frames, kinematics, camera and markers. Pure: no clock, file, socket or thread."""
