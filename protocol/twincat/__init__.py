"""The PLC program for TwinCAT: generated types, constants and tables, and the hand-written blocks in pou/. Pure."""
