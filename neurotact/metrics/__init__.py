"""What a spike train and a network cost and tell: rates, intervals, synaptic operations."""
