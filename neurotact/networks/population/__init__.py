"""Many small networks trained together on one GPU, each as if it were alone."""
