"""Events and rasters, which become spikes."""
