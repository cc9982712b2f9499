"""What becomes of a trained run beside a stream: C, NIR, chips, a page; found by name, as those of other packages."""
