"""The touch-modality paper: slide, brush and roll on an array; LSTM, GRU and spiking networks."""
