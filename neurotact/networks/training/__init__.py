"""From spikes to a trained network in a run folder."""
