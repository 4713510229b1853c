"""The kernel of the `taichi` renderer."""

from tiswarm.compute.lang import Ints1, Reals1, Reals2, ti
from tiswarm.compute.math_kernels import vector_at

FAR = 1e30


@ti.func
def sphere_depth(direction, center, radius):
    """Find the depth at which a ray from the origin meets a sphere, or FAR."""
    depth = FAR
    a = direction.dot(direction)
    b = direction.dot(center)
    off = center - direction * (b / a)  # from the ray's nearest point: keeps float32 accurate
    h = radius * radius - off.dot(off)
    if h >= 0.0:
        depth = b / a - ti.sqrt(h / a)
    return depth


@ti.func
def tube_depth(direction, start, span, radius):
    """Find the depth at which a ray from the origin meets a tube about a segment, or FAR."""
    depth = FAR
    length2 = span.dot(span)
    flat = direction - span * (direction.dot(span) / length2)
    center = start - span * (start.dot(span) / length2)
    candidate = sphere_depth(flat, center, radius)
    along = (candidate * direction - start).dot(span)
    if candidate < FAR and along >= 0.0 and along <= length2:
        depth = candidate
    return depth


@ti.kernel
def trace_capsules(
    # rays
    pixel: Reals2, camera: Reals2,
    # capsules as seen from the eye, by distance within each tile
    tile_start: Ints1, tile_item: Ints1, start: Reals2, end: Reals2, radius: Reals1,
    nearest: Reals1,
    depth_out: Reals1, seen_out: Ints1,
):  # fmt: skip
    """Find the first capsule along each ray.

    Args:
        pixel: Column and row, shape (n, 2).
        camera: Rows of (pixels per slope, middle column, middle row) and (tile edge [pixels],
            tiles in a row, 0), shape (2, 3).
        tile_start: First item of each tile, shape (tiles + 1,).
        tile_item: Capsules that may be seen in the tile, nearest first, shape (items,).
        start: One end, in right, up and forward parts [R], shape (P, 3).
        end: Other end, shape (P, 3).
        radius: Radius [R], shape (P,).
        nearest: Depth before which a capsule has no point [R], shape (P,).
        depth_out: Depth of the first capsule [R], shape (n,).
        seen_out: Index of the first capsule, or -1, shape (n,).
    """
    for i in range(pixel.shape[0]):
        right = (pixel[i, 0] - camera[0, 1]) / camera[0, 0]
        up = (camera[0, 2] - pixel[i, 1]) / camera[0, 0]
        direction = ti.Vector([right, up, 1.0])
        column = ti.cast(pixel[i, 0] / camera[1, 0], ti.i32)
        row = ti.cast(pixel[i, 1] / camera[1, 0], ti.i32)
        tile = row * ti.cast(camera[1, 1], ti.i32) + column
        best = FAR
        which = -1
        item = tile_start[tile]
        while item < tile_start[tile + 1] and nearest[tile_item[item]] < best:
            k = tile_item[item]
            first = vector_at(start, k)
            last = vector_at(end, k)
            span = last - first
            hit = sphere_depth(direction, last, radius[k])
            if span.dot(span) > 0.0:
                hit = ti.min(hit, sphere_depth(direction, first, radius[k]))
                hit = ti.min(hit, tube_depth(direction, first, span, radius[k]))
            if hit > 0.0 and hit < best:
                best = hit
                which = k
            item += 1
        depth_out[i] = best
        seen_out[i] = which
