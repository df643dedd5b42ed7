"""The server: shells around pure vision, calibration and motion; one machine, one port, jobs, REST and the panel."""
