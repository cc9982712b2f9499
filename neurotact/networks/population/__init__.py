"""Many small networks trained at once on one GPU, each as it would be alone."""
