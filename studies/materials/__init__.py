"""The materials paper: probes of four materials, recursive least squares."""
