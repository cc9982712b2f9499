"""Files of other programs: formats of samples, events and rasters, NWB and Neo; found by name, as those of others."""
