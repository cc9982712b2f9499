"""What becomes of a trained run beside a stream: C, NIR, snnTorch, chips, a page; found by name, as those of others."""
