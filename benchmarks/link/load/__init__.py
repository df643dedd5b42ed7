"""The PLC link in real time beside a vision load: replayed stereo pictures through the real vision process."""
