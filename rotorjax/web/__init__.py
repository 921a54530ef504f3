"""A page on this machine to drop files on: rig file and measurements in, the report out (extra ``web``)."""
