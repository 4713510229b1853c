"""Vectors, rotations and hashes in kernels. Rotations are unit quaternions, wxyz."""

from tiswarm.compute.lang import Reals1, Ref, ti

TIE = 1e-6
"""Difference of `turn_order` below which rounding may decide which angle is less."""


@ti.func
def vector_at(rows: Ref, i):
    """Read the first three columns of row `i` of a table."""
    return ti.Vector([rows[i, 0], rows[i, 1], rows[i, 2]])


@ti.func
def part_at(table: Ref, row, first):
    """Read three columns of a table, from `first` on, as a vector."""
    return ti.Vector([table[row, first], table[row, first + 1], table[row, first + 2]])


@ti.func
def vector_in(array: Ref, i, j):
    """Read a vector from the last axis of a three-dimensional array."""
    return ti.Vector([array[i, j, 0], array[i, j, 1], array[i, j, 2]])


@ti.func
def rotate(q, v):
    """Turn the vector `v` by the unit quaternion `q`."""
    axis = ti.Vector([q[1], q[2], q[3]])
    half = 2.0 * axis.cross(v)
    return v + q[0] * half + axis.cross(half)


@ti.func
def turn_order(cosine, sine):
    """Map an angle from 0 to a full turn to a number from 0 to 4 that grows with it."""
    return ti.select(sine >= 0.0, 1.0 - cosine, 3.0 + cosine)


@ti.func
def with_torque(force, arm):
    """Append to a force its torque about the vertical where it acts at `arm`."""
    return ti.Vector([force[0], force[1], force[2], arm[0] * force[1] - arm[1] * force[0]])


@ti.func
def mixed(value):
    """Scatter the 32 low bits of a `ti.u64`, in a kernel.

    The steps are those of Wellons' "lowbias32"; no product overflows 64 bits.
    """
    low = ti.u64(0xFFFFFFFF)
    bits = (value + ti.u64(0x9E3779B9)) & low
    bits = ((bits ^ (bits >> ti.u64(16))) * ti.u64(0x7FEB352D)) & low
    bits = ((bits ^ (bits >> ti.u64(15))) * ti.u64(0x846CA68B)) & low
    return bits ^ (bits >> ti.u64(16))


@ti.kernel
def probe_arithmetic(value_out: Reals1):
    """Multiply each value by 1 + sqrt(cos^2 + sin^2) of it, which doubles it.

    Shows whether a device computes at all, in which precision, and whether it knows these
    functions in it.

    Args:
        value_out: Values, read, too, shape (n,).
    """
    for i in range(value_out.shape[0]):
        c = ti.cos(value_out[i])
        s = ti.sin(value_out[i])
        value_out[i] *= 1.0 + ti.sqrt(c * c + s * s)


@ti.func
def kick_of(seed, chain, number, t):
    """Three numbers of mean 0 and variance 1, a hash of seed, chain, number of a robot and step."""
    key = mixed(mixed(ti.cast(seed, ti.u64)) ^ ti.cast(chain, ti.u64))
    key = mixed(mixed(key ^ ti.cast(number, ti.u64)) ^ ti.cast(t, ti.u64))
    spread = 3.4641016151377544  # of a uniform number: the square root of 12
    kick = ti.Vector([0.0, 0.0, 0.0])
    for axis in ti.static(range(3)):
        bits = (key >> ti.u64(10 * axis)) & ti.u64(1023)
        kick[axis] = spread * ((ti.cast(bits, float) + 0.5) / 1024.0 - 0.5)
    return kick
