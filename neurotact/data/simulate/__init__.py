"""One file for each simulated experiment."""
