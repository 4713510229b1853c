"""The equations of measurements, each once, for arrays and for kernels.

A vector is its three components: numbers in a kernel, else arrays. Operators alone stand here, so
that numpy evaluates these functions as they are, and kernels compile them with `ti.func`, which
takes no types. Two truth values meet in `&`: kernels that check bounds cannot multiply them.
Lengths in R.
"""

AXES = 3
"""Axes of space, and so the components of a vector and the degrees of freedom of a shift."""


def components(vector):
    """Split an array of vectors, shape (..., 3), into x, y and z."""
    return vector[..., 0], vector[..., 1], vector[..., 2]


def missed_distance(apart, length, is_hinge):
    """Compute what the distance of two points is off by.

    Args:
        apart: From one point to the other [R].
        length: Measured distance [R].
        is_hinge: Truth values, or 0 and 1: whether only distances that are too short count.

    Returns:
        The residual [R], and the factor by which `apart` becomes the derivative of the residual by
        itself [R^-1]: 0 where the points coincide or the hinge is open.
    """
    far = (apart[0] ** 2 + apart[1] ** 2 + apart[2] ** 2) ** 0.5
    residual = far - length
    counts = 1.0 - (is_hinge & (residual >= 0.0))
    # Where there is no direction, any divisor but 0 serves.
    points = counts * (far > 0.0)
    return counts * residual, points / (far + (1.0 - points))


def missed_along(point, axis, value):
    """Compute what a coordinate of a point along a unit vector is off by [R]."""
    return point[0] * axis[0] + point[1] * axis[1] + point[2] * axis[2] - value


def slope_by_turn(direction, arm):
    """Derivative of a residual by turns that undo one of the arm at whose end a point is.

    Args:
        direction: Derivative of the residual by the point.
        arm: From the center to the point [R].

    Returns:
        Derivatives by turns about the three axes [R]. A turn that is applied has the opposite one.
    """
    x = direction[1] * arm[2] - direction[2] * arm[1]
    y = direction[2] * arm[0] - direction[0] * arm[2]
    z = direction[0] * arm[1] - direction[1] * arm[0]
    return x, y, z


def loss_beyond(missed, logarithm, square):
    """Compute by how much Cauchy's loss exceeds the square that has its slope.

    With t = e^2 / (c^2 v), the loss is c^2 log(1 + t), and has the slope of e^2 / v (1 + t).

    Args:
        missed: t, squared residual in squared widths of the loss [1].
        logarithm: log(1 + t).
        square: c^2, squared width in variances [1].
    """
    return square * (logarithm - missed / (1.0 + missed))
