"""The compliance paper: moments of tactile images, k-means on an FPGA."""
