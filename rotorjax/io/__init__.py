"""Files: measurement tables and rig files."""
