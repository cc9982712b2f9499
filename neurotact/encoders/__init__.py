"""From conditioned signals to the spikes of mechanoreceptors."""
