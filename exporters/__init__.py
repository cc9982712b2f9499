"""What becomes of a trained run beside a stream: C, NIR, snnTorch, chips, NeuroBench's columns, a page.

They are found by name, as those of others.
"""
