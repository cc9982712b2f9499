"""Measures of spike trains and networks: rates, intervals, synaptic operations, costs."""
