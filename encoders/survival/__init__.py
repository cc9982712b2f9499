"""What of a signal survives its encoder, and what the spikes of a study give back of its signals."""
