"""Spike times as other laboratories exchange them: NWB and Neo, read and written; found by name, as those of others."""
