"""The systems of the papers beside the spiking sweep, one a module (see `neurotact.studies.protocol`)."""
