"""What a network is: its spec, its neurons and readouts, the reference and the kernels that run it."""
