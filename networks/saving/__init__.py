"""All ways to save together: a search from a trained run, and the points of its front as run folders."""
