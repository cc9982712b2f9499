"""A surrogate: the derivative of a spike from U - threshold and the scale of the spec."""


def triangle(x, scale):
    """1 at the threshold, and 0 beyond a distance of 1 / scale."""
    return (1 - scale * x.abs()).clamp(min=0)
