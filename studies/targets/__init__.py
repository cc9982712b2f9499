"""Studies whose networks tell numbers or detect events, in place of classes."""
